"""A policy trained by proximal policy optimization (PPO, Schulman et al. 2017), without a lookahead.

Schulman, Wolski, Dhariwal, Radford and Klimov, "Proximal Policy Optimization Algorithms", 2017, arXiv:1707.06347. The
policy maps what the vehicle sees, in the frame of its goal, to a velocity: it predicts nobody, and its network is asked
once per decision.
"""

from crowdbench.planners import NetworkPlanner, load_policy


def planner(weights: str = "ppo", device: str = "cpu", encoder: str | None = None) -> NetworkPlanner:
    """Make the planner.

    Args:
        weights: The trained policy: a name (`crowdbench list weights`) or a file.
        device: Where the policy runs: `cpu` or `cuda`.
        encoder: The file of the encoder that it was trained with, where that was one of your own.

    Returns:
        The planner.
    """
    return load_policy(weights, device, encoder=encoder)
