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

LIFTS, APART = (-15.0, 24.0, -28.0), (70.0, 13.0)
"""Heights of the names beside their dots, and least distances between names, in pixels."""


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
    lines.append(f"<text {turned}>time close to people / least time</text>")
    named: list[tuple[float, float]] = []
    for name, (success, time, close) in real.items():
        (x, y), (x0, y0) = place(time, close), place(*exact[name][1:])
        free = [
            y + lift for lift in LIFTS if all(abs(x - u) > APART[0] or abs(y + lift - v) > APART[1] for u, v in named)
        ]
        named.append((x, (free or [y + LIFTS[0]])[0]))
        others = "" if name == leader else f",{leader}"
        title = f"{name}: {success:g} % succeed, {time:g} times the least time"
        lines.append(
            f'<a href="index.html#val/{case_of(name)}:{name}{others}"><title>{title}</title>'
            f'<path class="track" d="M{x0} {y0}L{x} {y}"/><circle class="exact" cx="{x0}" cy="{y0}" r="4"/>'
            f'<circle class="real" cx="{x}" cy="{y}" r="{RADIUS * (success / 100.0) ** 0.5:.1f}"/>'
            f'<text x="{x}" y="{named[-1][1]}" class="mid name">{name}</text></a>'
        )
    return "\n".join([*lines, "</svg></div>"])
