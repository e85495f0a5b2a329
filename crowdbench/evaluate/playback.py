"""A planner that gives commands which are known beforehand."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from crowdbench.planners.base import Planner
from crowdbench.types import Observation


class Playback(Planner):
    """Gives the commands of one batch of cases.

    Args:
        command: The commands of each case of the batch, as the vehicle's dynamics takes them.
        privileged: Whether they were chosen with knowledge that no vehicle could have.
    """

    native = True

    def __init__(self, command: Float[np.ndarray, "world step 2"], privileged: bool = False) -> None:
        self._command = command
        self.privileged = privileged

    def plan(self, obs: Observation) -> Float[np.ndarray, "world 2"]:
        """The commands of this step."""
        return self._command[obs.row, obs.step]
