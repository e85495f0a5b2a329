"""Beyond Li et al. (2020): whole sequences of commands under Social GAN's 20 futures, with SARL's network at their end.

The cross-entropy method: Rubinstein, "The Cross-Entropy Method for Combinatorial and Continuous Optimization",
Methodology and Computing in Applied Probability 1, 1999.
"""

from crowdbench.planners.sampling import SEARCH, CrossEntropy, SequencePlanner
from crowdbench.planners.sarl import sarl_planner


def planner(
    predictor: str = "sgan",
    weights: str = "sarl",
    device: str = "cpu",
    modes: int | None = None,
    search: CrossEntropy = SEARCH,
    horizon: int = 8,
    margin: float = 0.04,
) -> SequencePlanner:
    """Compose the planner.

    Args:
        predictor: What predicts the pedestrians: a name (`crowdbench list predictors`) or a file.
        weights: The trained value network: a name (`crowdbench list weights`) or a file.
        device: Where the value network runs: `cpu` or `cuda`.
        modes: Number of futures to predict; false for the predictor's own number [1].
        search: How sequences are sampled.
        horizon: Number of steps of a sequence, or more where more commands are asked for [1].
        margin: By how much gaps are made smaller for each step ahead, because the futures spread with time [m].

    Returns:
        The planner.
    """
    return SequencePlanner(sarl_planner(predictor, weights, device, modes), search, horizon, margin)
