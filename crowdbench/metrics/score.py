"""The score by which planners stand in an order: U = S + 0.005 g.

S is the success rate, and g = clip((Q - a) / (b - a), 0, 1) says how quick a planner is: Q is its success weighted by
completion time (SCT), and a and b are fixed beforehand.
"""

from __future__ import annotations

from typing import NamedTuple

DELTA = 0.005
"""The share of success that being quick is worth, at most."""


class Scale(NamedTuple):
    """The SCT at which being quick is worth nothing, and the one at which it is worth `DELTA`."""

    slow: float = 0.0
    quick: float = 1.0

    @property
    def slope(self) -> float:
        """What a score gains where SCT is larger by 1."""
        return DELTA / (self.quick - self.slow)

    def score(self, success: float, sct: float) -> float:
        """The score of means over a board."""
        return success + self.slope * min(max(sct - self.slow, 0.0), self.quick - self.slow)
