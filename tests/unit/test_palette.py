"""The palette: readable on its ground, by colour-blind readers too, and the same on the pages."""

import itertools
import re
from pathlib import Path

import numpy as np
import pytest

from crowdbench.drawing import DARK, LIGHT, ROLES, SERIES

DEUTERANOPIA = np.array(
    [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
)
"""On linear RGB, at full severity (Machado, Oliveira and Fernandes 2009)."""

XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)
STYLE = Path(__file__).parents[2] / "docs" / "style.css"
PAGES = (255, 255, 255), (30, 33, 41)
"""The backgrounds of the documentation's theme, light and dark."""
GROUNDS = pytest.mark.parametrize("palette", [LIGHT, DARK], ids=["light", "dark"])


def linear(color):
    share = np.array(color) / 255.0
    return np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)


def contrast(one, other):
    """The contrast of two colours by WCAG 2."""
    low, high = sorted(float(linear(color) @ XYZ[1]) for color in (one, other))
    return (high + 0.05) / (low + 0.05)


def lab(rgb):
    """CIELAB of linear RGB, in daylight (D65)."""
    xyz = XYZ @ np.clip(rgb, 0.0, 1.0) / XYZ.sum(axis=1)
    x, y, z = np.where(xyz > 216 / 24389, np.cbrt(xyz), (24389 / 27 * xyz + 16) / 116)
    return 116 * y - 16, 500 * (x - y), 200 * (y - z)


def ciede2000(one, other):
    """The difference of two colours in CIELAB (Sharma, Wu and Dalal 2005)."""
    lightness, a, b = np.transpose([one, other])
    boost = 1.5 - 0.5 * np.sqrt((c := np.hypot(a, b).mean() ** 7) / (c + 25.0**7))
    chroma, hue = np.hypot(boost * a, b), np.degrees(np.arctan2(b, boost * a)) % 360.0
    turn = (hue[1] - hue[0] + 180.0) % 360.0 - 180.0 if chroma.all() else 0.0
    across = hue[0] + turn / 2.0 if chroma.all() else hue.sum()
    mean_l, mean_c = lightness.mean(), chroma.mean()
    cos = [np.cos(np.radians(factor * across + shift)) for factor, shift in ((1, -30), (2, 0), (3, 6), (4, -63))]
    weight = 1.0 + np.array([-0.17, 0.24, 0.32, -0.20]) @ cos
    wide = (mean_l - 50.0) ** 2
    scaled = np.array(
        [
            (lightness[1] - lightness[0]) / (1.0 + 0.015 * wide / np.sqrt(20.0 + wide)),
            (chroma[1] - chroma[0]) / (1.0 + 0.045 * mean_c),
            2.0 * np.sqrt(chroma.prod()) * np.sin(np.radians(turn / 2.0)) / (1.0 + 0.015 * mean_c * weight),
        ]
    )
    rotation = 60.0 * np.exp(-((((across % 360.0) - 275.0) / 25.0) ** 2))
    rotated = -2.0 * np.sqrt(mean_c**7 / (mean_c**7 + 25.0**7)) * np.sin(np.radians(rotation))
    return float(np.sqrt((scaled**2).sum() + rotated * scaled[1] * scaled[2]))


def test_the_difference_is_that_of_published_pairs():
    """Pairs 1, 7, 13, 17 and 25 of Table 1 of Sharma, Wu and Dalal (2005)."""
    pairs = [
        ((50.0, 2.6772, -79.7751), (50.0, 0.0, -82.7485), 2.0425),
        ((50.0, 0.0, 0.0), (50.0, -1.0, 2.0), 2.3669),
        ((50.0, -0.001, 2.49), (50.0, 0.0011, -2.49), 4.7461),
        ((50.0, 2.5, 0.0), (73.0, 25.0, -18.0), 27.1492),
        ((60.2574, -34.0099, 36.2677), (60.4626, -34.1751, 39.4387), 1.2644),
    ]
    for one, other, expected in pairs:
        assert ciede2000(one, other) == pytest.approx(expected, abs=1e-4)


@GROUNDS
@pytest.mark.parametrize("sight", [np.eye(3), DEUTERANOPIA], ids=["normal", "deuteranopia"])
def test_roles_can_be_told_apart(palette, sight):
    seen = {role: lab(sight @ linear(getattr(palette, role))) for role in ROLES}
    differences = {pair: ciede2000(seen[pair[0]], seen[pair[1]]) for pair in itertools.combinations(ROLES, 2)}
    assert min(differences.values()) >= 15.0, min(differences, key=differences.get)


@GROUNDS
def test_marks_and_texts_have_contrast(palette):
    for role in (*ROLES, "wall"):
        assert contrast(getattr(palette, role), palette.background) >= 3.0, role
    for role in ("text", "contact", "success"):
        assert contrast(getattr(palette, role), palette.background) >= 4.5, role


def test_series_of_figures_are_those_of_okabe_and_ito():
    assert SERIES[:2] == [(0, 114, 178), (230, 159, 0)]
    assert len(set(SERIES)) == 8


@pytest.mark.parametrize(("palette", "theme"), [(LIGHT, 0), (DARK, 1)], ids=["light", "dark"])
def test_the_pages_have_the_palette(palette, theme):
    css = STYLE.read_text()
    assert re.findall(r"--contact: (#[0-9a-f]{6});", css)[theme] == f"#{bytes(palette.contact).hex()}"
    assert contrast(palette.contact, PAGES[theme]) >= 3.0
