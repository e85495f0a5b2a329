"""Shares of some work for processes that share nothing, such as tasks of a cluster's array job."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

from crowdbench.scenario.cases import Cases
from crowdbench.utils.errors import InputError

T = TypeVar("T")


@dataclass(frozen=True)
class Shard:
    """One of several equal shares of some work for different processes, written as `2/8`.

    Attributes:
        number: Number of this share, from 1.
        count: Number of shares.
    """

    number: int = 1
    count: int = 1

    @classmethod
    def parse(cls, text: str | None) -> Shard:
        """Parse a text such as `2/8`; None is the whole work. Raises InputError if the text is no valid shard."""
        if text is None:
            return WHOLE
        match = re.fullmatch("([0-9]{1,9})/([0-9]{1,9})", text)
        if match and 1 <= int(match[1]) <= int(match[2]):
            return cls(int(match[1]), int(match[2]))
        raise InputError(f"{text!r} is no shard: write 2/8 for the second of eight")

    def __str__(self) -> str:
        return f"{self.number}/{self.count}"

    def select(self, work: Sequence[T]) -> Sequence[T]:
        """Return the runs of a study that belong to this shard."""
        return work[self.number - 1 :: self.count]

    def share(self, cases: Cases) -> Cases:
        """Return the cases of a run that belong to this shard. There are none if the run has fewer cases than shards.

        Shares differ by one case at most.
        """
        start, stop = (cases.start + len(cases) * end // self.count for end in (self.number - 1, self.number))
        return Cases(cases.split, start, stop)


WHOLE = Shard()
