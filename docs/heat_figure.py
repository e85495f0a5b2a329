"""Draws docs/heat_light.svg and heat_dark.svg, scores of planners on the suite: python docs/heat_figure.py.

The numbers come from the tables in studies/suite/README.md.
"""

from html import escape
from pathlib import Path

from tables import split_row

DOCS = Path(__file__).parent
INKS = {DOCS / "heat_light.svg": "#10151a", DOCS / "heat_dark.svg": "#e8eaee"}
"""The colour of the texts beside the cells in each figure."""

COLUMNS = {  # scenario: heading of its column
    "circle_20": "density",
    "streets_16": "crossing flows",
    "door_10": "door",
    "street_8": "oncoming flow",
    "corner_5": "occlusion",
    "groups_12": "groups",
    "car_28": "car",
    "mixed_20": "mixed",
    "blocks_12": "obstacles",
}
MEANS = {"perfect": "mean, perfect", "realistic": "mean, realistic"}
LEFT, TOP, WIDE, HIGH = 166, 84, 49, 26
DARK_INK = "#10151a"
LOW, MIDDLE, FULL = (194, 84, 45), (246, 236, 214), (31, 98, 150)
"""Colours of scores of 0, 0.5 and 1, which differ in lightness and can be distinguished by colour-blind readers."""


def scores() -> dict[str, dict[str, float]]:
    """Return the mean score in both tracks and the scores with perfect sensing, by planner, best planner first."""
    text = (DOCS.parent / "studies" / "suite" / "README.md").read_text()
    tables = {}
    for track in MEANS:
        section = text.split(f"## Scores with {track} sensing\n")[1]
        head, _, *rows = [split_row(line) for line in section.strip().split("\n\n")[0].splitlines()]
        tables[track] = {name: dict(zip(head[1:], map(float, cells), strict=True)) for name, *cells in rows}
    perfect, realistic = tables.values()
    return {
        name: {"perfect": values["mean"], "realistic": realistic[name]["mean"], **values}
        for name, values in perfect.items()
    }


def colour(value: float) -> tuple[int, int, int]:
    """Return the colour of a score."""
    low, high, part = (LOW, MIDDLE, 2.0 * value) if value < 0.5 else (MIDDLE, FULL, 2.0 * value - 1.0)
    return tuple(round(a + (b - a) * part) for a, b in zip(low, high, strict=True))


def luminance(*colour: int) -> float:
    """Return the relative luminance of a colour, as WCAG 2.2 defines it."""
    linear = [c / 3294.6 if c <= 10 else ((c / 255 + 0.055) / 1.055) ** 2.4 for c in colour]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def figure(ink: str) -> str:
    """Return the figure in SVG, with the colour of the texts beside the cells."""
    found = scores()
    columns = {**MEANS, **COLUMNS}
    width, height = LEFT + WIDE * len(columns) + 36, TOP + HIGH * len(found) + 6
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" '
        'font-family="system-ui, sans-serif" font-size="13">',
        "<title>Scores of planners on the suite</title>",
    ]
    for i, title in enumerate(columns.values()):
        place = f"translate({LEFT + WIDE * (i + 0.5) + 4} {TOP - 6}) rotate(-45)"
        parts.append(f'<text transform="{place}" fill="{ink}">{escape(title)}</text>')
    for row, (planner, values) in enumerate(found.items()):
        y = TOP + HIGH * row
        parts.append(f'<text x="{LEFT - 8}" y="{y + 18}" text-anchor="end" fill="{ink}">{escape(planner)}</text>')
        parts += [_cell(LEFT + WIDE * i, y, values[name], name in MEANS) for i, name in enumerate(columns)]
    return "\n".join([*parts, "</svg>"]) + "\n"


def _cell(x: int, y: int, value: float, is_bold: bool) -> str:
    red, green, blue = colour(value)
    ink = "#ffffff" if luminance(red, green, blue) < 0.18 else DARK_INK
    box = f'<rect x="{x}" y="{y}" width="{WIDE - 2}" height="{HIGH - 2}" fill="rgb({red},{green},{blue})"/>'
    style = f'text-anchor="middle" fill="{ink}" font-weight="{700 if is_bold else 400}"'
    return f'{box}<text x="{x + WIDE / 2 - 1}" y="{y + 17}" {style}>{value:.2f}</text>'


if __name__ == "__main__":
    for path, color in INKS.items():
        path.write_text(figure(color))
