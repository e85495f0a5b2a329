"""A policy that drives by a lidar alone, trained by PPO in many worlds, without a lookahead.

It is shown the last three scans, the way to its goal and its own motion, and no pedestrian as such. Convolutions along
the angle, whose ends are joined, encode the scans (as in Long, Fan, Liao, Liu, Zhang and Pan, "Towards Optimally
Decentralized Multi-Robot Collision Avoidance via Deep Reinforcement Learning", ICRA 2018, arXiv:1709.10082). In a
scenario without `[sensor.lidar]` the scan is that of a default lidar among the pedestrians that the sensor detects.
"""

from crowdbench.planners import NetworkPlanner, load_policy


def planner(weights: str = "ppo_lidar", device: str = "cpu", encoder: str | None = None) -> NetworkPlanner:
    """Make the planner.

    Args:
        weights: The trained policy: a name (`crowdbench list weights`) or a file.
        device: Where the policy runs: `cpu` or `cuda`.
        encoder: The file of the encoder that it was trained with, where that was one of your own.

    Returns:
        The planner.
    """
    return load_policy(weights, device, encoder=encoder)
