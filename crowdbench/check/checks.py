"""Check plug-ins of every kind: drive again, with single cases, other batches and orders, and compare all answers."""

from __future__ import annotations

import dataclasses
import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

import numpy as np
from jaxtyping import Int

from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario
from crowdbench.utils.defaults import DECISION_LIMIT
from crowdbench.utils.errors import InputError
from crowdbench.utils.resources import FairLimit

Answer = TypeVar("Answer")

ROUNDING, TIES = 1e-6, 0.01
"""For neural networks: largest difference that counts as rounding, and share of the answers that may differ by more.

The batch size influences rounding, which decides ties.
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


class Broken(InputError):
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
class Record:
    """Record of the answers of a plug-in, with a method that calls the plug-in.

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

        Returns:
            The valid answer.

        Raises:
            Broken: The answer is invalid or late, or the plug-in changes its input.
        """
        for _ in range(self.repeat):
            before = {path: array.copy() for path, array in _arrays(inputs)}
            limit, start = FairLimit(self.limit, lambda: (os.getpid(),)), time.perf_counter()
            try:
                answer = call()
            except InputError as error:
                raise Broken(f"{self.where}{error}") from error
            self.seconds.append(time.perf_counter() - start)
            if limit.over():
                raise Broken(f"{self.where}the plug-in took longer than the limit of {self.limit:g} s ({names[0]})")
            after = dict(_arrays(inputs))
            for path in before | after:
                if (row := _find_difference(before.get(path), after.get(path))) is not None:
                    raise Broken(f"{self.where}the plug-in changes {path} ({names[row]}), but must leave it as it is")
        return answer

    def keep(self, names: Sequence[str], answers: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Record an answer for each world, and return the answers that the worlds follow."""
        recorded = {self.where + name: answer for name, answer in zip(names, answers, strict=True)}
        self.answers.update(recorded)
        return [self.expected.get(name, answer) for name, answer in recorded.items()]


class Procedure(NamedTuple):
    """Procedure by which plug-ins of a kind are driven.

    Attributes:
        drive: Drives a plug-in through cases of a scenario, and records all answers. Raises Broken if the contract is
            broken.
        answers: Name of the answers.
        repeat: Number of times that the plug-in gets each input in the repeated drive; 2 for plug-ins without a state.
        padding: Description of padding in errors; empty if answers are not compared with more absent pedestrians.
        further: Performs further checks of a plug-in that fulfils its contract.
    """

    drive: Callable[[Subject, Any, Scenario, Cases, Record], None]
    answers: str
    repeat: int = 2
    padding: str = ""
    further: Callable[[Subject, Cases], list[CheckResult]] = lambda subject, cases: []


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


class Drive(NamedTuple):
    """A drive of a plug-in.

    Attributes:
        when: Description of the conditions.
        batches: The cases of each batch.
        make: Makes the plug-in for each batch.
        padding: True if the arrays have more absent pedestrians.
        repeat: Number of times that the plug-in gets each input.
    """

    when: str
    batches: Sequence[Sequence[int]]
    make: Callable[[], Any]
    padding: bool = False
    repeat: int = 1


def check_plugin(subject: Subject, cases: Cases) -> list[CheckResult]:
    """Check a plug-in against the contract of its kind.

    Raises InputError if another part than the plug-in breaks its contract, or the plug-in cannot be constructed.
    """
    plugin, numbers, first = subject.make(), cases.indices.tolist(), Record(subject.limit)
    try:
        _run(Drive("", [numbers], lambda: plugin), subject, cases, first)
    except Broken as error:
        unexamined = [CheckResult(name, None, "not examined: the answers are not valid") for name in RULES]
        return [CheckResult("answers", False, str(error)), *unexamined]
    time = f"{1e3 * np.mean(first.seconds):.3g} ms per call, at most {1e3 * max(first.seconds):.3g} ms"
    observation = (
        f"{len(first.answers)} {subject.procedure.answers} are valid{first.remark}, the input is unchanged; {time}"
    )
    repeatable = [
        Drive("when repeated", [numbers], lambda: plugin, repeat=subject.procedure.repeat),
        Drive("with a new instance", [numbers], subject.make),
    ]
    independent = [
        Drive("when a case is driven alone", [[number] for number in numbers], subject.make),
        Drive("in batches of 3", [numbers[at : at + 3] for at in range(0, len(numbers), 3)], subject.make),
        Drive("in reverse order", [numbers[::-1]], subject.make),
    ]
    if subject.procedure.padding:
        independent.append(Drive(subject.procedure.padding, [numbers], subject.make, padding=True))
    return [
        CheckResult("answers", True, observation),
        _compare("repeatable", repeatable, subject, cases, first.answers),
        _compare("independent", independent, subject, cases, first.answers),
        *subject.procedure.further(subject, cases),
    ]


def _run(drive: Drive, subject: Subject, cases: Cases, record: Record) -> None:
    """Drive a plug-in, and record its answers."""
    for batch in drive.batches:
        plugin = drive.make()
        for where, scenario in subject.scenarios.items():
            numbers = tuple(number for number in batch if not where or number < cases.start + FEW_CASES)
            if numbers:
                record.where, batch_cases = where, CaseList(cases.split, 0, 0, numbers)
                padded = with_padding(scenario) if drive.padding else scenario
                subject.procedure.drive(subject, plugin, padded, batch_cases, record)


def _compare(
    name: str, drives: Sequence[Drive], subject: Subject, cases: Cases, first: Mapping[str, np.ndarray]
) -> CheckResult:
    """Compare the answers of drives with the first ones."""
    is_neural = not {"torch", "onnxruntime"}.isdisjoint(sys.modules) if subject.neural is None else subject.neural
    rounding, ties = (ROUNDING, TIES * (name == "independent")) if is_neural else (0.0, 0.0)
    answers = subject.procedure.answers
    for drive in drives:
        record = Record(subject.limit, first, drive.repeat)
        try:
            _run(drive, subject, cases, record)
        except Broken as error:
            return CheckResult(name, False, f"{drive.when}: {error}")
        pairs = {key: (answer, record.answers.get(key)) for key, answer in first.items()}
        differing = [key for key, pair in pairs.items() if _find_difference(*pair, rounding) is not None]
        if len(differing) > ties * len(first):
            share = f"{len(differing)} of {len(first)} {answers}"
            return CheckResult(name, False, f"{share} differ {drive.when}, first in {differing[0]}: {RULES[name]}")
    same = f"are the same{' up to rounding' if rounding else ''}"
    return CheckResult(name, True, f"{len(first)} {answers} {same} {', '.join(drive.when for drive in drives)}")


def with_padding(scenario: Scenario) -> Scenario:
    """Return a scenario with more absent pedestrians in all arrays."""
    return WithPadding(**{field.name: getattr(scenario, field.name) for field in dataclasses.fields(scenario)})


def _find_difference(first: np.ndarray | None, second: np.ndarray | None, rounding: float = 0.0) -> int | None:
    """Return the first row in which two arrays differ; None if they are the same."""
    if first is None or second is None or first.shape != second.shape:
        return 0
    same = (first == second) | ((first != first) & (second != second))
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
