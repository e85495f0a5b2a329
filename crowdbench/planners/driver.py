"""Query planners for commands, measure their decision time, and reject commands that violate the contract.

Runs call `plan` and `plan_ahead` only in this module.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from crowdbench.core.dynamics import DYNAMICS, FREE
from crowdbench.core.types import Observation
from crowdbench.planners.planner import OneStepOnly, Planner
from crowdbench.planners.validation import AnswerFault, Decision, validate_commands
from crowdbench.utils.defaults import DECISION_LIMIT
from crowdbench.utils.errors import InputError, describe_error, is_interrupt
from crowdbench.utils.resources import FairLimit, TimeLimit, interrupted_after, plugin_in_time


class FaultyAnswer(Exception):
    """Raised by the proxy of a planner in another process, if that planner returned no commands.

    Attributes:
        fault: The fault of the planner.
    """

    def __init__(self, fault: AnswerFault) -> None:
        super().__init__(fault.what)
        self.fault = fault


class Driver:
    """Driver that queries a planner for commands.

    Attributes:
        planner: The planner.
        name: Its name in errors.
        decision_limit: Seconds that it may take for a decision, for all worlds of a batch together. Time in which it
            waits for a processor does not count: see `FairLimit`.
        privileged: True if it observes the pedestrians' next velocities. Read once, so that it cannot change.
        raw: True if it observes the detections of a detector without its tracker. Read once.
        native: True if it returns commands of the vehicle's dynamics; velocities are converted to commands. Read once.
        facts: Further facts for results. Read once.
        seconds: Total time of its decisions and of `reset` so far.

    Raises:
        InputError: The decision limit is not positive, or `privileged`, `raw`, `native` or `facts` of the planner are
            not of their type.
    """

    def __init__(self, planner: Planner, name: str, decision_limit: float = DECISION_LIMIT) -> None:
        if not 0.0 < decision_limit < 1e6:
            raise InputError(f"a decision limit of {decision_limit:g} s must be more than 0 s and less than 1e6 s")
        self.planner = planner
        self.name = name
        self.decision_limit = decision_limit
        self.privileged = _read_flag(planner, name, "privileged")
        self.raw = _read_flag(planner, name, "raw")
        self.native = _read_flag(planner, name, "native", tuple(DYNAMICS))
        self.facts = _read_facts(planner, name)
        self.seconds = 0.0
        self._cases = np.empty(0, np.int64)

    def reset(self, cases: Int[np.ndarray, "world"]) -> None:
        """Reset the planner at the start of episodes, and store their case numbers for errors.

        Raises InputError if the planner raises.
        """
        self._cases = cases.copy()
        start = time.perf_counter()
        with plugin_in_time(f"planner {self.name} raised", " in reset()", self.decision_limit):
            self.planner.reset(np.arange(len(cases)))
        self.seconds += time.perf_counter() - start

    def decide(self, obs: Observation) -> Float[np.ndarray, "world 2"]:
        """Return the commands of the vehicle's dynamics. Call `reset` first.

        Raises:
            InputError: The planner raises, takes longer than the decision limit, or does not return a finite command
                per world within the vehicle's limits. The message contains planner, case and step.
        """
        return self._query(obs, self.planner.plan)

    def decide_ahead(self, obs: Observation, steps: int) -> Float[np.ndarray, "world time 2"]:
        """Return the vehicle's commands for several steps. Call `reset` first.

        Args:
            obs: The observation before the first of them.

        Raises:
            InputError: As in `decide`, with the step of the command; or the planner has no `plan_ahead`.
        """
        return self._query(obs, self.planner.plan_ahead, steps)

    def _query(self, obs: Observation, plan: Callable[..., object], *steps: int) -> Float[np.ndarray, "world *time 2"]:
        decision = Decision(obs, self._cases)
        if isinstance(self.native, str) and self.native != decision.dynamics.name:
            raise InputError(
                f"planner {self.name} has native = {self.native!r}, but the vehicle of the scenario is "
                f"{decision.dynamics.name}: set vehicle.dynamics={self.native}"
            )
        if self.privileged and obs.sensor.detector is not None:
            raise InputError(
                f"planner {self.name} is privileged, but the tracks of a detector do not name the pedestrians whose "
                "next velocities it gets: leave out sensor.detector"
            )
        limit = FairLimit(self.decision_limit, lambda: (os.getpid(),))
        start = time.perf_counter()
        answer = self._answer(decision, lambda: plan(obs, *steps), limit)
        self.seconds += time.perf_counter() - start
        # A planner in another thread, or one that catches the exception, is not interrupted.
        if limit.over():
            raise self._too_slow(decision)
        dynamics = decision.dynamics if self.native else FREE
        commands = validate_commands(answer, decision.max_speed, *steps, dynamics=dynamics)
        if isinstance(commands, AnswerFault):
            raise self._error(commands, decision)
        return commands if self.native else decision.to_commands(commands)

    def _answer(self, decision: Decision, plan: Callable[[], object], limit: FairLimit) -> object:
        """Return the answer of the planner. Its exceptions become an InputError."""
        try:
            with interrupted_after(limit):
                return plan()
        except OneStepOnly:
            raise InputError(f"planner {self.name} has no plan_ahead: it runs with replan_every = 1 only") from None
        except FaultyAnswer as error:
            raise self._error(error.fault, decision) from None
        except TimeLimit as error:
            raise self._too_slow(decision, getattr(error, "row", None)) from None
        except BaseException as error:
            # Interrupted in a plug-in that the planner called, such as a pedestrian policy.
            if isinstance(error.__cause__, TimeLimit):
                raise self._too_slow(decision) from None
            if is_interrupt(error) or isinstance(error, InputError):
                raise
            fault = AnswerFault(f"raised {describe_error(error)}", getattr(error, "row", None))
            raise self._error(fault, decision) from error

    def _error(self, fault: AnswerFault, decision: Decision) -> InputError:
        return InputError(f"planner {self.name} {fault.at(decision)}")

    def _too_slow(self, decision: Decision, row: int | None = None) -> InputError:
        return self._error(AnswerFault(f"took longer than the limit of {self.decision_limit:g} s", row), decision)


def _read_flag(planner: Planner, name: str, flag: str, words: tuple[str, ...] = ()) -> Any:
    """Return a property of a planner that must be a bool, or one of some words."""
    with plugin_in_time(f"planner {name} raised", f" in {flag}"):
        value = getattr(planner, flag)
    if not (isinstance(value, bool) or (isinstance(value, str) and value in words)):
        right = f"True, False or one of {', '.join(map(repr, words))}" if words else "True or False"
        raise InputError(f"planner {name} has {flag} = {value!r}, but it must be {right}")
    return value


def _read_facts(planner: Planner, name: str) -> dict[str, Any]:
    """Return a copy of the planner's facts, converted to JSON and back."""
    with plugin_in_time(f"planner {name} has facts that a result cannot hold, which must be texts by name:"):
        return dict(json.loads(json.dumps(dict(planner.facts), allow_nan=False)))
