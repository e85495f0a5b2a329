"""Walks straight to the goal without avoidance."""

from crowdbench import PedestrianPolicy, World
from crowdbench.core import toward_goal
from crowdbench.sim import Parameters, Velocities, goals_on_way


class Straight(PedestrianPolicy):
    """Policy of pedestrians that walk to the goal at the preferred speed without avoidance."""

    def velocities(self, world: World, parameters: Parameters) -> Velocities:
        """See `PedestrianPolicy`."""
        return toward_goal(world.position, goals_on_way(world), world.preferred_speed)[:, 1:]


def policy() -> Straight:
    """Make the policy, which has no parameters.

    Returns:
        The policy.
    """
    return Straight()
