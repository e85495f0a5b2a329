"""The shape of all checks: a plug-in is asked, its answers are examined and kept, and it is asked the same again.

Again means: in another order, in other batches, and with something changed that must not matter.
"""

from __future__ import annotations

import functools
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence, Sized
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np
from jaxtyping import Int, Shaped

from crowdbench.check.result import CheckResult, Findings, find_change
from crowdbench.utils.errors import InputError

Plugin = TypeVar("Plugin")
Batch = TypeVar("Batch", bound=Sized)
"""What a plug-in is asked about: worlds, observations, a trace or a crowd."""

Answers = Shaped[np.ndarray, "_ ..."]

Ask = Callable[[], Sequence[Answers]]
"""Asks a plug-in again, and returns the answers to the same calls."""

Split = Callable[[int], list[Int[np.ndarray, "_"]]]
"""Divides the rows of a batch among other batches."""

ROUNDING = 1e-6
"""Numbers that differ by no more than this (commands in m/s) are the same up to rounding."""

TIES = 0.01
"""Share of answers that may depend on the batch, whose size changes how a network's values are rounded."""


@dataclass(frozen=True)
class Tolerance:
    """What may differ between two answers.

    Attributes:
        rounding: By how much numbers may differ that are the same.
        share: Share of the answers, one per world, that may be others.
    """

    rounding: float
    share: float

    def sentence(self, differing: str, when: str) -> str:
        """What was seen: how many answers differ, and in which circumstances."""
        numbers = f"by more than {self.rounding:g} " if self.rounding else ""
        return f"{differing} differ {numbers}{when}" + (f" (at most {self.share:.0%} may)" if self.share else "")


EXACT = Tolerance(0.0, 0.0)
NETWORKS = Tolerance(ROUNDING, TIES)


BATCHES: Mapping[str, Split] = {
    "when a case runs alone": lambda n: np.split(np.arange(n), range(1, n)),
    "in batches of 3": lambda n: np.split(np.arange(n), range(3, n, 3)),
    "in reverse order": lambda n: [np.arange(n)[::-1]],
}
"""The batches that answers must not depend on, by when they would."""


def compare_answers(
    check: str, answers: str, missing: str, first: Sequence[Answers], again: Mapping[str, Ask], tolerance: Tolerance
) -> CheckResult:
    """Whether a plug-in gives the same answers again.

    Args:
        check: Name of the check.
        answers: What the answers are called.
        missing: What is said where there are none.
        first: The answers to each call.
        again: By when they might differ, what asks again and returns the answers to the same calls. It raises
            InputError where the plug-in fails a check that it passed before.
        tolerance: What may differ.
    """
    if not first:
        return CheckResult(check, None, missing)
    total = sum(map(len, first))
    most = 0
    for when, ask in again.items():
        try:
            others = ask()
        except InputError as error:
            return CheckResult(check, False, f"{when}: {error}")
        differing = sum(_count_differing(*pair, tolerance.rounding) for pair in zip(first, others, strict=True))
        if differing > tolerance.share * total:
            return CheckResult(check, False, tolerance.sentence(f"{differing} of {total} {answers}", when))
        most = max(most, differing)
    return CheckResult(check, True, tolerance.sentence(f"{most} of {total} {answers}", ", ".join(again)))


def _count_differing(first: Answers, again: Answers, rounding: float) -> int:
    """In how many worlds two answers differ."""
    if first.shape != again.shape:
        return len(first)
    same = np.isclose(first.astype(float), again.astype(float), rtol=0.0, atol=rounding, equal_nan=True)
    return int((~same.reshape(len(first), -1).all(axis=1)).sum())


class Examination(ABC, Generic[Plugin, Batch]):
    """Asks a plug-in without a memory of its own, examines each answer, and asks again.

    A subclass for each kind of plug-in says what is asked, and what an answer must be.

    Attributes:
        units: What there is one of for each answer.
        answers: What the answers are called where they are compared.
        missing: What is said of a check that could not be made.
        batch_names: What the plug-in calls a batch, and the name of the check that it leaves it unchanged.
        plugin: The plug-in that is asked first.
        findings: What each check of its answers has found.
        seconds: How long each call took.
        calls: What was shown at each call, with all numbers of the answer, those of each world in a row.

    Args:
        make: Makes a new plug-in.
        name: What errors call it.
        tolerance: What may differ in other batches.
    """

    units = "worlds"
    answers: str
    missing: str
    batch_names: tuple[str, str]

    def __init__(self, make: Callable[[], Plugin], name: str, tolerance: Tolerance = EXACT) -> None:
        self.make, self.name, self.tolerance = make, name, tolerance
        self.plugin = make()
        self.findings = Findings(self.units, self.missing)
        self.seconds: list[float] = []
        self.calls: list[tuple[Batch, Answers]] = []

    @abstractmethod
    def query(self, plugin: Plugin, batch: Batch) -> Any:
        """What a plug-in answers, whatever that is. Raises InputError where it raises."""

    @abstractmethod
    def validators(self, batch: Batch) -> dict[str, Callable[[Any], Any]]:
        """By check, in this order, what makes an answer of the one before it, or raises InputError."""

    def numbers(self, plugin: Plugin, answer: Any, batch: Batch) -> Answers:
        """All numbers of a valid answer that matter, those of each world in a row."""
        return np.asarray(answer)

    def take(self, batch: Batch, rows: Int[np.ndarray, "row"]) -> Batch:
        """Some worlds of what is shown, as a copy."""
        taken: Batch = batch.take(rows)  # type: ignore[attr-defined]  # overridden where there is no such method
        return taken

    def locate(self, batch: Batch, row: int) -> str:
        """Where a world is, for a sentence."""
        return f"case {batch.case[row]}"  # type: ignore[attr-defined]  # overridden where there is no such attribute

    def copy(self, batch: Batch) -> Batch:
        """A copy of what is shown."""
        return self.take(batch, np.arange(len(batch)))

    def ask(self, batch: Batch) -> Any:
        """Show the plug-in something, and keep that with the answer.

        Returns:
            The answer, None where it fails a check.
        """
        before = self.copy(batch)
        steps = {"exceptions": lambda _: self._query_timed(batch), **self.validators(before)}
        answer = self.findings.examine(len(before), steps)
        path, check = self.batch_names
        change = find_change(path, before, batch)
        sentence = change and f"changes {change[0]} ({self.locate(before, change[1])})"
        self.findings.note(check, len(before), sentence)
        if answer is not None:
            self.calls.append((before, self.numbers(self.plugin, answer, before)))
        return answer

    def answer(self, plugin: Plugin, batch: Batch) -> Any:
        """What a plug-in answers. Raises InputError where that fails a check."""
        answer = self.query(plugin, batch)
        for validate in self.validators(batch).values():
            answer = validate(answer)
        return answer

    def answer_numbers(self, plugin: Plugin, batch: Batch) -> Answers:
        """All numbers of what a plug-in answers. Raises InputError where that fails a check."""
        return self.numbers(plugin, self.answer(plugin, batch), batch)

    def time_result(self, limit: float) -> CheckResult:
        """Whether no call took longer than a limit in seconds."""
        if not self.seconds:
            return CheckResult("time", None, self.missing)
        mean, longest = sum(self.seconds) / len(self.seconds), max(self.seconds)
        seen = f"{1e3 * mean:.3g} ms per call, at most {longest:.3g} s (limit {limit:g} s)"
        return CheckResult("time", longest <= limit, seen)

    def check_deterministic(
        self, when: str = "when it is shown the same again, from the last to the first"
    ) -> CheckResult:
        """Whether the plug-in repeats its answers.

        It is asked from the last call to the first, which shows what it has kept since.
        """

        def backwards() -> list[Answers]:
            return [self.answer_numbers(self.plugin, self.copy(batch)) for batch, _ in reversed(self.calls)][::-1]

        return self.compare("deterministic", {when: backwards}, Tolerance(self.tolerance.rounding, 0.0))

    def check_batch(self) -> CheckResult:
        """Whether the answers are the same in other batches."""
        again = {when: functools.partial(self._ask_divided, split) for when, split in BATCHES.items()}
        return self.compare("batch", again)

    def check_unaffected(
        self,
        check: str,
        changes: Mapping[str, Callable[[Batch], Batch]],
        back: Callable[[np.ndarray], np.ndarray] = lambda answer: answer,
    ) -> CheckResult:
        """Whether the answers are the same where something is changed that must not matter.

        Args:
            check: Name of the check.
            changes: By when the answers might differ, what changes what is shown.
            back: The part of the new answer that must be as before.
        """

        def ask_changed(change: Callable[[Batch], Batch]) -> list[np.ndarray]:
            plugin = self.make()
            return [back(self.answer_numbers(plugin, change(self.copy(batch)))) for batch, _ in self.calls]

        return self.compare(check, {when: functools.partial(ask_changed, change) for when, change in changes.items()})

    def compare(self, check: str, again: Mapping[str, Ask], tolerance: Tolerance | None = None) -> CheckResult:
        """Whether the answers are the same again: see `compare_answers`."""
        first = [answer for _, answer in self.calls]
        return compare_answers(check, self.answers, self.missing, first, again, tolerance or self.tolerance)

    def _query_timed(self, batch: Batch) -> Any:
        start = time.perf_counter()
        answer = self.query(self.plugin, batch)
        self.seconds.append(time.perf_counter() - start)
        return answer

    def _ask_divided(self, split: Split) -> list[np.ndarray]:
        """The answers of a new plug-in that is shown the rows of each call in other batches."""
        plugin = self.make()
        together = []
        for batch, answer in self.calls:
            again = np.empty(answer.shape)
            for rows in split(len(answer)):
                part = self.answer_numbers(plugin, self.take(batch, rows))
                if part.shape[1:] != answer.shape[1:]:
                    expected = [len(rows), *answer.shape[1:]]
                    raise InputError(f"the answer has shape {list(part.shape)} instead of {expected}")
                again[rows] = part
            together.append(again)
        return together
