"""Stands at a point between start and goal; groups stand in a circle, as in a conversation."""

from typing import ClassVar

import numpy as np

from crowdbench import PedestrianPolicy, World
from crowdbench.sim import Parameters, Velocities


class Standing(PedestrianPolicy):
    """Policy of pedestrians that stand; groups stand in a circle."""

    stands: ClassVar[bool] = True

    def velocities(self, world: World, parameters: Parameters) -> Velocities:
        """See `PedestrianPolicy`."""
        return np.zeros((len(world), world.person.shape[1], 2))


def policy() -> Standing:
    """Make the policy, which has no parameters.

    Returns:
        The policy.
    """
    return Standing()
