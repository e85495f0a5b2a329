"""Makes SVG figures of Matplotlib small, and dark on dark pages."""

import re
from pathlib import Path

from crowdbench.drawing import DARK, LIGHT

OTHERS = {
    "000000": "ffffff",
    "0072b2": "4da6de",
    "1f6296": "74b6f2",
    "c2542d": "f0895f",
    "b0b0b0": "484e5a",
    "dddddd": "343945",
    "999999": "6f7582",
    "fff3c8": "4b4223",
}
"""Dark colours for those that are in no palette: axes, grids, series, and a field of view."""

HEAD = r"<metadata>.*?</metadata>\s*|<\?xml.*?\?>\s*|<!DOCTYPE[^>]*>\s*"
"""Parts that no browser needs."""

LARGER = 1.6
"""Size on a page, as a multiple of that on paper."""


def adapt(path: Path) -> None:
    """Rewrite a figure larger, with two decimals, without metadata, and with a style for dark pages."""
    text = re.sub(HEAD, "", path.read_text(), flags=re.DOTALL)
    text = re.sub(
        r'(?<=width=")[\d.]+(?=pt")|(?<=height=")[\d.]+(?=pt")', lambda size: _enlarge(size[0]), text, count=2
    )
    text = re.sub(r'(?<= d=")[^"]*', lambda found: _shorten(found[0]), text)
    path.write_text(text.replace("<defs>", f"<style>{_dark(text)}</style>\n <defs>", 1))


def _enlarge(size: str) -> str:
    return f"{LARGER * float(size):.1f}"


def _shorten(path: str) -> str:
    """Return the commands of a path with two decimals, on one line."""
    short = re.sub(r"-?\d+\.\d+", lambda number: f"{float(number[0]):.2f}".rstrip("0").rstrip("."), path)
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
