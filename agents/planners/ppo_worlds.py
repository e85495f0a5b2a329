"""The policy of `ppo_attention` trained in fifteen worlds at once: circles, streets, doors, noise, wheels, groups.

The scenarios are in `scenarios/training`, and none of them is one of the suite.
"""

from crowdbench.planners.policy import PolicyPlanner, load_policy


def planner(
    weights: str = "ppo_worlds", device: str = "cpu", predictor: str = "constant_velocity", encoder: str = ""
) -> PolicyPlanner:
    """Make the planner.

    Args:
        weights: The trained policy: a name (`crowdbench list weights`) or a file.
        device: Where the policy runs: `cpu` or `cuda`.
        predictor: What predicts the pedestrians: a name (`crowdbench list predictors`) or a file.
        encoder: The file of the encoder that it was trained with, where that was one of your own.

    Returns:
        The planner.
    """
    return load_policy(weights, device, predictor, encoder)
