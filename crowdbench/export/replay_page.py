"""Export runs as a web page that replays their cases in a browser, without a server and without external files.

index.html, replay.js           the page
data/index.js                   scenarios, planners, outcomes, and the palette
data/door_10/val-3.js         a case: the tracks of its episodes, one for each planner
data/door_10/val-3.paths.js   predicted, considered and planned paths in it, if they were recorded

Data files are scripts, because a page that is opened from a folder cannot read other files. Arrays are texts, see
`pack`. Positions are rounded to `QUANTUM`.
"""

from __future__ import annotations

import itertools
import json
import re
import shutil
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int
from numpy.typing import ArrayLike

from crowdbench.core.dynamics import Holonomic, outline
from crowdbench.core.geometry import polygons
from crowdbench.core.types import Outcome, Trace
from crowdbench.drawing import DARK, LIGHT, measured_rings, same_agents
from crowdbench.metrics.fault import find_contacts
from crowdbench.record.decisions import PlannedPaths
from crowdbench.record.explanation import describe_failure
from crowdbench.record.recorded_cases import read_recorded, recorded_outcomes
from crowdbench.results.episodes import RECORDING
from crowdbench.results.run_result import RunResult
from crowdbench.runs.replay import Loader, stored_traces
from crowdbench.runs.rollout import Progress
from crowdbench.utils.errors import InputError

PAGE = "index.html"
"""The page's file in its folder."""

QUANTUM, COARSE = 0.002, 0.02
"""Resolution of the positions of agents, and of predicted, considered and planned paths, in metres. Paths are
simplified with the same tolerance."""

_DIGITS = np.frombuffer(b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-_", np.uint8)


def pack(*arrays: ArrayLike) -> str:
    """Encode integers of any type as a text: base 32 with the lowest digit first, as in source maps.

    The lowest bit is the sign. Each digit is one character, from the second half of the alphabet if more digits follow.
    """
    values = np.concatenate([np.empty(0, np.int64), *(np.asarray(array, np.int64).ravel() for array in arrays)])
    digits = np.where(values < 0, 1 - 2 * values, 2 * values)[:, None] >> 5 * np.arange(8)
    follows = digits[:, 1:] > 0
    digits &= 31
    digits[:, :-1] += 32 * follows
    return _DIGITS[digits[np.insert(follows, 0, True, axis=1)]].tobytes().decode()


def export_page(
    runs: Sequence[RunResult],
    load: Loader,
    folder: Path,
    progress: Progress | None = None,
    back: tuple[str, str] | None = None,
) -> int:
    """Write a page that plays the cases of runs.

    Args:
        runs: The runs. Runs of one scenario can be seen side by side.
        load: Loads the scenario of a simulated run.
        folder: An empty folder.
        progress: Called after each step with its progress, summed over the episodes, in fractions of an episode.
        back: Address, from the folder, and title of a page to which the page has a link.

    Returns:
        The number of cases.

    Raises:
        InputError: A run has no commands or a damaged recording, or runs of one name differ in their scenario.
    """
    shutil.copyfile(Path(__file__).with_name("replay.html"), folder / PAGE)
    shutil.copyfile(Path(__file__).with_name("replay.js"), folder / "replay.js")
    scenarios: dict[str, dict[str, Any]] = {}
    files: dict[str, dict[str, Any]] = defaultdict(dict)
    for run in runs:
        digest, table = run.result["run"]["scenario"], run.result["scenario"]
        known = {"digest": digest, "description": table.get("description", ""), "runs": {}}
        about = scenarios.setdefault(table["name"], known)
        if about["digest"] != digest:
            raise InputError(f"{run.directory} has another scenario {table['name']} than runs before it: leave it out")
        name = re.sub(r"[^A-Za-z0-9_.-]+", "-", run.result["run"]["planner"]["name"])  # valid in a link
        planner = f"{name}-{len(about['runs']) + 1}" if name in about["runs"] else name
        outcomes = "".join(Outcome(outcome).label[0] for outcome in run.episodes.outcome.tolist())
        recording = run.directory / RECORDING
        recorded = [*recorded_outcomes(recording)] if recording.exists() else []
        about["runs"][planner] = dict(label=run.label, cases=str(run.cases), outcomes=outcomes, recorded=recorded)
        for trace in stored_traces(run, load, progress=progress):
            about |= _describe(trace)
            hit = find_contacts(trace).agent
            for row, case in enumerate(trace.case.tolist()):
                key, verdict = f"{table['name']}/{trace.split}-{case}", []
                if (found := read_recorded(recording, case)) is not None:
                    verdict = found.verdict
                    planned = found.paths(trace.rules.dt, commands=True)
                    files[f"{key}.paths"][planner] = _paths(trace, row, planned)
                episode = {"hit": int(hit[row]), "verdict": verdict or describe_failure(trace, row)}
                files[key][planner] = episode | _episode(trace, row)
    palettes = {"light": LIGHT._asdict(), "dark": DARK._asdict()}
    constants = {
        "palette": palettes,
        "quantum": QUANTUM,
        "coarse": COARSE,
        "paths": (*PlannedPaths._fields, "measured"),
        "back": back,
    }
    for key, data in itertools.chain([("index", constants | {"scenarios": scenarios})], files.items()):
        path = folder / "data" / f"{key}.js"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f"replay.take({json.dumps(key)},{json.dumps(data, separators=(',', ':'))})\n", encoding="utf-8")
    return sum(not key.endswith(".paths") for key in files)


def _describe(trace: Trace) -> dict[str, Any]:
    """Return the values that all cases share: times in seconds, the outline of a wheeled vehicle in metres."""
    rules, radius, rim = trace.rules, float(trace.radius[0, 0, 0]), np.empty((0, 2))
    if not isinstance(rules.dynamics, Holonomic):
        rim = outline(rules.body, np.zeros(2), np.zeros(()), radius).round(3)
    return {"dt": rules.dt, "outline": rim.tolist(), "tolerance": rules.goal_tolerance or radius}


def _episode(trace: Trace, row: int) -> dict[str, Any]:
    """Return the data of an episode.

    For each stay of an agent, `tracks` contains its index, its first state, the number of states, its radius, x, y, and
    the states in which it is seen and in which it has noticed the vehicle.
    """
    states = int(trace.steps[row]) + 1
    position = trace.position[row, :states]
    is_there = np.isfinite(position[..., 0])
    stayed = same_agents(trace.person[row, :states]) & is_there[:-1]
    stay = np.cumsum(is_there & ~np.insert(stayed, 0, False, axis=0), axis=0)
    flags = [np.insert(flag[row, :states], 0, True, axis=1) for flag in (trace.seen, trace.noticed) if flag is not None]
    numbers: list[ArrayLike] = []
    for agent, count in enumerate(stay[-1].tolist()):
        for number in range(1, count + 1):
            (state,) = np.nonzero(is_there[:, agent] & (stay[:, agent] == number))
            size = np.round(trace.radius[row, state[0], agent] / QUANTUM)
            place = _bend(np.round(position[state, agent].T / QUANTUM))
            numbers += [[agent, state[0], len(state), size], place, *(_turns(flag[state, agent]) for flag in flags)]
    return {
        "outcome": Outcome(int(trace.outcome[row])).label[0],
        "steps": states - 1,
        "goal": trace.goal[row, 0, 0].round(3).tolist(),
        "obstacles": pack(*_to_lines(polygons(trace.obstacles[row]), QUANTUM)),
        "attention": trace.noticed is not None,
        "tracks": pack(*numbers),
        "gap": pack(np.diff(np.round(100.0 * np.minimum(trace.gap[row, : states - 1], 1e3)), prepend=0.0)),
        "heading": pack(_bend(np.round(100.0 * np.unwrap(trace.heading[row, :states])))),
    }


def _bend(values: Float[np.ndarray, "*_ time"]) -> Float[np.ndarray, "*_ time"]:
    """Return second differences, which are small where a path is smooth."""
    return np.diff(np.diff(values, prepend=0.0), prepend=0.0)


def _turns(flag: Bool[np.ndarray, "state"]) -> Int[np.ndarray, "turn"]:
    """Return the number of changes of a flag, which is initially true, and the number of states between changes."""
    (state,) = np.nonzero(np.diff(flag, prepend=True))
    return np.concatenate([[len(state)], np.diff(state, prepend=0)])


def _to_lines(lines: Sequence[Float[np.ndarray, "_ 2"]], quantum: float) -> list[ArrayLike]:
    """Return the number of lines, the number of points of each line, and the differences between points in quanta."""
    points = np.round(np.concatenate([np.zeros((1, 2)), *lines]) / quantum)
    return [[len(lines), *map(len, lines)], np.diff(points, axis=0)]


def _paths(trace: Trace, row: int, planned: Mapping[int, PlannedPaths]) -> str:
    """Return the paths of an episode: first the number of paths of each kind in each state, then all paths. The rings
    of measured positions are the last kind."""
    each = []
    for state in range(int(trace.steps[row]) + 1):
        position, radius = trace.position[row, state, 1:], trace.radius[row, state, 1:]
        measured = position if trace.perceived is None else trace.perceived[row, state]
        rings = measured_rings(measured, position, radius, trace.rules.sensor.detector)
        each.append((*planned.get(state, PlannedPaths()), rings))
    lines = [shapely.LineString(line) for paths in each for lines in paths for line in lines]
    simple = [shapely.get_coordinates(line) for line in shapely.simplify(lines, COARSE)]
    return pack(*(len(lines) for paths in each for lines in paths), *_to_lines(simple, COARSE))
