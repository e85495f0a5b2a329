"""Draws docs/run.svg, the files of one run in the order of calls: python docs/run_figure.py.

All text stands in filled boxes, so that the figure can be read on a light and on a dark page.
"""

from html import escape
from pathlib import Path

FIGURE = Path(__file__).with_name("run.svg")

RUN = [  # depth of the call, file (under crowdbench/, apart from agents/), return value
    (0, "cli/run.py", "the table"),
    (1, "runs/load.py", "Run"),
    (2, "agents/planners/sarl_sgan_kce.py", "Planner"),
    (2, "scenario/load.py", "Scenario"),
    (1, "runs/shards.py", "the run's directory"),
    (2, "runs/run.py", "a part of the run"),
    (3, "runs/rollout.py", "Trace"),
    (4, "sim/sensor.py", "Observation"),
    (4, "planners/driver.py", "checked commands"),
    (5, "planners/lookahead.py", "commands"),
    (4, "sim/simulator.py", "next World"),
    (3, "runs/results.py", "metrics, intervals"),
]
EVERY_STEP = slice(7, 11)
"""The files that are called at every step."""

COLOURS = {  # by folder; white text can be read on each
    "agents": "#6b46a3",
    "cli": "#4a5568",
    "planners": "#ab3b38",
    "runs": "#23704f",
    "scenario": "#2b62a8",
    "sim": "#8a5a12",
}
LINE = "#8b949e"
WIDTH, ROW, BOX, INDENT, TAG = 470, 38, 30, 20, 26


def figure() -> str:
    """Return the figure in SVG."""
    first, last = EVERY_STEP.start, EVERY_STEP.stop - 1
    tops = [4 + i * ROW + (TAG if i >= first else 0) + (8 if i > last else 0) for i in range(len(RUN))]
    lines, boxes = [], []
    for i, (depth, file, gives) in enumerate(RUN):
        x, y = 6 + depth * INDENT, tops[i]
        if depth:
            caller = max(j for j in range(i) if RUN[j][0] == depth - 1)
            lines.append(f'<path d="M{x - INDENT + 6} {tops[caller] + BOX}V{y + BOX // 2}H{x}"/>')
        folder = file.removeprefix("").split("/")[0]
        boxes.append(
            f'<rect x="{x}" y="{y}" width="{WIDTH - 12 - x}" height="{BOX}" rx="5" fill="{COLOURS[folder]}"/>'
            f'<text x="{x + 10}" y="{y + 20}"><tspan class="number">{i + 1}</tspan> {escape(file)}</text>'
            f'<text x="{WIDTH - 22}" y="{y + 20}" class="gives">{escape(gives)}</text>'
        )
    x, y = 6 + RUN[first][0] * INDENT - 6, tops[first]
    height = tops[last] + BOX - y
    loop = (
        f'<rect x="{x}" y="{y - TAG}" width="{WIDTH - x - 2}" height="{height + TAG + 7}" rx="8" class="loop"/>'
        f'<rect x="{WIDTH - 164}" y="{y - TAG + 4}" width="152" height="18" rx="9" fill="#57606a"/>'
        f'<text x="{WIDTH - 22}" y="{y - TAG + 17}" class="gives">every step, all worlds</text>'
    )
    size = f'width="{WIDTH}" height="{tops[-1] + BOX + 6}" viewBox="0 0 {WIDTH} {tops[-1] + BOX + 6}"'
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" {size}>',
            "<title>The way of one run through the files, and what each gives back</title>",
            "<style>",
            "text { font: 13px ui-monospace, Menlo, Consolas, 'DejaVu Sans Mono', monospace; fill: #fff; }",
            ".number { font-weight: 700; }",
            ".gives { font: 12px system-ui, 'Segoe UI', 'DejaVu Sans', Arial, sans-serif; text-anchor: end; }",
            f"path {{ fill: none; stroke: {LINE}; stroke-width: 1.5; }}",
            f".loop {{ fill: none; stroke: {LINE}; stroke-width: 1.5; stroke-dasharray: 5 4; }}",
            "</style>",
            *lines,
            loop,
            *boxes,
            "</svg>\n",
        ]
    )


if __name__ == "__main__":
    FIGURE.write_text(figure(), encoding="utf-8")
