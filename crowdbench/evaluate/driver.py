"""Asks planners for commands, measures how long they take, and refuses what breaks their contract.

The only place that calls `plan` and `plan_ahead`.
"""

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
from crowdbench.evaluate.contract import Fault, examine
from crowdbench.planners.base import OneStepOnly, Planner
from crowdbench.settings import DECISION_LIMIT
from crowdbench.types import Observation


class DecisionLimitExceeded(InputError):
    """A planner took longer than its decision limit."""


class Driver:
    """Asks a planner for commands.

    Attributes:
        planner: The planner.
        name: What it is called in errors.
        decision_limit: Seconds that it may take for a decision, for all worlds of a batch together.
        seconds: Time that it has taken for its decisions so far.

    Raises:
        InputError: The decision limit is not positive.
    """

    def __init__(self, planner: Planner, name: str, decision_limit: float = DECISION_LIMIT) -> None:
        if not 0.0 < decision_limit < 1e6:
            raise InputError(
                f"a decision limit of {decision_limit:g} s is not possible: give more than 0 s and less than 1e6 s"
            )
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

        Raises:
            InputError: The planner raises, or returns anything but a finite velocity per world within the vehicle's
                maximum speed. The sentence names planner, case and step.
            DecisionLimitExceeded: It takes longer than the decision limit.
        """
        return self._asked(obs, self.planner.plan)

    def decide_ahead(self, obs: Observation, steps: int) -> Float[np.ndarray, "world time 2"]:
        """The planner's commands for several steps.

        Args:
            obs: What the planner sees before the first of them.
            steps: The number of steps.

        Returns:
            The commands in m/s.

        Raises:
            InputError: As in `decide`, naming the step that the command is for; or the planner has no `plan_ahead`.
            DecisionLimitExceeded: The planner takes longer than the decision limit.
        """
        return self._asked(obs, self.planner.plan_ahead, steps)

    def _asked(self, obs: Observation, plan: Callable[..., object], *steps: int) -> Float[np.ndarray, "world *time 2"]:
        max_speed = obs.vehicle.preferred_speed.copy()  # as it was before the planner could change it
        start = time.perf_counter()
        try:
            with _interrupted_after(self.decision_limit):
                answer = plan(obs, *steps)
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
            fault = Fault(f"raised {type(error).__name__}: {error}", getattr(error, "row", 0))
            raise InputError(self._sentence(fault, obs)) from error
        seconds = time.perf_counter() - start
        self.seconds += seconds
        # Nobody interrupts a planner in another thread, or one that catches the interrupt.
        if seconds > self.decision_limit:
            raise self._too_slow(obs, 0)
        examined = examine(answer, max_speed, *steps)
        if examined.fault is not None:
            raise InputError(self._sentence(examined.fault, obs))
        assert examined.commands is not None  # or else there is a fault
        return examined.commands

    def _too_slow(self, obs: Observation, row: int) -> DecisionLimitExceeded:
        fault = Fault(f"took longer than the limit of {self.decision_limit:g} s", row)
        return DecisionLimitExceeded(self._sentence(fault, obs))

    def _sentence(self, fault: Fault, obs: Observation) -> str:
        return f"planner {self.name} {fault.at(obs)}"


class _TimeLimit(BaseException):
    """Raised inside a planner that takes too long; no Exception, which planners may catch."""


@contextlib.contextmanager
def _interrupted_after(seconds: float) -> Iterator[None]:
    # Signals reach the main thread only; in a user's own threads nothing can interrupt a planner.
    if threading.current_thread() is not threading.main_thread() or not hasattr(signal, "setitimer"):
        yield
        return

    def interrupt(number: int, frame: FrameType | None) -> None:
        raise _TimeLimit

    handler = signal.signal(signal.SIGALRM, interrupt)
    # Repeated, for planners that catch everything and go on.
    timer = signal.setitimer(signal.ITIMER_REAL, seconds, 0.5)
    try:
        yield
    finally:
        # The last alarm may still come in here.
        try:
            signal.setitimer(signal.ITIMER_REAL, *timer)
        finally:
            signal.signal(signal.SIGALRM, handler)
