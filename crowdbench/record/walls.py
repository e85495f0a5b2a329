"""What a recording shows of obstacles."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr
from jaxtyping import Float
from rerun.chunk import Chunk

from crowdbench.record.chunks import still
from crowdbench.record.style import WALL

HATCHING = 0.25
"""Distance in metres between the lines that fill an obstacle."""


def drawn(walls: Sequence[Float[np.ndarray, "_ 2"]]) -> Chunk:
    """The obstacles: their outlines, those of solid ones closed and hatched.

    Args:
        walls: The corners of each in metres.
    """
    outlines = [np.concatenate([wall, wall[:1]]) if len(wall) > 2 else wall for wall in walls]
    lines = [*outlines, *(line for wall in walls if len(wall) > 2 for line in _hatching(wall))]
    widths = rr.Radius.ui_points([2.0] * len(outlines) + [0.75] * (len(lines) - len(outlines)))
    return still("world/walls", rr.LineStrips2D(lines, colors=[WALL] * len(lines), radii=widths, draw_order=2))


def _hatching(polygon: Float[np.ndarray, "corner 2"]) -> list[Float[np.ndarray, "2 2"]]:
    """Lines at 45 degrees within a polygon, because the viewer fills none.

    Args:
        polygon: Its corners in metres.
    """
    # Turned by 45 degrees, the lines are horizontal: each crosses the edges where it enters and where it leaves.
    turned = polygon @ np.array([[1.0, 1.0], [-1.0, 1.0]]) / np.sqrt(2.0)
    after = np.roll(turned, -1, axis=0)
    low, high = turned[:, 1].min(), turned[:, 1].max()
    lines = []
    for y in np.arange(np.ceil(low / HATCHING) * HATCHING, high, HATCHING):
        crossed = (turned[:, 1] > y) != (after[:, 1] > y)
        a, b = turned[crossed], after[crossed]
        x = np.sort(a[:, 0] + (y - a[:, 1]) / (b[:, 1] - a[:, 1]) * (b[:, 0] - a[:, 0]))
        ends = np.stack([x, np.full(len(x), y)], axis=1) @ np.array([[1.0, -1.0], [1.0, 1.0]]) / np.sqrt(2.0)
        lines += list(ends.reshape(-1, 2, 2))
    return lines
