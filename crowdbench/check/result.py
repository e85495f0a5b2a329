"""The results of checks, and what was found at each while a plug-in was at work: for every kind of plug-in."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from crowdbench.utils.errors import InputError


@dataclass(frozen=True)
class CheckResult:
    """The result of one check of a contract.

    Attributes:
        name: What the check is called.
        kept: Whether the plug-in keeps this part of its contract; None where that could not be examined.
        seen: What was seen, in a few words.
    """

    name: str
    kept: bool | None
    seen: str


UNEXAMINED_SIGHT = CheckResult("limited sight", None, "not examined: another point is broken")


class Findings:
    """What each check has found while a plug-in was at work.

    Attributes:
        answers: What its answers are called, such as `commands`.
        missing: What is said of a check that could not be made.
        faults: The first fault that each check found.
        examined: How many answers each check has examined.
    """

    def __init__(self, answers: str, missing: str) -> None:
        self.answers = answers
        self.missing = missing
        self.faults: dict[str, str] = {}
        self.examined: Counter[str] = Counter()

    def note(self, check: str, number: int, fault: str | None) -> None:
        """Note that a check has examined a number of answers, and what is wrong with one of them, as a sentence."""
        self.examined[check] += number
        if fault is not None:
            self.faults.setdefault(check, fault)

    def examine(self, number: int, steps: Mapping[str, Callable[[Any], Any]]) -> Any:
        """Examine answers in steps.

        Args:
            number: The number of answers.
            steps: By check, what makes something of the result of the step before (of None, at first), or raises an
                InputError where the answers fail the check.

        Returns:
            The result of the last step; None where a check fails, after which no further one is made.
        """
        result = None
        for check, step in steps.items():
            try:
                result = step(result)
            except InputError as error:
                self.note(check, number, str(error))
                return None
            self.note(check, number, None)
        return result

    def result(self, check: str, kept: str) -> CheckResult:
        """The result of a check in all that it has examined; `kept` is said where nothing is wrong."""
        if check in self.faults:
            return CheckResult(check, False, self.faults[check])
        if not self.examined[check]:
            return CheckResult(check, None, self.missing)
        return CheckResult(check, True, f"{kept} ({self.examined[check]} {self.answers})")


def find_change(path: str, before: Any, after: Any) -> tuple[str, int] | None:
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
