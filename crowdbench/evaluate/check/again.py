"""Whether a plug-in gives the same answers again: to the same, in other batches, and with more padding."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from jaxtyping import Int, Shaped

from crowdbench.errors import InputError
from crowdbench.evaluate.check.point import Point

Shown = TypeVar("Shown")
"""What a plug-in is shown: worlds, observations or a trace."""

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
        """What was seen, as a sentence.

        Args:
            differing: How many answers differ.
            when: In which circumstances.
        """
        numbers = f"by more than {self.rounding:g} " if self.rounding else ""
        return f"{differing} differ {numbers}{when}" + (f" (at most {self.share:.0%} may)" if self.share else "")


EXACT = Tolerance(0.0, 0.0)
NETWORKS = Tolerance(ROUNDING, TIES)


def _in_batches_of(size: int) -> Split:
    return lambda n: [np.arange(start, min(start + size, n)) for start in range(0, n, size)]


BATCHES: Mapping[str, Split] = {
    "when a case runs alone": _in_batches_of(1),
    "in batches of 3": _in_batches_of(3),
    "in reverse order": lambda n: [np.arange(n)[::-1]],
}
"""The batches that answers must not depend on, by when they would."""


def same_point(
    name: str,
    answers: str,
    first: Sequence[Shaped[np.ndarray, "_ ..."]],
    again: Mapping[str, Callable[[], Sequence[Shaped[np.ndarray, "_ ..."]]]],
    tolerance: Tolerance,
) -> Point:
    """Whether a plug-in gives the same answers again.

    Args:
        name: Name of the point.
        answers: What the answers are called.
        first: The answers to each call.
        again: By when they might differ, what asks again and returns the answers to the same calls. It raises
            InputError where the plug-in breaks a point that it kept before.
        tolerance: What may differ.
    """
    total = sum(map(len, first))
    most = 0
    for when, ask in again.items():
        try:
            others = ask()
        except InputError as error:
            return Point(name, False, f"{when}: {error}")
        differing = sum(_differing(*pair, tolerance.rounding) for pair in zip(first, others, strict=True))
        if differing > tolerance.share * total:
            return Point(name, False, tolerance.sentence(f"{differing} of {total} {answers}", when))
        most = max(most, differing)
    return Point(name, True, tolerance.sentence(f"{most} of {total} {answers}", ", ".join(again)))


def _differing(
    first: Shaped[np.ndarray, "world *shape"], again: Shaped[np.ndarray, "world *shape"], rounding: float
) -> int:
    """In how many worlds two answers differ."""
    if first.shape != again.shape:
        return len(first)
    same = np.isclose(first.astype(float), again.astype(float), rtol=0.0, atol=rounding, equal_nan=True)
    return int((~same.reshape(len(first), -1).all(axis=1)).sum())


@dataclass(frozen=True)
class Replay(Generic[Shown]):
    """Shows plug-ins without a memory again what the first one was shown.

    Attributes:
        answers: What the answers are called.
        shown: What was shown at each call, with the answers, one per world.
        take: Some worlds of what was shown, as a copy.
        make: Makes a new plug-in, as a function of what is shown. It raises InputError where the plug-in breaks a
            point.
        tolerance: What may differ.
        missing: What is said where nothing was answered.
    """

    answers: str
    shown: Sequence[tuple[Shown, Shaped[np.ndarray, "_ ..."]]]
    take: Callable[[Shown, Int[np.ndarray, "row"]], Shown]
    make: Callable[[], Callable[[Shown], Shaped[np.ndarray, "world *shape"]]]
    tolerance: Tolerance
    missing: str

    def deterministic(self, first: Callable[[Shown], Shaped[np.ndarray, "world *shape"]]) -> Point:
        """Whether a plug-in repeats its answers.

        Args:
            first: The plug-in that gave them. What it has kept since shows, because it is asked from the last call to
                the first.
        """

        def backwards() -> list[Shaped[np.ndarray, "_ ..."]]:
            return [first(self._all(shown)) for shown, _ in reversed(self.shown)][::-1]

        when = "when it is shown the same again, from the last to the first"
        return self._point("deterministic", {when: backwards}, Tolerance(self.tolerance.rounding, 0.0))

    def batch(self) -> Point:
        """Whether the answers are the same in other batches."""
        again = {when: lambda split=split: self._divided(split) for when, split in BATCHES.items()}
        return self._point("batch", again, self.tolerance)

    def changed(
        self,
        name: str,
        changes: Mapping[str, Callable[[Shown], Shown]],
        back: Callable[[np.ndarray], np.ndarray] = lambda answer: answer,
    ) -> Point:
        """Whether the answers are the same where something is changed that must not matter.

        Args:
            name: Name of the point.
            changes: By when the answers might differ, what changes what is shown.
            back: The part of the new answer that must be as before.
        """

        def answers(change: Callable[[Shown], Shown]) -> list[np.ndarray]:
            ask = self.make()
            return [back(ask(change(self._all(shown)))) for shown, _ in self.shown]

        again = {when: functools.partial(answers, change) for when, change in changes.items()}
        return self._point(name, again, self.tolerance)

    def _point(self, name: str, again: Mapping[str, Callable[[], Sequence[np.ndarray]]], tolerance: Tolerance) -> Point:
        if not self.shown:
            return Point(name, None, self.missing)
        return same_point(name, self.answers, [answer for _, answer in self.shown], again, tolerance)

    def _all(self, shown: Shown) -> Shown:
        return self.take(shown, np.arange(len(shown)))  # type: ignore[arg-type]

    def _divided(self, split: Split) -> list[np.ndarray]:
        """The answers of a new plug-in that is shown the rows of each call in other batches."""
        ask = self.make()
        together = []
        for shown, answer in self.shown:
            again = np.empty(answer.shape)
            for rows in split(len(answer)):
                part = ask(self.take(shown, rows))
                if part.shape[1:] != answer.shape[1:]:
                    expected = [len(rows), *answer.shape[1:]]
                    raise InputError(f"the answer has shape {list(part.shape)} instead of {expected}")
                again[rows] = part
            together.append(again)
        return together
