"""Ranges of cases, written as `500`, `2000:2500` or `val:100`, and single cases, written as `test:37`."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Int

from crowdbench.core.rng import SPLITS
from crowdbench.utils.errors import InputError

LAST = 2**62
"""Case numbers are smaller than this."""

_NUMBER = "[0-9]{1,19}"


@dataclass(frozen=True)
class Cases:
    """A range of cases of one split.

    Attributes:
        split: `train`, `val` or `test`.
        start: Number of the first case.
        stop: Number after the last case.
    """

    split: str
    start: int
    stop: int

    @classmethod
    def parse(cls, text: str) -> Cases:
        """Read `[split:]count` or `[split:]start:stop`, without a split for test cases.

        Raises InputError where the text has another form or the range is empty.
        """
        match = re.fullmatch(rf"(?:([a-z]+):)?(?:({_NUMBER}):)?({_NUMBER})", text)
        if match and (match[1] or "test") in SPLITS:
            cases = cls(match[1] or "test", int(match[2] or 0), int(match[3]))
            if cases.start < cases.stop <= LAST:
                return cases
        raise InputError(
            f"cases {text!r} are not a range of cases: write 500 (the first 500 test cases), 2000:2500 or val:100 "
            f"(splits: {', '.join(SPLITS)})"
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
        """The cases in order, in ranges of at most `size` cases."""
        for start in range(self.start, self.stop, size):
            yield Cases(self.split, start, min(start + size, self.stop))


def parse_case(text: str) -> tuple[str, int]:
    """Read the name of a case, `split:number`. Raises InputError where the text has another form."""
    match = re.fullmatch(rf"([a-z]+):({_NUMBER})", text)
    if match and match[1] in SPLITS and int(match[2]) < LAST:
        return match[1], int(match[2])
    raise InputError(f"case {text!r} is not the name of a case: write test:37 (splits: {', '.join(SPLITS)})")
