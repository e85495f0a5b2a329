"""Asks planners for commands, measures how long they take, and refuses what breaks their contract.

The only place that calls `plan` and `plan_ahead`.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from crowdbench.core.dynamics import DYNAMICS, FREE
from crowdbench.core.types import Observation
from crowdbench.planners.base import OneStepOnly, Planner
from crowdbench.planners.contract import Decision, Fault, validate_commands
from crowdbench.utils.defaults import DECISION_LIMIT
from crowdbench.utils.errors import ForkGuard, InputError, describe_error, is_interrupt, plugin_errors
from crowdbench.utils.resources import FairLimit


class DecisionLimitExceeded(InputError):
    """A planner took longer than its decision limit."""


class FaultyAnswer(Exception):
    """Raised by a planner that stands for one in another process, where that one gave no commands.

    Attributes:
        fault: Its fault.
    """

    def __init__(self, fault: Fault) -> None:
        super().__init__(fault.what)
        self.fault = fault


class TimeLimit(BaseException):
    """Raised inside a planner that takes too long; no Exception, which planners may catch."""


class Driver:
    """Driver that asks a planner for commands.

    Attributes:
        planner: The planner.
        name: Its name in errors.
        decision_limit: Seconds that it may take for a decision, for all worlds of a batch together. Time in which it
            waits for a processor does not count: see `FairLimit`.
        privileged: True if it is shown the pedestrians' next velocities. Read once, so that it cannot change.
        native: True if it gives commands of the vehicle's dynamics; velocities are turned into such. Read once, too.
        facts: Further facts for results. Read once, too.
        seconds: Time that it has taken so far, for its decisions and in `reset`.

    Raises:
        InputError: The decision limit is not positive, or `privileged`, `native` or `facts` of the planner are not
            of their type.
    """

    def __init__(self, planner: Planner, name: str, decision_limit: float = DECISION_LIMIT) -> None:
        if not 0.0 < decision_limit < 1e6:
            raise InputError(f"a decision limit of {decision_limit:g} s must be more than 0 s and less than 1e6 s")
        self.planner = planner
        self.name = name
        self.decision_limit = decision_limit
        self.privileged = _read_flag(planner, name, "privileged")
        self.native = _read_flag(planner, name, "native", tuple(DYNAMICS))
        self.facts = _read_facts(planner, name)
        self.seconds = 0.0
        self._cases = np.empty(0, np.int64)

    def reset(self, cases: Int[np.ndarray, "world"]) -> None:
        """Tell the planner that episodes start, and keep their case numbers for errors.

        Raises InputError where the planner raises.
        """
        self._cases = cases.copy()
        start = time.perf_counter()
        with plugin_errors(f"planner {self.name} raised", " in reset()"):
            self.planner.reset(np.arange(len(cases)))
        self.seconds += time.perf_counter() - start

    def decide(self, obs: Observation) -> Float[np.ndarray, "world 2"]:
        """Return the vehicle's commands, as its dynamics takes them. Call `reset` first.

        Raises:
            InputError: The planner raises, or returns anything but a finite command per world within the vehicle's
                limits. The sentence names planner, case and step.
            DecisionLimitExceeded: It takes longer than the decision limit.
        """
        return self._query(obs, self.planner.plan)

    def decide_ahead(self, obs: Observation, steps: int) -> Float[np.ndarray, "world time 2"]:
        """Return the vehicle's commands for several steps. Call `reset` first.

        Args:
            obs: The observation before the first of them.
            steps: The number of steps.

        Returns:
            The commands.

        Raises:
            InputError: As in `decide`, naming the step that the command is for; or the planner has no `plan_ahead`.
            DecisionLimitExceeded: The planner takes longer than the decision limit.
        """
        return self._query(obs, self.planner.plan_ahead, steps)

    def _query(self, obs: Observation, plan: Callable[..., object], *steps: int) -> Float[np.ndarray, "world *time 2"]:
        decision = Decision(obs, self._cases)
        if isinstance(self.native, str) and self.native != decision.dynamics.name:
            raise InputError(
                f"planner {self.name} has native = {self.native!r}, but the vehicle of the scenario is "
                f"{decision.dynamics.name}: set vehicle.dynamics={self.native}"
            )
        limit = FairLimit(self.decision_limit, lambda: (os.getpid(),))
        start = time.perf_counter()
        answer = self._answer(decision, lambda: plan(obs, *steps), limit)
        self.seconds += time.perf_counter() - start
        # Nobody interrupts a planner in another thread, or one that catches the interrupt.
        if limit.over():
            raise self._too_slow(decision)
        dynamics = decision.dynamics if self.native else FREE
        commands = validate_commands(answer, decision.max_speed, *steps, dynamics=dynamics)
        if isinstance(commands, Fault):
            raise self._error(commands, decision)
        return commands if self.native else decision.to_commands(commands)

    def _answer(self, decision: Decision, plan: Callable[[], object], limit: FairLimit) -> object:
        """Return the answer of the planner. Its exceptions become an InputError."""
        try:
            with ForkGuard(f"planner {self.name}"), _interrupted_after(limit):
                return plan()
        except OneStepOnly:
            raise InputError(f"planner {self.name} has no plan_ahead: it runs with replan_every = 1 only") from None
        except FaultyAnswer as error:
            raise self._error(error.fault, decision) from None
        except TimeLimit as error:
            raise self._too_slow(decision, getattr(error, "row", None)) from None
        except BaseException as error:
            # Interrupted in a plug-in that it asked for something, such as a pedestrian policy.
            if isinstance(error.__cause__, TimeLimit):
                raise self._too_slow(decision) from None
            if is_interrupt(error) or isinstance(error, InputError):
                raise
            fault = Fault(f"raised {describe_error(error)}", getattr(error, "row", None))
            raise self._error(fault, decision) from error

    def _error(self, fault: Fault, decision: Decision) -> InputError:
        return InputError(f"planner {self.name} {fault.at(decision)}")

    def _too_slow(self, decision: Decision, row: int | None = None) -> DecisionLimitExceeded:
        fault = Fault(f"took longer than the limit of {self.decision_limit:g} s", row)
        return DecisionLimitExceeded(str(self._error(fault, decision)))


def _read_flag(planner: Planner, name: str, flag: str, words: tuple[str, ...] = ()) -> Any:
    """Return a property of a planner that must be a bool, or one of some words."""
    with plugin_errors(f"planner {name} raised", f" in {flag}"):
        value = getattr(planner, flag)
    if not (isinstance(value, bool) or (isinstance(value, str) and value in words)):
        right = f"True, False or one of {', '.join(map(repr, words))}" if words else "True or False"
        raise InputError(f"planner {name} has {flag} = {value!r}, but it must be {right}")
    return value


def _read_facts(planner: Planner, name: str) -> dict[str, Any]:
    """Return a copy of the planner's facts, as it is read back from JSON."""
    with plugin_errors(f"planner {name} has facts that a result cannot hold, which must be texts by name:"):
        return dict(json.loads(json.dumps(dict(planner.facts), allow_nan=False)))


@contextlib.contextmanager
def _interrupted_after(limit: FairLimit) -> Iterator[None]:
    # Signals reach the main thread only; in a user's own threads nothing can interrupt a planner.
    if threading.current_thread() is not threading.main_thread() or not hasattr(signal, "setitimer"):
        yield
        return

    def interrupt(number: int, frame: FrameType | None) -> None:
        if limit.over():
            raise TimeLimit

    handler = signal.signal(signal.SIGALRM, interrupt)
    # Repeated, until the limit is over, and for planners that catch everything and go on.
    timer = signal.setitimer(signal.ITIMER_REAL, limit.head, min(0.5, limit.head))
    try:
        yield
    finally:
        # The last alarm may still come in here.
        try:
            signal.setitimer(signal.ITIMER_REAL, *timer)
        finally:
            signal.signal(signal.SIGALRM, handler)
