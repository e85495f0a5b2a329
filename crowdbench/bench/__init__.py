"""How fast crowdbench is: all measured in one run, beside navground in turns where that is installed.

CrowdNav's figures alone are recorded ones, and are shown as such.
"""

from __future__ import annotations

from dataclasses import dataclass

NAVGROUND = "navground"

CROWDNAV = "CrowdNav, recorded"


@dataclass(frozen=True)
class Row:
    """Some work: our figure, and another's in the same unit where there is one; then smaller is better."""

    work: str
    ours: float
    unit: str
    theirs: float | None = None
    whose: str = NAVGROUND

    @property
    def ratio(self) -> float | None:
        """How many times quicker we are."""
        return None if self.theirs is None else self.theirs / self.ours


@dataclass(frozen=True)
class Way:
    """A way to decide: its seconds, and in how many decisions and episodes it differs from the slow way."""

    name: str
    seconds: float
    commands: int
    outcomes: int


@dataclass(frozen=True)
class Ways:
    """Ways to make the same decisions, so many in all, in the episodes of the same cases; the slow way first."""

    ways: tuple[Way, ...]
    decisions: int
    episodes: int
