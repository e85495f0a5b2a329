"""Calls a planner, times it and holds it to its contract. The only place that asks planners for commands."""

from __future__ import annotations

import contextlib
import signal
import threading
import time
from collections.abc import Callable, Iterator
from types import FrameType

import numpy as np
from jaxtyping import Float, Int

from crowdbench.errors import InputError
from crowdbench.geometry import norm
from crowdbench.planners.base import OneStepOnly, Planner
from crowdbench.settings import DECISION_LIMIT
from crowdbench.sim.simulator import SPEED_TOLERANCE
from crowdbench.types import Observation


class Driver:
    """Asks a planner for commands. `seconds` is the time that it has taken for them so far.

    `decision_limit`, in seconds, is for all worlds of a batch together. Raises InputError where it is not positive.
    """

    def __init__(self, planner: Planner, name: str, decision_limit: float = DECISION_LIMIT) -> None:
        if not 0.0 < decision_limit < 1e6:
            raise InputError(f"a decision limit of {decision_limit:g} s is none: it must be above 0 s and below 1e6 s")
        self.planner = planner
        self.name = name
        self.decision_limit = decision_limit
        self.seconds = 0.0

    def reset(self, cases: Int[np.ndarray, "world"]) -> None:
        """Tell the planner which cases start. Raises InputError where it raises."""
        try:
            self.planner.reset(cases)
        except (Exception, SystemExit) as error:
            raise InputError(f"planner {self.name} raised {type(error).__name__} in reset(): {error}") from error

    def decide(self, obs: Observation) -> Float[np.ndarray, "world 2"]:
        """The planner's commands in m/s.

        Raises InputError, naming planner, case and step, where the planner raises, takes longer than
        `decision_limit` seconds, or returns what is not a finite command per world within its speed.
        """
        return self._asked(obs, self.planner.plan)

    def decide_ahead(self, obs: Observation, steps: int) -> Float[np.ndarray, "world time 2"]:
        """The planner's commands for the next `steps` steps, in m/s.

        Raises InputError as `decide` does, naming the step that a command is for, and where the planner has no
        `plan_ahead`.
        """
        return self._asked(obs, self.planner.plan_ahead, steps)

    def _asked(self, obs: Observation, plan: Callable[..., object], *steps: int) -> Float[np.ndarray, "world *time 2"]:
        start = time.perf_counter()
        try:
            with _interrupted_after(self.decision_limit):
                command = plan(obs, *steps)
        except InputError:
            raise
        except OneStepOnly:
            raise InputError(
                f"planner {self.name} decides one step at a time: "
                "it has no plan_ahead, so that it runs with replan_every = 1 only"
            ) from None
        except _TimeLimit as error:
            raise self._too_slow(obs, getattr(error, "row", 0)) from None
        except (Exception, SystemExit) as error:
            row = getattr(error, "row", 0)
            raise self._wrong(obs, row, f"raised {type(error).__name__}: {error}") from error
        seconds = time.perf_counter() - start
        self.seconds += seconds
        # Nobody interrupts a planner in another thread, or one that swallows what interrupts it.
        if seconds > self.decision_limit:
            raise self._too_slow(obs, 0)
        return self._checked(command, obs, *steps)

    def _checked(self, command: object, obs: Observation, *steps: int) -> Float[np.ndarray, "world *time 2"]:
        shape = [len(obs), *steps, 2]
        if not isinstance(command, np.ndarray) or command.dtype.kind != "f":
            found = f"{command.dtype} array" if isinstance(command, np.ndarray) else type(command).__name__
            wanted = "[world, time, 2]" if steps else "[world, 2]"
            raise self._wrong(obs, 0, f"returned a {found} instead of a float array of shape {wanted}")
        if list(command.shape) != shape:
            meant = "a velocity per world and step" if steps else "a velocity per world"
            raise self._wrong(obs, 0, f"returned shape {list(command.shape)} instead of {shape}, {meant}")
        command = command.astype(np.float64)
        each = command.reshape(-1, *(steps or (1,)), 2)
        if len(wrong := np.argwhere(~np.isfinite(each).all(axis=2))):
            row, ahead = wrong[0].tolist()
            found = each[row, ahead].tolist()
            raise self._wrong(obs, row, f"returned {found}, but a velocity must be finite", ahead)
        speed, limit = norm(each), obs.vehicle.preferred_speed
        legal = speed <= limit[:, None] * (1 + SPEED_TOLERANCE)
        if len(wrong := np.argwhere(~legal)):
            row, ahead = wrong[0].tolist()
            found = f"{speed[row, ahead]:.6g} m/s"
            raise self._wrong(obs, row, f"asked for {found}, but the vehicle's maximum is {limit[row]:g} m/s", ahead)
        return command

    def _too_slow(self, obs: Observation, row: int) -> InputError:
        return self._wrong(obs, row, f"thought longer than the limit of {self.decision_limit:g} s")

    def _wrong(self, obs: Observation, row: int, what: str, ahead: int = 0) -> InputError:
        return InputError(f"planner {self.name} {what} (case {obs.case[row]}, step {obs.step[row] + ahead})")


class _TimeLimit(BaseException):
    """Raised inside a planner that thinks too long; no Exception, so that it cannot swallow it."""


@contextlib.contextmanager
def _interrupted_after(seconds: float) -> Iterator[None]:
    # Signals reach the main thread alone; elsewhere (a user's own threads) nothing can interrupt a planner.
    if threading.current_thread() is not threading.main_thread() or not hasattr(signal, "setitimer"):
        yield
        return

    def interrupt(number: int, frame: FrameType | None) -> None:
        raise _TimeLimit

    handler = signal.signal(signal.SIGALRM, interrupt)
    # Again and again, for planners that catch everything and go on.
    timer = signal.setitimer(signal.ITIMER_REAL, seconds, 0.5)
    try:
        yield
    finally:
        # The last alarm may still come in here.
        try:
            signal.setitimer(signal.ITIMER_REAL, *timer)
        finally:
            signal.signal(signal.SIGALRM, handler)
