"""Draws cases of the game of the start page on the page of each planner: its path, and the people at the end.

The tracks come from docs/cross/cases, packed by `cross_cases.py`.
"""

import functools
import json
from pathlib import Path
from typing import Any

import numpy as np

CASES = Path(__file__).parent / "cross" / "cases"
DIGITS = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-_"
FINE, COARSE = 1e-5, 2e-3
"""Resolution in metres of the tracks of pedestrians, and of planners."""

SHOWN, HALF, SCALE = 3, 7.0, 10.0
"""Number of cases, half the side of a picture in metres, and its units per metre."""


def unpack(text: str) -> np.ndarray:
    """Return the integers of a text of `crowdbench.export.replay_page.pack`."""
    values, value, shift = [], 0, 0
    for digit in map(DIGITS.index, text):
        value += (digit & 31) << shift
        shift += 5
        if digit < 32:
            values.append(-(value >> 1) if value & 1 else value >> 1)
            value, shift = 0, 0
    return np.array(values)


def track(text: str, quantum: float) -> np.ndarray:
    """Return the positions `[state, 2]` of a packed track, in metres."""
    return quantum * unpack(text).reshape(2, -1).cumsum(axis=1).cumsum(axis=1).T


@functools.cache
def read_case(number: int) -> dict[str, Any]:
    """Return the data of a case."""
    text = (CASES / f"{number}.js").read_text()
    data: dict[str, Any] = json.loads(text.removeprefix("cross.take(").rstrip().removesuffix(")"))
    return data


def chosen(outcomes: list[str]) -> list[int]:
    """Return the numbers of the cases that are shown: failures first, at most two of them where others succeed."""
    failed = [case for case, outcome in enumerate(outcomes) if outcome != "success"]
    others = [case for case, outcome in enumerate(outcomes) if outcome == "success"]
    few = failed[: max(2, SHOWN - len(others))]
    return few + others[: SHOWN - len(few)]


def figures(name: str, outcomes: list[str]) -> str:
    """Return the figures of a planner as HTML; each links to its case in the game.

    Args:
        name: The planner.
        outcomes: Its outcome in each case.
    """
    items = [f"<li>{_figure(name, case)}</li>" for case in chosen(outcomes)]
    return f'<div class="paths"><ul>{"".join(items)}</ul></div>'


def _figure(name: str, number: int) -> str:
    """Return the figure of a case."""
    case = read_case(number)
    run = next(planner for planner in case["planners"] if planner["name"] == name)
    path, end = track(run["track"], COARSE), run["steps"]
    parts = [f'<path class="goal" d="{_line(_star(np.array(case["goal"])))}z"/>']
    for person in case["people"]:
        walked = track(person["track"], FINE)
        if person["left"] and len(walked) <= end:
            continue
        recent = walked[max(0, end - 8) : end + 1]
        x, y = _place(walked[min(end, len(walked) - 1)])
        parts.append(f'<path class="walked" d="{_line(recent)}"/>')
        parts.append(f'<circle class="person" cx="{x}" cy="{y}" r="{SCALE * person["radius"]:g}"/>')
    x, y = _place(path[-1])
    radius = SCALE * case["radius"]
    parts.append(f'<path class="driven" d="{_line(path)}"/>')
    parts.append(f'<circle class="vehicle" cx="{x}" cy="{y}" r="{radius:g}"/>')
    seconds = end * case["dt"]
    said = {"success": "success", "collision": "collision", "timeout": "out of time"}[run["outcome"]]
    if said == "collision":
        parts.append(f'<circle class="contact" cx="{x}" cy="{y}" r="{2.2 * radius:g}"/>')
    side = 2.0 * HALF * SCALE
    label = f"{case['case']}: {said} after {seconds:g} s"
    picture = f'<svg viewBox="0 0 {side:g} {side:g}" role="img" aria-label="{label}">{"".join(parts)}</svg>'
    return f'<a href="../index.html#{case["case"]}:{name}">{picture}<span>{label}</span></a>'


def _place(point: np.ndarray) -> tuple[float, float]:
    x, y = (HALF + point * [1.0, -1.0]) * SCALE
    return round(float(x), 1), round(float(y), 1)


def _line(points: np.ndarray) -> str:
    return "M" + "L".join(f"{x:g} {y:g}" for x, y in map(_place, points))


def _star(middle: np.ndarray) -> np.ndarray:
    corner = np.arange(10)
    angle, radius = np.pi * (corner / 5.0 + 0.5), np.where(corner % 2, 0.18, 0.42)
    return middle + radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
