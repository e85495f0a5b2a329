"""How fast crowdbench is, beside navground where that is installed: ratios measured in one run."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Row:
    """Some work: our figure and navground's, in the same unit; smaller is better."""

    work: str
    ours: float
    unit: str
    theirs: float | None = None

    @property
    def ratio(self) -> float | None:
        """How many times quicker we are."""
        return None if self.theirs is None else self.theirs / self.ours
