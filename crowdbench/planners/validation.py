"""Check of the return value of a planner: dtype, shape, finite numbers, and limits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from crowdbench.core.dynamics import FREE, Dynamics, Holonomic, State
from crowdbench.core.types import Observation
from crowdbench.utils.errors import is_interrupt


class Decision:
    """Copy of the data that the check of a decision needs, because the planner could change the observation.

    Attributes:
        case: Number of the case of each world.
        step: Steps done so far in each world.
        max_speed: The vehicle's maximum speed in m/s in each world.
        dt: Length of a step in seconds.
        dynamics: The vehicle's dynamics.
        state: Its state before the step.

    Args:
        cases: The case numbers by `Observation.row`.
    """

    def __init__(self, obs: Observation, cases: Int[np.ndarray, "case"]) -> None:
        vehicle = obs.vehicle
        self.case, self.step = cases[obs.row], obs.step.copy()
        self.max_speed, self.dt = vehicle.preferred_speed.copy(), obs.dt
        self.dynamics = vehicle.dynamics
        self.state = State(*(array.copy() for array in vehicle.state))

    def to_commands(self, velocities: Float[np.ndarray, "world *time 2"]) -> Float[np.ndarray, "world *time 2"]:
        """Return the commands by which the vehicle follows velocities, for planners that return velocities.

        Args:
            velocities: For the next step or several, in m/s.
        """
        if isinstance(self.dynamics, Holonomic):
            return velocities
        state, ahead = self.state, velocities.reshape(len(velocities), -1, 2)
        commands = np.empty(ahead.shape)
        for t in range(ahead.shape[1]):
            commands[:, t] = self.dynamics.follow(state, ahead[:, t], self.max_speed, self.dt)
            state = self.dynamics.step(state, commands[:, t], self.max_speed, self.dt)
        return commands.reshape(velocities.shape)


@dataclass(frozen=True)
class AnswerFault:
    """Violation of the contract by a return value.

    Attributes:
        what: The fault.
        row: Index of the world in the batch; None if it is not known.
        ahead: The step of the command, counted from the step in which the planner was called.
    """

    what: str
    row: int | None = 0
    ahead: int = 0

    def at(self, decision: Decision) -> str:
        """Return the fault with its case and step."""
        if self.row is None and len(decision.case) > 1:
            return f"{self.what} (step {decision.step[0]}, one of {len(decision.case)} cases)"
        row = self.row or 0
        return f"{self.what} (case {decision.case[row]}, step {decision.step[row] + self.ahead})"


def validate_commands(
    answer: object, max_speed: Float[np.ndarray, "world"], *steps: int, dynamics: Dynamics = FREE
) -> Float[np.ndarray, "world *time 2"] | AnswerFault:
    """Check the return value of a planner: dtype, shape, finite numbers, and the limits of the dynamics, in this order.

    Args:
        answer: Its return value.
        max_speed: The vehicle's maximum speed in m/s.
        steps: The number of steps for which commands are required; omitted if it is only the next step.
        dynamics: The dynamics of the commands; holonomic for velocities.

    Returns:
        The commands as float64, or the first fault.
    """
    values = validate_array(answer, len(max_speed), *steps)
    if isinstance(values, AnswerFault):
        return values
    commands = values.reshape(-1, *(steps or (1,)), 2)
    finite = np.asarray(np.isfinite(commands).all(axis=2))
    if not finite.all():
        row, ahead = np.argwhere(~finite)[0].tolist()
        return AnswerFault(f"returned {commands[row, ahead].tolist()}, but a command must be finite", row, ahead)
    with np.errstate(over="ignore"):
        beyond = ~dynamics.is_within(commands, np.broadcast_to(max_speed[:, None], finite.shape))
        if beyond.any():
            row, ahead = np.argwhere(beyond)[0].tolist()
            return AnswerFault(dynamics.broken_limit(commands[row, ahead], float(max_speed[row])), row, ahead)
    return values


def validate_array(answer: object, worlds: int, *steps: int) -> Float[np.ndarray, "world *time 2"] | AnswerFault:
    """Check only dtype and shape, as `validate_commands` does; numbers need not be finite."""
    array, is_array = _to_array(answer), issubclass(type(answer), np.ndarray)
    if not (is_array and array.dtype.kind == "f"):
        kind = f"{array.dtype} array" if is_array else type(answer).__name__
        shape = "[world, time, 2]" if steps else "[world, 2]"
        return AnswerFault(f"returned a {kind} instead of a float array of shape {shape}")
    if array.shape != (worlds, *steps, 2):
        meant = "a command per world and step" if steps else "a command per world"
        return AnswerFault(f"returned shape {list(array.shape)} instead of {[worlds, *steps, 2]}, {meant}")
    return array.astype(np.float64)


def _to_array(answer: object) -> np.ndarray:
    """Return a copy of the answer as a base-class NumPy array, also of nested lists; otherwise an array of one object.

    A subclass of ndarray could execute any code when it is used.
    """
    try:
        return np.array(answer, subok=False)
    except BaseException as error:  # any exception of an object of the planner
        if is_interrupt(error):
            raise
        return np.array(None)
