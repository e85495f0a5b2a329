"""Draws docs/heat.svg, success of planners in the suite: python docs/heat_figure.py.

The numbers come from the tables in studies/suite/README.md. Text is drawn on filled cells, so that the figure can be
read on a light and on a dark page.
"""

import re
from html import escape
from pathlib import Path

from tables import split_row

DOCS = Path(__file__).parent
FIGURE = DOCS / "heat.svg"
COLUMNS = {  # scenario: heading of its column
    "circle_crossing_20_seen": "circle, seen",
    "groups_12": "groups",
    "car_28": "car",
    "intersection_16_seen": "streams, seen",
    "corridor_8": "corridor",
    "doorway_10": "door",
    "blind_corner_5": "corner",
    "circle_crossing_20": "circle",
    "intersection_16": "streams",
    "half_half_20": "mixed",
    "unicycle_10": "unicycle",
    "restless_20": "restless",
    "noisy_10": "noise",
    "blocks_12": "blocks",
    "blocks_12_perfect_sight": "blocks, seen",
}
LEFT, TOP, WIDE, HIGH = 166, 84, 49, 26
INK = "#10151a"
LOW, MIDDLE, FULL = (194, 84, 45), (246, 236, 214), (31, 98, 150)
"""Colours of 0, 50 and 100 %, which differ in lightness and can be distinguished by colour-blind readers."""


def successes() -> dict[str, dict[str, float]]:
    """Return the success in % by planner and scenario."""
    text = (DOCS.parent / "studies" / "suite" / "README.md").read_text()
    found: dict[str, dict[str, float]] = {}
    for table in reversed(re.findall(r"^\| success, %[^\n]+\n(?:\|.+\n)+", text, re.MULTILINE)):
        head, _, *rows = map(split_row, table.splitlines())
        for name, *cells in rows:
            for planner, cell in zip(head[1:], cells, strict=True):
                if match := re.match(r"[\d.]+", cell):
                    behind = re.match(r"filtered \(name=(\w+)\)", planner)
                    label = behind[1] if behind else re.sub(r",? \(?\d+ networks.*", "", planner)
                    found.setdefault(label, {})[name] = float(match[0])
    whole = {planner: values for planner, values in found.items() if set(COLUMNS) <= set(values)}
    mean = {planner: sum(values[name] for name in COLUMNS) / len(COLUMNS) for planner, values in whole.items()}
    return {planner: {"mean": mean[planner], **whole[planner]} for planner in sorted(mean, key=mean.get, reverse=True)}


def colour(value: float) -> tuple[int, int, int]:
    """Return the colour of a success in %."""
    low, high, part = (LOW, MIDDLE, value / 50.0) if value < 50.0 else (MIDDLE, FULL, value / 50.0 - 1.0)
    return tuple(round(a + (b - a) * part) for a, b in zip(low, high, strict=True))


def luminance(*colour: int) -> float:
    """Return the relative luminance of a colour, as WCAG 2.2 defines it."""
    linear = [c / 3294.6 if c <= 10 else ((c / 255 + 0.055) / 1.055) ** 2.4 for c in colour]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def figure() -> str:
    """Return the figure in SVG."""
    found = successes()
    columns = {"mean": "mean", **COLUMNS}
    width, height = LEFT + WIDE * len(columns) + 36, TOP + HIGH * len(found) + 6
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" '
        'font-family="system-ui, sans-serif" font-size="13">',
        "<title>Success of planners in the scenarios of the suite, in %</title>",
        f'<rect width="{width}" height="{height}" rx="6" fill="#ffffff"/>',
    ]
    for i, title in enumerate(columns.values()):
        place = f"translate({LEFT + WIDE * (i + 0.5) + 4} {TOP - 6}) rotate(-45)"
        parts.append(f'<text transform="{place}" fill="{INK}">{escape(title)}</text>')
    for row, (planner, values) in enumerate(found.items()):
        y = TOP + HIGH * row
        parts.append(f'<text x="{LEFT - 8}" y="{y + 18}" text-anchor="end" fill="{INK}">{escape(planner)}</text>')
        parts += [_cell(LEFT + WIDE * i, y, values[name], name == "mean") for i, name in enumerate(columns)]
    return "\n".join([*parts, "</svg>"]) + "\n"


def _cell(x: int, y: int, value: float, is_bold: bool) -> str:
    red, green, blue = colour(value)
    ink = "#ffffff" if luminance(red, green, blue) < 0.18 else INK
    box = f'<rect x="{x}" y="{y}" width="{WIDE - 2}" height="{HIGH - 2}" fill="rgb({red},{green},{blue})"/>'
    style = f'text-anchor="middle" fill="{ink}" font-weight="{700 if is_bold else 400}"'
    return f'{box}<text x="{x + WIDE / 2 - 1}" y="{y + 17}" {style}>{value:.0f}</text>'


if __name__ == "__main__":
    FIGURE.write_text(figure())
