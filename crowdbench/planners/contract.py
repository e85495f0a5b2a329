"""What a planner may return: dtype, shape, finite numbers and limits, each examined by itself."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from crowdbench.core.dynamics import FREE, Dynamics, Holonomic, State
from crowdbench.core.types import Observation
from crowdbench.utils.errors import is_interrupt


class Decision:
    """What a planner is asked to decide by an observation: kept apart, because the planner could change that.

    Attributes:
        case: Number of the case of each world.
        step: Steps done so far in each world.
        max_speed: The vehicle's maximum speed in m/s in each world.
        dt: Length of a step in seconds.
        dynamics: How the vehicle moves.
        state: Its state before the step.

    Args:
        obs: The observation.
        cases: The case numbers by `Observation.row`.
    """

    def __init__(self, obs: Observation, cases: Int[np.ndarray, "case"]) -> None:
        vehicle = obs.vehicle
        self.case, self.step = cases[obs.row], obs.step.copy()
        self.max_speed, self.dt = vehicle.preferred_speed.copy(), obs.dt
        self.dynamics = vehicle.dynamics
        self.state = State(*(array.copy() for array in vehicle.state))

    def to_commands(self, velocities: Float[np.ndarray, "world *time 2"]) -> Float[np.ndarray, "world *time 2"]:
        """The commands by which the vehicle follows the velocities of a planner that thinks in velocities.

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
class Fault:
    """How an answer breaks a point of the contract.

    Attributes:
        what: What is wrong.
        row: Index of the world in the batch; None where it is not known.
        ahead: The step, counted from the one that the planner was asked in.
    """

    what: str
    row: int | None = 0
    ahead: int = 0

    def at(self, decision: Decision) -> str:
        """The fault with the case and the step that it is in."""
        if self.row is None and len(decision.case) > 1:
            return f"{self.what} (step {decision.step[0]}, one of {len(decision.case)} cases)"
        row = self.row or 0
        return f"{self.what} (case {decision.case[row]}, step {decision.step[row] + self.ahead})"


class Validation(NamedTuple):
    """An answer, examined.

    Attributes:
        points: The fault, or None, at each point that could be examined, in this order: dtype, shape, finite, speed
            (which stands for all limits of the dynamics).
        commands: The answer as float64, where it consists of numbers in the right shape.
    """

    points: dict[str, Fault | None]
    commands: Float[np.ndarray, "world *time 2"] | None

    @property
    def fault(self) -> Fault | None:
        """The first fault, if any."""
        return next((fault for fault in self.points.values() if fault is not None), None)


def validate_commands(
    answer: object, max_speed: Float[np.ndarray, "world"], *steps: int, dynamics: Dynamics = FREE
) -> Validation:
    """Check what a planner returned.

    Args:
        answer: Whatever it returned.
        max_speed: The vehicle's maximum speed in m/s.
        steps: For how many steps commands were asked for; left out where it was the next one alone.
        dynamics: Whose commands they are. Velocities are those of a holonomic vehicle.
    """
    array, is_array = _to_array(answer), issubclass(type(answer), np.ndarray)
    points: dict[str, Fault | None] = {"dtype": None}
    if not (is_array and array.dtype.kind == "f"):
        kind = f"{array.dtype} array" if is_array else type(answer).__name__
        shape = "[world, time, 2]" if steps else "[world, 2]"
        points["dtype"] = Fault(f"returned a {kind} instead of a float array of shape {shape}")
    if array.dtype.kind not in "fiu":
        return Validation(points, None)
    values, expected = array.astype(np.float64), [len(max_speed), *steps, 2]
    points["shape"] = None
    if list(values.shape) != expected:
        meant = "a command per world and step" if steps else "a command per world"
        points["shape"] = Fault(f"returned shape {list(values.shape)} instead of {expected}, {meant}")
        return Validation(points, None)
    each = values.reshape(-1, *(steps or (1,)), 2)
    finite = np.asarray(np.isfinite(each).all(axis=2))
    limit = np.broadcast_to(max_speed[:, None], finite.shape)
    beyond = ~dynamics.is_within(np.where(finite[..., None], each, 0.0), limit)
    points["finite"] = None
    if finite.any():
        points["speed"] = None
    if not finite.all():
        row, ahead = np.argwhere(~finite)[0].tolist()
        what = f"returned {each[row, ahead].tolist()}, but a command must be finite"
        points["finite"] = Fault(what, row, ahead)
    if beyond.any():
        row, ahead = np.argwhere(beyond)[0].tolist()
        points["speed"] = Fault(dynamics.broken_limit(each[row, ahead], float(max_speed[row])), row, ahead)
    return Validation(points, values)


def _to_array(answer: object) -> np.ndarray:
    """A copy of the answer as an array of NumPy's own, also where it is nested lists; else an array of one object.

    A subclass of ndarray could do anything when it is used.
    """
    try:
        return np.array(answer, subok=False)
    except BaseException as error:  # whatever an object of the planner's own raises
        if is_interrupt(error):
            raise
        return np.array(None)
