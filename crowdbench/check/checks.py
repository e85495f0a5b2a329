"""Check a plug-in: drive it again, with single cases, other batches and orders, and compare all answers."""

from __future__ import annotations

import dataclasses
import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Int

from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario
from crowdbench.utils.defaults import DECISION_LIMIT
from crowdbench.utils.errors import InputError
from crowdbench.utils.resources import FairLimit, TimeLimit, interrupted_after

Answer = TypeVar("Answer")

ROUNDING = 1e-6
"""Largest difference between answers of a neural network that counts as rounding."""

TIES = 0.01
"""Largest share of the answers of a neural network that may differ by more.

The batch size changes rounding, and rounding decides between commands of the same value.
"""

EXTRA = 3
"""Number of absent pedestrians that padding adds."""

PADDING = f"with {EXTRA} more absent pedestrians"

FEW_CASES = 5
"""Number of cases in further scenarios, such as one with limited sight."""

RULES = {
    "repeatable": "an answer may depend only on its input: keep nothing beyond an episode, and draw random numbers "
    "only from the stream of the case",
    "independent": "the answer for a case may not depend on the cases beside it, their order, padding or unseen "
    "pedestrians",
}
"""The checks that compare answers, and the rules of the contract."""


class ContractBroken(InputError):
    """A plug-in breaks the contract of its kind."""


@dataclass(frozen=True)
class CheckResult:
    """The result of one check.

    Attributes:
        name: Name of the check.
        passed: True if the plug-in passes; None if the check could not be performed.
        observation: The observation, in a sentence.
    """

    name: str
    passed: bool | None
    observation: str


@dataclass(frozen=True)
class CaseList(Cases):
    """Cases in any order."""

    numbers: tuple[int, ...] = ()

    @property
    def indices(self) -> Int[np.ndarray, "world"]:
        """The case numbers."""
        return np.array(self.numbers)


class WithPadding(Scenario):
    """A scenario whose arrays have more absent pedestrians."""

    @property
    def max_agents(self) -> int:
        """The number of agents in the arrays."""
        return super().max_agents + EXTRA


@dataclass
class AnswerLog:
    """Answers of a plug-in during a drive.

    Attributes:
        limit: Seconds that a call may take.
        expected: The answers of an earlier drive, which the worlds follow so that the inputs are the same again.
        repeat: Number of times that the plug-in gets each input.
        where: Prefix of names and errors.
        answers: The answer for each world and step, by their name, such as `case 2, step 3`.
        seconds: Duration of each call.
        remark: A further observation.
    """

    limit: float
    expected: Mapping[str, np.ndarray] = dataclasses.field(default_factory=dict)
    repeat: int = 1
    where: str = ""
    answers: dict[str, np.ndarray] = dataclasses.field(default_factory=dict)
    seconds: list[float] = dataclasses.field(default_factory=list)
    remark: str = ""

    def query(self, call: Callable[[], Answer], names: Sequence[str], **inputs: Any) -> Answer:
        """Call the plug-in.

        Args:
            call: Calls the plug-in, and raises InputError if the answer is invalid.
            names: The name of each world.
            inputs: The plug-in's arguments, by name: dataclasses or mappings with arrays `[world, ...]`.

        Raises:
            ContractBroken: The answer is invalid or late, or the plug-in changes its input.
        """
        for _ in range(self.repeat):
            before = {path: array.copy() for path, array in _arrays(inputs)}
            limit = FairLimit(self.limit, lambda: (os.getpid(),))
            start = time.perf_counter()
            try:
                with interrupted_after(limit):
                    answer = call()
            except (InputError, TimeLimit) as error:
                is_late = isinstance(error, TimeLimit) or isinstance(error.__cause__, TimeLimit)
                if not (is_late and limit.over()):
                    raise ContractBroken(f"{self.where}{error}") from error
            self.seconds.append(time.perf_counter() - start)
            if limit.over():
                late = f"the plug-in took longer than the limit of {self.limit:g} s ({names[0]})"
                raise ContractBroken(f"{self.where}{late}")
            after = dict(_arrays(inputs))
            for path in before | after:
                row = _find_difference(before.get(path), after.get(path))
                if row is not None:
                    changed = f"the plug-in changes {path} ({names[row]}), but must leave it as it is"
                    raise ContractBroken(f"{self.where}{changed}")
        return answer

    def keep(self, names: Sequence[str], answers: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Record an answer for each world, and return the answers that the worlds follow."""
        recorded = {self.where + name: answer for name, answer in zip(names, answers, strict=True)}
        self.answers.update(recorded)
        return [self.expected.get(name, answer) for name, answer in recorded.items()]


DriveCases = Callable[[Any, str, Scenario, Cases, AnswerLog], None]
"""Drives a plug-in, given with its name, through cases of a scenario. Raises ContractBroken if an answer is invalid."""


@dataclass(frozen=True)
class Procedure:
    """The check of one kind of plug-in.

    Attributes:
        drive: Drives a plug-in, and records all answers.
        answers: Plural noun for the answers.
        stateless: True if an answer depends on its input alone, so that a second call must give the same answer.
        padding: Description of padding in errors; empty if answers are not compared with more absent pedestrians.
        further: Performs further checks after a drive with valid answers.
    """

    drive: DriveCases
    answers: str
    stateless: bool = True
    padding: str = ""
    further: Callable[[Scenario, Cases], list[CheckResult]] | None = None


@dataclass(frozen=True)
class Subject:
    """A plug-in that is checked.

    Attributes:
        procedure: The procedure for its kind.
        make: Makes a new plug-in.
        name: Name of the plug-in.
        scenarios: The scenarios, by the prefix of their names and errors. All but the first are used with a few cases
            only.
        limit: Seconds that a call may take.
        neural: True if a neural network computes the values; None to test whether torch or ONNX is imported.
    """

    procedure: Procedure
    make: Callable[[], Any]
    name: str
    scenarios: Mapping[str, Scenario]
    limit: float = DECISION_LIMIT
    neural: bool | None = None

    def drive(self, plugin: Any, cases: Cases, numbers: Sequence[int], log: AnswerLog, padding: bool = False) -> None:
        """Drive a plug-in through the cases with some numbers, in this order, as one batch."""
        for where, scenario in self.scenarios.items():
            chosen = [number for number in numbers if not where or number < cases.start + FEW_CASES]
            if chosen:
                log.where = where
                shown = with_padding(scenario) if padding else scenario
                self.procedure.drive(plugin, self.name, shown, CaseList(cases.split, 0, 0, tuple(chosen)), log)


@dataclass(frozen=True)
class Condition:
    """The condition of a drive whose answers are compared with the first ones.

    Attributes:
        when: The condition in words.
        batches: The case numbers of each batch.
        plugin: The plug-in; None for a new one per batch.
        padding: True if the arrays have more absent pedestrians.
        repeat: Number of times that the plug-in gets each input.
    """

    when: str
    batches: Sequence[Sequence[int]]
    plugin: Any = None
    padding: bool = False
    repeat: int = 1


def check_plugin(
    subject: Subject, cases: Cases, report: Callable[[float], None] = lambda done: None
) -> list[CheckResult]:
    """Check a plug-in against the contract of its kind.

    Args:
        subject: The plug-in.
        cases: The cases in which it is driven.
        report: Called with each part of the drives that is done, a fraction of all.

    Raises:
        InputError: Another part than the plug-in breaks its contract, or the plug-in cannot be constructed.
    """
    procedure, plugin, numbers = subject.procedure, subject.make(), cases.indices.tolist()
    first = AnswerLog(subject.limit)
    report(0.0)
    try:
        subject.drive(plugin, cases, numbers, first)
    except ContractBroken as error:
        unexamined = [CheckResult(name, None, "not examined: the answers are not valid") for name in RULES]
        return [CheckResult("answers", False, str(error)), *unexamined]
    valid = f"{len(first.answers)} {procedure.answers} are valid{first.remark}, the input is unchanged"
    duration = f"{1e3 * np.mean(first.seconds):.3g} ms per call, at most {1e3 * max(first.seconds):.3g} ms"

    repeatable = [
        Condition("when repeated", [numbers], plugin, repeat=2 if procedure.stateless else 1),
        Condition("with a new instance", [numbers]),
    ]
    independent = [
        Condition("when a case is driven alone", [[number] for number in numbers]),
        Condition("in batches of 3", [numbers[at : at + 3] for at in range(0, len(numbers), 3)]),
        Condition("in reverse order", [numbers[::-1]]),
    ]
    if procedure.padding:
        independent.append(Condition(procedure.padding, [numbers], padding=True))
    share = 1.0 / (1 + len(repeatable) + len(independent))
    report(share)

    def compare(name: str, conditions: Sequence[Condition]) -> CheckResult:
        return _compare(name, conditions, subject, cases, first.answers, lambda part: report(share * part))

    results = [
        CheckResult("answers", True, f"{valid}; {duration}"),
        compare("repeatable", repeatable),
        compare("independent", independent),
    ]
    if procedure.further is not None:
        results += procedure.further(subject.scenarios[""], cases)
    return results


def _compare(
    name: str,
    conditions: Sequence[Condition],
    subject: Subject,
    cases: Cases,
    first: Mapping[str, np.ndarray],
    report: Callable[[float], None],
) -> CheckResult:
    """Drive a plug-in under several conditions, and compare its answers with the first ones."""
    is_neural = subject.neural
    if is_neural is None:
        is_neural = "torch" in sys.modules or "onnxruntime" in sys.modules
    rounding = ROUNDING if is_neural else 0.0
    tolerated = TIES * len(first) if is_neural and name == "independent" else 0.0
    answers = subject.procedure.answers
    for condition in conditions:
        log = AnswerLog(subject.limit, first, condition.repeat)
        try:
            for batch in condition.batches:
                plugin = subject.make() if condition.plugin is None else condition.plugin
                subject.drive(plugin, cases, batch, log, condition.padding)
                report(len(batch) / len(cases))
        except ContractBroken as error:
            return CheckResult(name, False, f"{condition.when}: {error}")
        differing = [
            key for key, answer in first.items() if _find_difference(answer, log.answers.get(key), rounding) is not None
        ]
        if len(differing) > tolerated:
            share = f"{len(differing)} of {len(first)} {answers}"
            return CheckResult(name, False, f"{share} differ {condition.when}, first in {differing[0]}: {RULES[name]}")
    same = "are the same up to rounding" if is_neural else "are the same"
    return CheckResult(name, True, f"{len(first)} {answers} {same} {', '.join(each.when for each in conditions)}")


def with_padding(scenario: Scenario) -> Scenario:
    """Return a scenario with more absent pedestrians in all arrays."""
    return WithPadding(**{field.name: getattr(scenario, field.name) for field in dataclasses.fields(scenario)})


def _find_difference(first: np.ndarray | None, second: np.ndarray | None, rounding: float = 0.0) -> int | None:
    """Return the first row in which two arrays differ; None if they are the same."""
    if first is None or second is None or first.shape != second.shape:
        return 0
    same = (first == second) | ((first != first) & (second != second))  # NaN equals NaN here
    if rounding:
        same |= np.abs(np.subtract(first, second, dtype=float)) <= rounding
    rows = np.argwhere(~np.atleast_1d(same))
    return int(rows[0, 0]) if len(rows) else None


def _arrays(part: Any, path: str = "") -> Iterator[tuple[str, np.ndarray]]:
    """Yield the arrays in mappings and dataclasses, each with its path."""
    if isinstance(part, np.ndarray):
        yield path, part
    elif isinstance(part, Mapping):
        for name, value in part.items():
            yield from _arrays(value, f"{path}[{name!r}]" if path else name)
    elif dataclasses.is_dataclass(part):
        for field in dataclasses.fields(part):
            yield from _arrays(getattr(part, field.name), f"{path}.{field.name}")
