"""Ranges of cases, written as `500`, `20:60`, `val:60` or `val:20:60`, and single cases, written as `val/37`."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Int

from crowdbench.core.rng import SPLITS
from crowdbench.utils.errors import InputError, require

LAST = 2**62
"""Case numbers are smaller than this."""

MOST = 1_000_000
"""Largest number of cases at once."""

_NUMBER = "[0-9]{1,19}"


@dataclass(frozen=True)
class Cases:
    """A range of cases of one split.

    Attributes:
        split: `train`, `val` or `test`.
        start: Number of the first case.
        stop: Number after the last case.

    Raises:
        InputError: There is no such split, a number is no case number, or there are more than `MOST` cases.
    """

    split: str
    start: int
    stop: int

    def __post_init__(self) -> None:
        is_split = isinstance(self.split, str) and self.split in SPLITS
        require("split", self.split, is_split, f"one of {', '.join(SPLITS)}")
        for name in ("start", "stop"):
            number = getattr(self, name)
            is_case = isinstance(number, int | np.integer) and bool(0 <= number <= LAST)
            require(name, number, is_case, "the number of a case, 0 or more")
        require("stop", self.stop, self.start <= self.stop, f"{self.start} or more, which is the first case")
        if len(self) > MOST:
            raise InputError(f"cases {self} are {len(self)} cases, but must be at most {MOST}")

    @classmethod
    def parse(cls, text: str) -> Cases:
        """Read `[split:]count`, `[split:]start:stop` or the name of a single case; without a split they are test cases.

        Raises InputError if the text has another form, or the range is empty or too long.
        """
        require("cases", text, isinstance(text, str), "a text such as 'val:100'")
        if "/" in text:
            split, number = parse_case(text)
            return cls(split, number, number + 1)
        match = re.fullmatch(rf"(?:([a-z]+):)?(?:({_NUMBER}):)?({_NUMBER})", text)
        if match and (match[1] or "test") in SPLITS:
            start, stop = int(match[2] or 0), int(match[3])
            if start < stop <= LAST:
                return cls(match[1] or "test", start, stop)
        raise InputError(
            f"cases {text!r} are not a range of cases: write 500 (the first 500 test cases), 2000:2500, val:100 or "
            f"val/37 (one case; splits: {', '.join(SPLITS)})"
        )

    def __str__(self) -> str:
        return f"{self.split}:{self.start}:{self.stop}"

    def __len__(self) -> int:
        return self.stop - self.start

    @property
    def indices(self) -> Int[np.ndarray, "world"]:
        """The case numbers."""
        return np.arange(self.start, self.stop)

    def batches(self, size: int) -> Iterator[Cases]:
        """Yield the cases in order, in ranges of at most `size` cases."""
        for start in range(self.start, self.stop, size):
            yield Cases(self.split, start, min(start + size, self.stop))


def parse_case(text: str, split: str | None = None) -> tuple[str, int]:
    """Read the name of a case, `split/number`, or only its number if the split is known.

    Raises InputError if the text has another form.
    """
    match = re.fullmatch(rf"(?:([a-z]+)/)?({_NUMBER})", text)
    if match and (match[1] or split) in SPLITS and int(match[2]) < LAST:
        return match[1] or str(split), int(match[2])
    looks_like_range = re.fullmatch(rf"([a-z]+):({_NUMBER})", text)
    right = f"{looks_like_range[1]}/{looks_like_range[2]}" if looks_like_range else "test/37"
    raise InputError(f"case {text!r} is not the name of a case: write {right} (splits: {', '.join(SPLITS)})")
