"""A recurrent policy that attends to where people will be, trained by PPO in many worlds, without a lookahead.

Liu, Chang, Huang, Chakraborty, Liang, Geng, McPherson and Driggs-Campbell, "Intention Aware Robot Crowd Navigation with
Attention-Based Interaction Graph", ICRA 2023, arXiv:2203.01821. The policy is shown the present and the next five steps
of the nearest eight people, walls, its way and its own motion, attends from the vehicle to people, and remembers. It
was trained with estimates of people, and drives with the tracks of a detector.
"""

from crowdbench.planners import NetworkPlanner, load_policy


def planner(
    weights: str = "ppo_attention",
    device: str = "cpu",
    predictor: str = "constant_velocity",
    encoder: str | None = None,
) -> NetworkPlanner:
    """Make the planner.

    Args:
        weights: The trained policy: a name (`crowdbench list weights`) or a file.
        device: Where the policy runs: `cpu` or `cuda`.
        predictor: Predictor of the pedestrians: a name (`crowdbench list predictors`) or a file.
        encoder: The file of the encoder that it was trained with, where that was one of your own.

    Returns:
        The planner.
    """
    return load_policy(weights, device, predictor, encoder)
