"""The colours of recordings. Yellow, blue and red can be told apart by colour-blind readers too."""

from __future__ import annotations

Color = tuple[int, int, int]

VEHICLE: Color = (255, 194, 10)
PEDESTRIAN: Color = (94, 169, 255)
WALKED: Color = (43, 84, 136)
HIDDEN: Color = (32, 54, 86)
REMEMBERED: Color = (140, 107, 10)
FAILURE: Color = (255, 77, 84)
SUCCESS: Color = (70, 210, 140)
ARROW: Color = (255, 255, 255)
MUTED: Color = (140, 146, 158)
FAINT: Color = (72, 78, 90)
GRID: Color = (33, 36, 43)
WALL: Color = (150, 156, 168)
BACKGROUND: Color = (17, 19, 24)

ATTENTION: Color = (204, 121, 167)

SCALE: tuple[Color, ...] = ((62, 44, 112), (38, 118, 142), (160, 228, 130))
"""From small to large values, dark to light."""

CURVES: tuple[Color, ...] = ((230, 159, 0), (86, 180, 233), (0, 158, 115), (240, 228, 66), (0, 114, 178), (213, 94, 0))
"""Colours of a planner's own curves, which colour-blind readers can tell apart (Okabe and Ito 2008)."""
