"""One check of plug-ins of every kind: drive again, alone, in other batches and orders, and compare all answers."""

from __future__ import annotations

import dataclasses
import os
import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar

import numpy as np
from jaxtyping import Int

from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario
from crowdbench.utils.defaults import DECISION_LIMIT
from crowdbench.utils.errors import InputError
from crowdbench.utils.time_limit import FairLimit

Plugin = TypeVar("Plugin")
Answer = TypeVar("Answer")

ROUNDING, TIES = 1e-6, 0.01
"""Of neural networks: largest difference that counts as rounding, and share of the answers that may differ by more.

The size of the batch changes how values are rounded, which decides ties.
"""

MORE = 3
"""Number of absent pedestrians that padding adds."""

LIMITED = 5
"""Number of cases with limited sight."""

UNEXAMINED = "not examined: the answers are not valid"

REPEATABLE = (
    "an answer may depend only on its input: keep nothing beyond an episode, and draw random numbers only from the "
    "stream of the case"
)
INDEPENDENT = "the answer for a case may not depend on the cases beside it, their order, padding or unseen pedestrians"


class Broken(InputError):
    """A plug-in breaks the contract of its kind."""


@dataclass(frozen=True)
class CheckResult:
    """The result of one check.

    Attributes:
        name: Name of the check.
        kept: Whether the plug-in passes; None where the check could not be made.
        seen: What was observed, in a sentence.
    """

    name: str
    kept: bool | None
    seen: str


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
        return super().max_agents + MORE


@dataclass
class Record:
    """Calls a plug-in, and records its answers.

    Attributes:
        limit: Seconds that a call may take.
        expected: The answers of an earlier drive, which the worlds follow so that the plug-in sees the same again.
        repeat: Number of times that the plug-in gets each input.
        where: Begins names and errors.
        answers: The answer for each world and step, by their name, such as `case 2, step 3`.
        seconds: Duration of each call.
    """

    limit: float
    expected: Mapping[str, np.ndarray] = field(default_factory=dict)
    repeat: int = 1
    where: str = ""
    answers: dict[str, np.ndarray] = field(default_factory=dict)
    seconds: list[float] = field(default_factory=list)

    def ask(self, call: Callable[[], Answer], names: Sequence[str], **inputs: Any) -> Answer:
        """Call the plug-in.

        Args:
            call: Calls it, and raises InputError where the answer is invalid.
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
                if (row := _find_change(before.get(path), after.get(path))) is not None:
                    raise Broken(f"{self.where}the plug-in changes {path} ({names[row]}), but must leave it as it is")
        return answer

    def keep(self, names: Sequence[str], answers: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Record an answer for each world, and return the answers that the worlds follow."""
        recorded = {self.where + name: answer for name, answer in zip(names, answers, strict=True)}
        self.answers.update(recorded)
        return [self.expected.get(name, answer) for name, answer in recorded.items()]


@dataclass
class Subject(ABC, Generic[Plugin]):
    """A plug-in, and how plug-ins of its kind are driven.

    Attributes:
        answers: What the answers are called.
        repeat: Number of times that the plug-in gets each input when it is asked again. A plug-in that may not keep
            anything gets it twice.
        padding: Whether answers are compared with more absent pedestrians.
        make: Makes a new plug-in.
        name: Name of the plug-in.
        scenario: The scenario.
        limit: Seconds that a call may take.
        limited: A scenario with limited sight, in which the plug-in is driven too.
        neural: Whether the values are those of a neural network; if None, whether torch or ONNX is imported.
    """

    answers: ClassVar[str]
    repeat: ClassVar[int] = 2
    padding: ClassVar[bool] = False

    make: Callable[[], Plugin]
    name: str
    scenario: Scenario
    limit: float = DECISION_LIMIT
    limited: Scenario | None = None
    neural: bool | None = None

    @abstractmethod
    def drive(self, plugin: Plugin, scenario: Scenario, cases: Cases, record: Record) -> str:
        """Drive through cases, record all answers, and return a remark. Raises Broken where the contract is broken."""

    def variants(self) -> Mapping[str, Callable[[], Plugin]]:
        """Return what makes plug-ins whose answers must be the same, by when they would not be."""
        return {}


class Drive(NamedTuple):
    """A drive of a plug-in.

    Attributes:
        batches: The cases of each batch.
        make: Makes the plug-in for each batch, if not as the subject does.
        padding: Whether there are more absent pedestrians.
        repeat: Number of times that the plug-in gets each input.
    """

    batches: Sequence[Sequence[int]]
    make: Callable[[], Any] | None = None
    padding: bool = False
    repeat: int = 1

    def run(self, subject: Subject[Any], cases: Cases, record: Record) -> str:
        """Drive through the batches, also with limited sight, and return the remark."""
        remark = ""
        for batch in self.batches:
            plugin = (self.make or subject.make)()
            for where, scenario in {"": subject.scenario, "with limited sight: ": subject.limited}.items():
                numbers = tuple(number for number in batch if not where or number < cases.start + LIMITED)
                if scenario is not None and numbers:
                    record.where = where
                    some = CaseList(cases.split, 0, 0, numbers)
                    remark += subject.drive(plugin, with_padding(scenario) if self.padding else scenario, some, record)
        return remark


def check_plugin(subject: Subject[Plugin], cases: Cases) -> list[CheckResult]:
    """Check a plug-in against the contract of its kind.

    Raises InputError where something other than the plug-in breaks its contract, or it cannot be made.
    """
    plugin, numbers, first = subject.make(), cases.indices.tolist(), Record(subject.limit)
    try:
        remark = Drive([numbers], lambda: plugin).run(subject, cases, first)
    except Broken as error:
        unknown = [CheckResult(name, None, UNEXAMINED) for name in ("repeatable", "independent")]
        return [CheckResult("answers", False, str(error)), *unknown]
    time = f"{1e3 * np.mean(first.seconds):.3g} ms per call, at most {max(first.seconds):.3g} s"
    seen = f"{len(first.answers)} {subject.answers} are valid{remark}, the input is unchanged; {time}"
    repeatable = {
        "when it is asked again": Drive([numbers], lambda: plugin, repeat=subject.repeat),
        "when a new one is made": Drive([numbers]),
    }
    independent = {
        "when a case is driven alone": Drive([[number] for number in numbers]),
        "in batches of 3": Drive([numbers[start : start + 3] for start in range(0, len(numbers), 3)]),
        "in reverse order": Drive([numbers[::-1]]),
        **({f"with {MORE} more absent pedestrians": Drive([numbers], padding=True)} if subject.padding else {}),
        **{when: Drive([numbers], make) for when, make in subject.variants().items()},
    }
    rounding, ties = (ROUNDING, TIES) if _is_neural(subject) else (0.0, 0.0)

    def compare(name: str, drives: Mapping[str, Drive], right: str, ties: float) -> CheckResult:
        for when, drive in drives.items():
            record = Record(subject.limit, first.answers, drive.repeat)
            try:
                drive.run(subject, cases, record)
            except Broken as error:
                return CheckResult(name, False, f"{when}: {error}")
            found = [key for key, one in first.answers.items() if not _is_same(one, record.answers.get(key), rounding)]
            if len(found) > ties * len(first.answers):
                count = f"{len(found)} of {len(first.answers)} {subject.answers} differ {when}, first in {found[0]}"
                return CheckResult(name, False, f"{count}: {right}")
        same = "the same up to rounding" if rounding else "the same"
        return CheckResult(name, True, f"{len(first.answers)} {subject.answers} are {same} {', '.join(drives)}")

    return [
        CheckResult("answers", True, seen),
        compare("repeatable", repeatable, REPEATABLE, 0.0),
        compare("independent", independent, INDEPENDENT, ties),
    ]


def with_padding(scenario: Scenario) -> Scenario:
    """Return a scenario with more absent pedestrians in all arrays."""
    return WithPadding(**{each.name: getattr(scenario, each.name) for each in dataclasses.fields(scenario)})


def _is_neural(subject: Subject[Any]) -> bool:
    return not {"torch", "onnxruntime"}.isdisjoint(sys.modules) if subject.neural is None else subject.neural


def _is_same(one: np.ndarray, other: np.ndarray | None, rounding: float) -> bool:
    if other is None or one.shape != other.shape:
        return False
    return bool(np.isclose(one, other, rtol=0.0, atol=rounding, equal_nan=True).all())


def _find_change(before: np.ndarray | None, after: np.ndarray | None) -> int | None:
    """Return the first row of an array that has changed, None where none has."""
    if before is None or after is None or before.shape != after.shape:
        return 0
    same = (before == after) | ((before != before) & (after != after))
    return None if same.all() else int(np.argwhere(~same)[0, 0])


def _arrays(part: Any, path: str = "") -> Iterator[tuple[str, np.ndarray]]:
    """Yield the arrays in mappings and dataclasses, each with its path."""
    if isinstance(part, np.ndarray):
        yield path, part
    elif isinstance(part, Mapping):
        for name, value in part.items():
            yield from _arrays(value, f"{path}[{name!r}]" if path else name)
    elif dataclasses.is_dataclass(part):
        for each in dataclasses.fields(part):
            yield from _arrays(getattr(part, each.name), f"{path}.{each.name}")
