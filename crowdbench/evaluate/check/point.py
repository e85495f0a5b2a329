"""The points of a contract, what was found at each, and whether arrays are as they were: for every kind of plug-in."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from crowdbench.errors import InputError


@dataclass(frozen=True)
class Point:
    """One point of a contract.

    Attributes:
        name: What it is called.
        kept: Whether the plug-in keeps it; None where that could not be examined.
        seen: What was seen, in a few words.
    """

    name: str
    kept: bool | None
    seen: str


class Findings:
    """What was found at each point while a plug-in was at work.

    Attributes:
        answers: What its answers are called, such as `commands`.
        missing: What is said of a point that could not be examined.
        faults: The first fault at each point.
        examined: At how many answers each point could be examined.
    """

    def __init__(self, answers: str, missing: str) -> None:
        self.answers = answers
        self.missing = missing
        self.faults: dict[str, str] = {}
        self.examined: Counter[str] = Counter()

    def note(self, point: str, number: int, fault: str | None) -> None:
        """Note that answers were examined at a point.

        Args:
            point: The name of the point.
            number: The number of answers.
            fault: What is wrong with one of them, as a sentence; None if nothing is.
        """
        self.examined[point] += number
        if fault is not None:
            self.faults.setdefault(point, fault)

    def examine(self, number: int, steps: Mapping[str, Callable[[Any], Any]]) -> Any:
        """Examine answers in steps.

        Args:
            number: The number of answers.
            steps: By point, what makes something of the result of the step before (of None, at first), or raises an
                InputError where the answers break the point.

        Returns:
            The result of the last step; None where a point is broken, after which no further one is examined.
        """
        result = None
        for point, step in steps.items():
            try:
                result = step(result)
            except InputError as error:
                self.note(point, number, str(error))
                return None
            self.note(point, number, None)
        return result

    def point(self, name: str, kept: str) -> Point:
        """Whether a point was kept in all that was examined.

        Args:
            name: Name of the point.
            kept: What is said where it is kept.
        """
        if name in self.faults:
            return Point(name, False, self.faults[name])
        if not self.examined[name]:
            return Point(name, None, self.missing)
        return Point(name, True, f"{kept} ({self.examined[name]} {self.answers})")


def time_point(name: str, seconds: list[float], limit: float, missing: str) -> Point:
    """How long calls took.

    Args:
        name: Name of the point.
        seconds: The time of each call.
        limit: Seconds that a call may take.
        missing: What is said where there was no call.
    """
    if not seconds:
        return Point(name, None, missing)
    mean, longest = sum(seconds) / len(seconds), max(seconds)
    return Point(name, longest <= limit, f"{1e3 * mean:.3g} ms per call, at most {longest:.3g} s (limit {limit:g} s)")


def changed(path: str, before: Any, after: Any) -> tuple[str, int] | None:
    """The first array that is another than before: its name, and the index of the world. None where none is.

    Args:
        path: What the whole is called.
        before: A copy that was made before: a dataclass, or mappings, with arrays `[world, ...]` in it.
        after: The same as it is now.
    """
    old, new = dict(_arrays(path, before)), dict(_arrays(path, after))
    for name in old | new:
        if name not in old or name not in new or old[name].shape != new[name].shape:
            return name, 0
        same = (old[name] == new[name]) | ((old[name] != old[name]) & (new[name] != new[name]))
        if not same.all():
            return name, int(np.argwhere(~same)[0, 0])
    return None


def _arrays(path: str, part: Any) -> Iterator[tuple[str, np.ndarray]]:
    if isinstance(part, np.ndarray):
        yield path, part
    elif isinstance(part, Mapping):
        for name, value in part.items():
            yield from _arrays(f"{path}[{name!r}]", value)
    elif dataclasses.is_dataclass(part):
        for field in dataclasses.fields(part):
            yield from _arrays(f"{path}.{field.name}", getattr(part, field.name))
