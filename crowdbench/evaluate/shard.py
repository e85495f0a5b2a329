"""Shares of some work, of which each is done by another process."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

from crowdbench.errors import InputError

T = TypeVar("T")


@dataclass(frozen=True)
class Shard:
    """One of several equal shares, written `2/8`.

    Attributes:
        number: Which one, counted from 1.
        count: How many there are.
    """

    number: int = 1
    count: int = 1

    @classmethod
    def parse(cls, text: str) -> Shard:
        """Read `2/8`. Raises InputError where the text has another form, or there is no such shard."""
        match = re.fullmatch("([0-9]{1,9})/([0-9]{1,9})", text)
        if match and 1 <= int(match[1]) <= int(match[2]):
            return cls(int(match[1]), int(match[2]))
        raise InputError(f"{text!r} is no shard: write 2/8 for the second of eight")

    def own(self, all_of: Sequence[T]) -> Sequence[T]:
        """Its share of the parts of a run, or of the runs of a study."""
        return all_of[self.number - 1 :: self.count]

    def rotated(self, by: int) -> Shard:
        """Another share of the same number of shares, so that those of several short runs are spread evenly.

        Args:
            by: The number of the run.
        """
        return Shard((self.number - 1 + by) % self.count + 1, self.count)


WHOLE = Shard()
