"""Actuators of the vehicle, which execute commands late and gradually."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

Commands = Float[np.ndarray, "world 2"]


class Actuation(NamedTuple):
    """Delay and lag between a command and its execution. Both are 0 by default: a command acts in its own step.

    The limits of the dynamics apply to the executed command.

    Attributes:
        delay: Seconds from a command to the step that it acts in, a multiple of the length of a step. Until the first
            command acts, the vehicle stands.
        lag: Time constant in seconds with which each number of the executed command follows the command (first order).
    """

    delay: float = 0.0
    lag: float = 0.0

    def start(self, worlds: int, dt: float) -> dict[str, np.ndarray]:
        """Return the state of actuators before the first command, empty without delay and lag.

        Args:
            worlds: Number of worlds.
            dt: Length of a step in seconds.

        Returns:
            `pending` `[world, delay, 2]`, commands that do not act yet, the oldest first; `executed` `[world, 2]`, the
            command of the last step.
        """
        if self == DIRECT:
            return {}
        return {"pending": np.zeros((worlds, round(self.delay / dt), 2)), "executed": np.zeros((worlds, 2))}

    def execute(
        self, state: Mapping[str, np.ndarray], command: Commands, dt: float
    ) -> tuple[Commands, Mapping[str, np.ndarray]]:
        """Return the commands that the vehicles execute in a step, and the state of their actuators after it.

        With a lag T, the executed command is e + (1 - exp(-dt / T)) (c - e). Here e is the executed command of the step
        before and c the delayed command: the response of dE/dt = (c - E) / T at the end of the step.

        Args:
            state: The state of the actuators before it.
            command: The commands of the planner.
            dt: Length of the step in seconds.
        """
        if not state:
            return command, state
        waiting = np.concatenate([state["pending"], command[:, None]], axis=1)
        share = -math.expm1(-dt / self.lag) if self.lag else 1.0
        executed = state["executed"] + share * (waiting[:, 0] - state["executed"])
        return executed, {"pending": waiting[:, 1:], "executed": executed}


DIRECT = Actuation()
"""Actuators without delay or lag."""
