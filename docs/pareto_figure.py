"""Draws the figure of time against closeness on the page of the suite, whose dots play a case in the game.

The numbers come from the tables in studies/suite/README.md, the cases from docs/cross/cases.
"""

from heat_figure import DOCS, MEANS, scores
from reference import game
from tables import split_row

WIDTH, HEIGHT, LEFT, BOTTOM, TOP = 720, 420, 52, 46, 14
TIMES, CLOSE = (0.9, 2.4), (0.0, 0.8)
"""The ranges of both axes."""

RADIUS = 13.0
"""Radius of the dot of a planner that always succeeds, in pixels. The area is the success."""

PLACES = ((0.0, -15.0, "mid"), (0.0, 24.0, "mid"), (15.0, 4.0, "start"), (-15.0, 4.0, "end"))
"""Places of a name, in order of preference: x and y from its dot in pixels, and the part of the text at this place."""

LETTER, ASCENT, DESCENT = 7.4, 10.0, 2.0
"""Width of a letter of a name in pixels, and heights above and below its line."""

Box = tuple[float, float, float, float]
"""The smallest and largest x and y of a rectangle: x0, y0, x1, y1."""


def parts(track: str) -> dict[str, tuple[float, float, float]]:
    """Return success in %, time and time close to pedestrians of each planner, as multiples of the least time."""
    text = (DOCS.parent / "studies/suite/README.md").read_text()
    section = text.split(f"## Parts of the score with {track} sensing\n")[1]
    head, _, *rows = [split_row(line) for line in section.strip().split("\n\n")[0].splitlines()]
    wanted = [head.index(name) for name in ("success, %", "T / T_empty", "t_close / T_empty")]
    return {row[0]: tuple(float(row[column]) for column in wanted) for row in rows}  # type: ignore[misc]


def case_of(planner: str) -> int:
    """Return the case of the game that the dot of a planner plays: its first collision, or else the first case."""
    outcomes = game().get(planner, [])
    return outcomes.index("collision") if "collision" in outcomes else 0


def place(time: float, close: float) -> tuple[float, float]:
    """Return the place of a point in pixels."""
    x = LEFT + (WIDTH - LEFT - 20) * (time - TIMES[0]) / (TIMES[1] - TIMES[0])
    return round(x, 1), round(HEIGHT - BOTTOM - (HEIGHT - BOTTOM - TOP) * (close - CLOSE[0]) / (CLOSE[1] - CLOSE[0]), 1)


def box_of(name: str, x: float, y: float, part: str) -> Box:
    """Return the rectangle of a name; the part of the text is "start", "mid" or "end"."""
    width = LETTER * len(name)
    left = x - {"start": 0.0, "mid": 0.5, "end": 1.0}[part] * width
    return left, y - ASCENT, left + width, y + DESCENT


def overlap(one: Box, other: Box) -> bool:
    """Return whether two rectangles overlap."""
    return one[0] < other[2] and other[0] < one[2] and one[1] < other[3] and other[1] < one[3]


def figure() -> str:
    """Return the figure as SVG inside a page."""
    exact, real = (parts(track) for track in MEANS)
    leader = max(scores(), key=lambda name: scores()[name]["realistic"])
    label = 'role="group" aria-label="Time against closeness"'
    lines = [f'<div class="scroll"><svg class="pareto" viewBox="0 0 {WIDTH} {HEIGHT}" {label}>']
    for time in (1.0, 1.5, 2.0):
        x, y = place(time, CLOSE[0])
        lines.append(f'<path class="grid" d="M{x} {TOP}V{y}"/>')
        lines.append(f'<text x="{x}" y="{y + 18}" class="mid">{time:g}</text>')
    for close in (0.0, 0.2, 0.4, 0.6):
        x, y = place(TIMES[0], close)
        lines.append(f'<path class="grid" d="M{x} {y}H{WIDTH - 20}"/>')
        lines.append(f'<text x="{x - 8}" y="{y + 4}" class="end">{close:g}</text>')
    lines.append(f'<text x="{WIDTH / 2}" y="{HEIGHT - 6}" class="mid">time / least time: quicker to the left</text>')
    turned = f'transform="translate(14 {HEIGHT / 2 - 10}) rotate(-90)" class="mid"'
    lines.append(f"<text {turned}>time close to people / least time: less is better</text>")
    taken: list[Box] = []
    for track, radius in ((exact, 4.0), (real, RADIUS)):
        dots = [place(time, close) for _, time, close in track.values()]
        taken += [(x - radius, y - radius, x + radius, y + radius) for x, y in dots]
    for name, (success, time, close) in real.items():
        (x, y), (x0, y0) = place(time, close), place(*exact[name][1:])
        spots = [(x + dx, y + dy, part) for dx, dy, part in PLACES]
        free = [spot for spot in spots if not any(overlap(box_of(name, *spot), other) for other in taken)]
        u, v, part = (free or spots)[0]
        taken.append(box_of(name, u, v, part))
        others = "" if name == leader else f",{leader}"
        title = f"{name}: {success:g} % succeed, {time:g} times the least time"
        lines.append(
            f'<a href="index.html#val/{case_of(name)}:{name}{others}"><title>{title}</title>'
            f'<path class="track" d="M{x0} {y0}L{x} {y}"/><circle class="exact" cx="{x0}" cy="{y0}" r="4"/>'
            f'<circle class="real" cx="{x}" cy="{y}" r="{RADIUS * (success / 100.0) ** 0.5:.1f}"/>'
            f'<text x="{u:.1f}" y="{v:.1f}" class="{part} name">{name}</text></a>'
        )
    return "\n".join([*lines, "</svg></div>"])
