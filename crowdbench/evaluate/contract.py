"""What a planner may return: dtype, shape, finite numbers and speed, each examined by itself."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from crowdbench.geometry import norm
from crowdbench.sim.simulator import SPEED_TOLERANCE
from crowdbench.types import Observation


@dataclass(frozen=True)
class Fault:
    """How an answer breaks a point of the contract: what it is, in which row, and for how many steps ahead."""

    what: str
    row: int = 0
    ahead: int = 0

    def at(self, obs: Observation) -> str:
        """The fault with the case and the step that it is in."""
        return f"{self.what} (case {obs.case[self.row]}, step {obs.step[self.row] + self.ahead})"


class Examined(NamedTuple):
    """An answer, examined.

    Attributes:
        points: The fault, or None, at each point that could be examined, in this order: dtype, shape, finite, speed.
        commands: The answer in m/s, as float64, where it consists of numbers in the right shape.
    """

    points: dict[str, Fault | None]
    commands: Float[np.ndarray, "world *time 2"] | None

    @property
    def fault(self) -> Fault | None:
        """The first fault, if any."""
        return next((fault for fault in self.points.values() if fault is not None), None)


def examine(answer: object, max_speed: Float[np.ndarray, "world"], *steps: int) -> Examined:
    """Examine what a planner returned.

    Args:
        answer: Whatever it returned.
        max_speed: The vehicle's maximum speed in m/s.
        steps: For how many steps commands were asked for; left out where it was the next one alone.
    """
    points = {"dtype": _dtype(answer, *steps)}
    values = _numbers(answer)
    if values is None:
        return Examined(points, None)
    points["shape"] = _shape(values, [len(max_speed), *steps, 2])
    if points["shape"] is not None:
        return Examined(points, None)
    each = values.reshape(-1, *(steps or (1,)), 2)
    finite = np.isfinite(each).all(axis=2)
    speed = norm(np.where(finite[..., None], each, 0.0))
    fast = speed > max_speed[:, None] * (1 + SPEED_TOLERANCE)
    points["finite"] = None
    if finite.any():
        points["speed"] = None
    if not finite.all():
        row, ahead = np.argwhere(~finite)[0].tolist()
        what = f"returned {each[row, ahead].tolist()}, but a velocity must be finite"
        points["finite"] = Fault(what, row, ahead)
    if fast.any():
        row, ahead = np.argwhere(fast)[0].tolist()
        what = f"asked for {speed[row, ahead]:.6g} m/s, but the vehicle's maximum is {max_speed[row]:g} m/s"
        points["speed"] = Fault(what, row, ahead)
    return Examined(points, values)


def _dtype(answer: object, *steps: int) -> Fault | None:
    if isinstance(answer, np.ndarray) and answer.dtype.kind == "f":
        return None
    found = f"{answer.dtype} array" if isinstance(answer, np.ndarray) else type(answer).__name__
    wanted = "[world, time, 2]" if steps else "[world, 2]"
    return Fault(f"returned a {found} instead of a float array of shape {wanted}")


def _numbers(answer: object) -> Float[np.ndarray, "*shape"] | None:
    """The answer as float64, also where it is integers or nested lists; None where it is nothing of the kind."""
    try:
        array = np.asarray(answer)
    except Exception:  # whatever an object of the planner's own raises
        return None
    return array.astype(np.float64) if array.dtype.kind in "fiu" else None


def _shape(values: Float[np.ndarray, "*shape"], expected: list[int]) -> Fault | None:
    if list(values.shape) == expected:
        return None
    meant = "a velocity per world and step" if len(expected) == 3 else "a velocity per world"
    return Fault(f"returned shape {list(values.shape)} instead of {expected}, {meant}")
