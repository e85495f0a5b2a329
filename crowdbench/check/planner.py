"""Checks what a planner keeps of its contract, point by point, on real episodes."""

from __future__ import annotations

import dataclasses
import functools
import time
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from crowdbench.check.examination import BATCHES, NETWORKS, ROUNDING, Answers, Ask, Tolerance, compare_answers
from crowdbench.check.inputs import first_cases
from crowdbench.check.result import UNEXAMINED_SIGHT, CheckResult, Findings, find_change
from crowdbench.core.dynamics import FREE, Dynamics, Holonomic
from crowdbench.core.geometry import norm
from crowdbench.core.types import Observation
from crowdbench.planners.base import OneStepOnly, Planner
from crowdbench.planners.contract import Decision, Fault, validate_commands
from crowdbench.planners.driver import DecisionLimitExceeded, Driver
from crowdbench.runs.rollout import rollout
from crowdbench.runs.spec import EVERY_STEP, Replanning
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario
from crowdbench.utils.errors import InputError

MISSING = "not examined: the planner returned no array of commands"

AHEAD = 8
"""Steps that `plan_ahead` is asked for."""

COMMANDS = "commands"


def check_planner(
    make: Callable[[], Planner],
    name: str,
    scenario: Scenario,
    cases: Cases,
    decision_limit: float,
    limited: Scenario | None = None,
) -> list[CheckResult]:
    """Drive planners through cases and examine each part of the contract by itself.

    Commands that break the contract are replaced by ones that keep it, so that the episodes go on.

    Args:
        make: Makes a new planner.
        name: What the planner is called in errors.
        scenario: The scenario of the cases.
        cases: The cases.
        decision_limit: Seconds that the planner may take for a decision, for all worlds together.
        limited: A scenario in which the vehicle does not see everybody, if planners are to drive through some of its
            cases too.

    Raises:
        InputError: Something other than the planner breaks its contract.
    """
    witness = _Witness(make(), name, decision_limit, cases.indices)
    late = raised = ""
    try:
        rollout(witness.driver, scenario, cases)
    except DecisionLimitExceeded as error:
        late = str(error)
    except InputError as error:
        if not witness.raised:
            raise
        raised = str(error)
    findings = witness.findings
    limits = "never beyond the vehicle's limits" if witness.native else "never above the vehicle's maximum speed"
    batches = {when: functools.partial(witness.replay, make, split(len(cases))) for when, split in BATCHES.items()}
    # The same planner, so that what it remembers beyond its `reset` is found too.
    same = functools.partial(witness.replay, lambda: witness.planner, [np.arange(len(cases))])
    results = [
        CheckResult("exceptions", not raised, raised or f"none in {len(witness.calls)} calls"),
        _decision_time(witness, late, decision_limit),
        findings.result("dtype", ", ".join(sorted(witness.dtypes))),
        findings.result("shape", "[world, 2]"),
        findings.result("finite", "no NaN, no infinity"),
        findings.result("speed", limits),
        findings.result("observation", "left unchanged"),
        witness.compare("deterministic", {"when it sees the same episodes again": same}, Tolerance(ROUNDING, 0.0)),
        witness.compare("batch", batches, NETWORKS),
    ]
    if witness.calls:
        ahead = _Witness(make(), name, decision_limit, cases.indices)
        kept = f"{AHEAD} steps at once: dtype, shape, finite and speed as above"
        result = _check_rollout("plan_ahead", ahead.driver, scenario, cases, kept, Replanning(AHEAD, look_first=1))
        if not ahead.one_step:
            results.append(result)
    if limited is not None and all(result.kept for result in results):
        driver, cases = Driver(make(), name, decision_limit), first_cases(cases)
        kept = f"keeps the contract in {len(cases)} cases in which it does not see everybody"
        results.append(_check_rollout("limited sight", driver, limited, cases, kept))
    elif limited is not None:
        results.append(UNEXAMINED_SIGHT)
    return results


class _Call(NamedTuple):
    """What a planner was shown, its commands in m/s (None where it returned something else), and how long it took."""

    obs: Observation
    command: Float[np.ndarray, "world 2"] | None
    seconds: float


class _Witness(Planner):
    """Keeps all that a planner is shown and answers, and passes on commands that keep the contract.

    Attributes:
        raised: Whether the planner raised an exception, or is being asked.
        calls: Its answers.
        dtypes: The types that they had.
        findings: What each check has found, with case and step.
        one_step: Whether it has said that it decides one step at a time.
        driver: Asks this one for commands.

    Args:
        planner: The planner.
        name: What the planner is called in errors.
        decision_limit: Seconds that it may take for a decision.
        cases: The case numbers by `Observation.row`.
    """

    def __init__(self, planner: Planner, name: str, decision_limit: float, cases: Int[np.ndarray, "case"]) -> None:
        self.planner, self.name, self.decision_limit, self.cases = planner, name, decision_limit, cases
        self.privileged = planner.privileged
        self.native = planner.native
        self.raised = False
        self.calls: list[_Call] = []
        self.dtypes: set[str] = set()
        self.findings = Findings(COMMANDS, MISSING)
        self.one_step = False
        self.driver = Driver(self, name, decision_limit)

    def reset(self, rows: Int[np.ndarray, "world"]) -> None:
        self.raised = True
        self.planner.reset(rows)
        self.raised = False

    def plan(self, obs: Observation) -> Float[np.ndarray, "world 2"]:
        before = obs.take(slice(None))
        start = time.perf_counter()
        self.raised = True
        answer = self.planner.plan(obs)
        self.raised = False
        seconds = time.perf_counter() - start
        self.dtypes.add(str(answer.dtype) if isinstance(answer, np.ndarray) else type(answer).__name__)
        dynamics = before.vehicle.dynamics if self.native else FREE
        validation = validate_commands(answer, before.vehicle.preferred_speed, dynamics=dynamics)
        self.calls.append(_Call(before, validation.commands, seconds))
        for check, fault in validation.points.items():
            self._note(check, fault, before)
        found = find_change("obs", before, obs)
        self._note("observation", found and Fault(f"changes {found[0]}", found[1]), before)
        return _limit_commands(validation.commands, before.vehicle.preferred_speed, dynamics)

    def plan_ahead(self, obs: Observation, steps: int) -> Any:
        try:
            return self.planner.plan_ahead(obs, steps)
        except OneStepOnly:
            self.one_step = True
            raise

    @property
    def valid_calls(self) -> list[_Call]:
        """The calls in which the planner returned an array of commands in time."""
        return [call for call in self.calls if call.seconds <= self.decision_limit and call.command is not None]

    def compare(self, check: str, again: Mapping[str, Ask], tolerance: Tolerance) -> CheckResult:
        """Whether planners give the same commands again: see `compare_answers`."""
        first = [np.asarray(call.command) for call in self.valid_calls]
        return compare_answers(check, COMMANDS, MISSING, first, again, tolerance)

    def replay(self, make: Callable[[], Planner], batches: list[Int[np.ndarray, "_"]]) -> list[Answers]:
        """The commands of planners that are shown the same again: each drives some rows, a batch of their own.

        Raises InputError where one raises, takes too long, or fails a check that this one has passed.
        """
        again = [np.full((len(call.obs), 2), np.nan) for call in self.valid_calls]
        for group in batches:
            cases = self.cases[group]
            witness = _Witness(make(), self.name, self.decision_limit, cases)
            witness.driver.reset(cases)
            row_of = np.full(len(self.cases), -1)
            row_of[group] = np.arange(len(group))
            for call, commands in zip(self.valid_calls, again, strict=True):
                own = row_of[call.obs.row]
                running = np.argsort(own)[(own < 0).sum() :]
                if len(running):
                    witness.driver.decide(dataclasses.replace(call.obs.take(running), row=own[running]))
                    if (answer := witness.calls[-1].command) is not None:
                        commands[running] = answer
            for check, fault in witness.findings.faults.items():
                if check not in self.findings.faults:
                    raise InputError(f"planner {self.name} {fault}")
        return again

    def _note(self, check: str, fault: Fault | None, before: Observation) -> None:
        sentence = None if fault is None else fault.at(Decision(before, self.cases))
        self.findings.note(check, len(before), sentence)


def _decision_time(witness: _Witness, late: str, limit: float) -> CheckResult:
    commands = sum(len(call.obs) for call in witness.calls)
    if late or not commands:
        return CheckResult("decision time", False if late else None, late or MISSING)
    seconds = [call.seconds for call in witness.calls]
    mean, longest = 1e3 * sum(seconds) / commands, max(seconds)
    seen = f"{mean:.3g} ms per command, at most {longest:.3g} s per call (limit {limit:g} s)"
    return CheckResult("decision time", True, seen)


def _check_rollout(
    check: str, driver: Driver, scenario: Scenario, cases: Cases, kept: str, replanning: Replanning = EVERY_STEP
) -> CheckResult:
    """Whether a planner keeps its contract in a rollout; `kept` is said where it does."""
    try:
        rollout(driver, scenario, cases, replanning=replanning)
    except InputError as error:
        return CheckResult(check, False, str(error))
    return CheckResult(check, True, kept)


def _limit_commands(
    commands: Float[np.ndarray, "world 2"] | None, max_speed: Float[np.ndarray, "world"], dynamics: Dynamics
) -> Float[np.ndarray, "world 2"]:
    """Commands that keep the contract: made smaller, or standing still where nothing else can be made of them."""
    if commands is None:
        return np.zeros((len(max_speed), 2))
    finite = np.where(np.isfinite(commands).all(axis=1, keepdims=True), commands, 0.0)
    if not isinstance(dynamics, Holonomic):
        return np.clip(finite, *dynamics.space(max_speed))
    speed = norm(finite)
    fast = speed > max_speed
    return finite * np.where(fast, max_speed / np.where(fast, speed, 1.0), 1.0)[:, None]
