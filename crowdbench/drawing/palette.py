"""The colours of pictures of an episode: on paper and in windows, and in recordings."""

from __future__ import annotations

from typing import NamedTuple

Color = tuple[int, int, int]


class Palette(NamedTuple):
    """The colours of an episode. Vehicle, pedestrians and failures can be told apart by colour-blind readers too."""

    vehicle: Color
    pedestrian: Color
    walked: Color
    hidden: Color
    failure: Color
    faint: Color
    wall: Color
    text: Color
    background: Color


LIGHT = Palette(
    vehicle=(222, 122, 0),
    pedestrian=(38, 104, 178),
    walked=(146, 179, 216),
    hidden=(160, 188, 218),
    failure=(214, 39, 40),
    faint=(228, 228, 222),
    wall=(154, 154, 148),
    text=(70, 70, 70),
    background=(255, 255, 255),
)
"""On paper and in windows."""

DARK = Palette(
    vehicle=(255, 194, 10),
    pedestrian=(94, 169, 255),
    walked=(43, 84, 136),
    hidden=(32, 54, 86),
    failure=(255, 77, 84),
    faint=(72, 78, 90),
    wall=(150, 156, 168),
    text=(255, 255, 255),
    background=(17, 19, 24),
)
"""In recordings, which also have the colours below."""

SUCCESS: Color = (70, 210, 140)
REMEMBERED: Color = (140, 107, 10)
MUTED: Color = (140, 146, 158)
GRID: Color = (33, 36, 43)
ATTENTION: Color = (204, 121, 167)

SCALE: tuple[Color, ...] = ((62, 44, 112), (38, 118, 142), (160, 228, 130))
"""From small to large values, dark to light."""

CURVES: tuple[Color, ...] = ((230, 159, 0), (86, 180, 233), (0, 158, 115), (240, 228, 66), (0, 114, 178), (213, 94, 0))
"""Colours of a planner's own curves, which colour-blind readers can tell apart (Okabe and Ito 2008)."""
