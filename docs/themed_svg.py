"""Makes SVG figures of Matplotlib small, and dark on dark pages."""

import re
from pathlib import Path

from crowdbench.drawing import DARK, LIGHT

OTHERS = {
    "000000": "ffffff",
    "0072b2": "4da6de",
    "e69f00": "f0b429",
    "009e73": "2cc295",
    "cc79a7": "e0a0c4",
    "1f6296": "74b6f2",
    "c2542d": "f0895f",
    "b0b0b0": "484e5a",
    "dddddd": "343945",
    "999999": "6f7582",
    "fff3c8": "4b4223",
    "101010": "101010",
    "f8f8f8": "f8f8f8",
}
"""Dark colours for those that are in no palette: axes, grids, series, a field of view, and numbers in cells."""

WASTE = (
    (r"<metadata>.*?</metadata>\s*|<\?xml.*?\?>\s*|<!DOCTYPE[^>]*>\s*|<!--.*?-->\s*", ""),
    (r"\n\s+", "\n"),
    (r' id="(?:patch|line2d|text|PathCollection|FillBetween\w*)_\d+"', ""),
    (r"<g>\n(<(?:path|text)[^>]*(?:/>|>[^<]*</text>))\n</g>", r"\1"),
    (r"; stroke-linejoin: miter", ""),
    (r"font-family: [^;\"]*", "font-family: 'DejaVu Sans', sans-serif"),
)
"""Patterns of parts that no browser needs, and their replacements, in order."""

LARGER, MARGIN = 1.6, 4.0
"""Size on a page, as a multiple of that on paper, and points by which a line is wider than its path."""


def adapt(path: Path) -> None:
    """Rewrite a figure, smaller, and with a style for dark pages."""
    text = shrink(path.read_text())
    text = re.sub(
        r'(?<= width=")[\d.]+(?=pt")|(?<= height=")[\d.]+(?=pt")', lambda size: _enlarge(size[0]), text, count=2
    )
    path.write_text(text.replace("<defs>", f"<style>{_dark(text)}</style>\n<defs>", 1))


def shrink(text: str) -> str:
    """Return a figure without metadata and paths outside of its panels, with circles, and one decimal in paths."""
    for pattern, replacement in WASTE:
        text = re.sub(pattern, replacement, text, flags=re.DOTALL)
    box = r'<clipPath id="(\w+)">\s*<rect x="([\d.]+)" y="([\d.]+)" width="([\d.]+)" height="([\d.]+)"'
    panels = {name: [float(value) for value in values] for name, *values in re.findall(box, text)}
    clipped = re.compile(r'<path d="([^"]*)" clip-path="url\(#(\w+)\)"[^>]*/>\s*')
    text = clipped.sub(lambda found: found[0] if _is_inside(found[1], panels[found[2]]) else "", text)
    text = re.sub(r'<path d="([^"]*)"', lambda found: _circle(found[1]) or found[0], text)
    return re.sub(r'(?<= d=")[^"]*', lambda found: _shorten(found[0]), text)


def _is_inside(path: str, panel: list[float]) -> bool:
    """Return whether a part of a path may be inside of a panel, given as x, y, width and height."""
    numbers = [float(number) for number in re.findall(r"-?\d+\.?\d*", path)]
    return all(
        max(values) > start - MARGIN and min(values) < start + size + MARGIN
        for values, start, size in zip((numbers[::2], numbers[1::2]), panel[:2], panel[2:], strict=True)
    )


def _circle(path: str) -> str:
    """Return the beginning of a circle in place of the eight curves that Matplotlib draws, or "" for other paths."""
    if re.findall("[A-Za-z]", path) != ["M", *"C" * 8, "z"]:
        return ""
    points = [(float(x), float(y)) for x, y in re.findall(r"(-?\d+\.?\d*) (-?\d+\.?\d*)", path)]
    (x, top), (_, bottom) = points[0], points[12]
    return f'<circle cx="{x:.1f}" cy="{(top + bottom) / 2:.1f}" r="{abs(top - bottom) / 2:.2f}"'


def _enlarge(size: str) -> str:
    return f"{LARGER * float(size):.1f}"


def _shorten(path: str) -> str:
    """Return the commands of a path with one decimal, on one line."""
    short = re.sub(r"-?\d+\.\d+", lambda number: f"{float(number[0]):.1f}".rstrip("0").rstrip("."), path)
    return re.sub(r" ?\n", "", short).replace(" z", "z")


def _dark(text: str) -> str:
    """Return a style that replaces the light colours of a figure where the page is dark."""
    colours = {bytes(light).hex(): bytes(dark).hex() for light, dark in zip(LIGHT, DARK, strict=True)} | OTHERS
    rules = ["text{fill:#fff}"]
    for light, dark in colours.items():
        for kind in ("fill", "stroke"):
            if f"{kind}: #{light}" in text:
                rules.append(f'[style*="{kind}: #{light}"]{{{kind}:#{dark}!important}}')
    return f"@media (prefers-color-scheme: dark){{{''.join(rules)}}}"


def differ(one: str, other: str) -> bool:
    """Return whether two figures differ in more than a pixel: machines differ in rounding."""
    number = r"-?\d+\.?\d*"
    if re.sub(number, "", one) != re.sub(number, "", other):
        return True
    pairs = zip(re.findall(number, one), re.findall(number, other), strict=True)
    return any(abs(float(first) - float(second)) > 1.0 for first, second in pairs)
