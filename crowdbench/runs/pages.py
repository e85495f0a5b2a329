"""Runs as a page on which a browser plays their cases, without a server and without anything from elsewhere.

index.html, replay.js           the page
data/index.js                   scenarios, cases, planners, outcomes, and the palette
data/doorway_8/val-3.js         a case: the tracks of its episodes, one for each planner
data/doorway_8/val-3.paths.js   what planners predicted, considered and planned in it, where that was recorded

Data are scripts, because a page of a file system can read nothing else. Arrays are texts, see `pack`. Positions are
rounded to `QUANTUM`.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import re
import shutil
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int

from crowdbench import catalog
from crowdbench.core.dynamics import Holonomic, outline
from crowdbench.core.geometry import polygons
from crowdbench.core.types import Outcome, Trace
from crowdbench.drawing import DARK, LIGHT, same_agents
from crowdbench.record.cases import read_case, read_verdict, recorded_cases
from crowdbench.record.decisions import PlannedPaths, read_paths
from crowdbench.record.verdict import describe_failure
from crowdbench.runs.replay import traces
from crowdbench.runs.results import RECORDING
from crowdbench.runs.rollout import Progress
from crowdbench.runs.store import RunResult
from crowdbench.scenario.scenario import Scenario
from crowdbench.sim.contacts import find_contacts
from crowdbench.utils.errors import InputError

PAGE = "index.html"
"""The page's file in its folder."""

QUANTUM = 0.002
"""Positions of agents are multiples of it, in metres."""

COARSE = 0.02
"""The same of predicted, considered and planned paths, and how far these may lie beside the recorded ones."""

_DIGITS = np.frombuffer(b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-_", np.uint8)

Loader = Callable[[RunResult], Scenario]


def pack(*arrays: Int[np.ndarray, "*_"]) -> str:
    """Return integers as a text: base 32 from the lowest digit on, as in source maps.

    The lowest bit is the sign. Each digit is a character; those of the alphabet's second half say that more follow.
    """
    values = np.concatenate([np.ravel(array).astype(np.int64) for array in arrays] or [np.empty(0, np.int64)])
    groups = np.where(values < 0, 1 - 2 * values, 2 * values)[:, None] >> 5 * np.arange(8)
    follows = groups[:, 1:] > 0
    digits = groups & 31
    digits[:, :-1] += 32 * follows
    return _DIGITS[digits[np.insert(follows, 0, True, axis=1)]].tobytes().decode()


def export_page(runs: Sequence[RunResult], load: Loader, folder: Path, progress: Progress | None = None) -> int:
    """Write a page that plays the cases of runs.

    Args:
        runs: The runs. Those of one scenario can be seen side by side.
        load: Makes the scenario of a run again.
        folder: An empty folder.
        progress: Called after each step with what it added to the episodes, in parts of an episode.

    Returns:
        The number of cases.

    Raises:
        InputError: A run has no commands or a damaged recording, or runs of one name differ in their scenario.
    """
    for name in (PAGE, "replay.js"):
        shutil.copyfile(Path(__file__).with_name(name.replace("index", "replay")), folder / name)
    scenarios: dict[str, dict[str, Any]] = {}
    cases: dict[str, dict[str, Any]] = defaultdict(lambda: {"episodes": {}})
    paths: dict[str, dict[str, Any]] = defaultdict(dict)
    for run in runs:
        scenario = load(run)
        name = scenario.name
        about = scenarios.setdefault(name, {"digest": scenario.digest, **_describe(scenario), "runs": {}})
        if about["digest"] != scenario.digest:
            raise InputError(f"{run.directory} has another scenario {name} than the runs before it: export it alone")
        planner = _name(run, about["runs"])
        outcomes = "".join(Outcome(outcome).label[0] for outcome in run.episodes.outcome.tolist())
        about["runs"][planner] = {"label": run.label, "cases": str(run.cases), "outcomes": outcomes}
        recording = run.directory / RECORDING
        recorded = set(recorded_cases(recording)) if recording.exists() else set()
        for trace in traces(run, scenario, undisturbed=False, progress=progress):
            hit = find_contacts(trace).agent
            for row, case in enumerate(trace.case.tolist()):
                key = f"{name}/{trace.split}-{case}"
                cases[key]["obstacles"] = pack(*_to_lines(polygons(trace.obstacles[row]), QUANTUM))
                verdict = read_verdict(recording, case) if case in recorded else describe_failure(trace, row)
                episode = {**_episode(trace, row), "hit": int(hit[row]), "verdict": verdict}
                cases[key]["episodes"][planner] = episode
                if case in recorded:
                    planned = read_paths(read_case(recording, case).chunks, trace.rules.dt)
                    if packed := _paths(planned, int(trace.steps[row]) + 1):
                        cases[key]["paths"], paths[key][planner] = True, packed
    palette = {theme: _colors(colors._asdict()) for theme, colors in (("light", LIGHT), ("dark", DARK))}
    _write(
        folder,
        "index",
        {
            "palette": palette,
            "quantum": QUANTUM,
            "coarse": COARSE,
            "paths": PlannedPaths._fields,
            "scenarios": scenarios,
        },
    )
    for key, data in itertools.chain(cases.items(), ((f"{key}.paths", data) for key, data in paths.items())):
        _write(folder, key, data)
    return len(cases)


def _write(folder: Path, key: str, data: Mapping[str, Any]) -> None:
    """Write a file of data, which calls a function of the page with it."""
    path = folder / "data" / f"{key}.js"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"replay.take({json.dumps(key)},{json.dumps(data, separators=(',', ':'))})\n", encoding="utf-8")


def _name(run: RunResult, taken: Mapping[str, Any]) -> str:
    """Return a name for a run's planner that a link can have."""
    name = re.sub(r"[^A-Za-z0-9_.-]+", "-", run.result["run"]["planner"]["name"])
    names = itertools.chain([name], (f"{name}-{number}" for number in itertools.count(2)))
    return next(each for each in names if each not in taken)


def _describe(scenario: Scenario) -> dict[str, Any]:
    """Return what is the same in all cases: times in seconds, the vehicle's outline in metres, its sensor."""
    rules, group = scenario.rules, ""
    with contextlib.suppress(InputError):  # a scenario of the user's own
        group = catalog.scenario_path(scenario.name).parent.name
    is_disc = isinstance(rules.dynamics, Holonomic)
    rim = [] if is_disc else outline(rules.body, np.zeros(2), np.zeros(()), scenario.vehicle.radius).round(3).tolist()
    return {
        "group": group,
        "description": scenario.table.get("description", ""),
        "dt": rules.dt,
        "outline": rim,
        "tolerance": rules.goal_tolerance or scenario.vehicle.radius,
    }


def _colors(palette: Mapping[str, tuple[int, int, int]]) -> dict[str, str]:
    return {role: "#{:02x}{:02x}{:02x}".format(*color) for role, color in palette.items()}


def _episode(trace: Trace, row: int) -> dict[str, Any]:
    """Return an episode: of each agent's stay its index, first state, states, radius, path, and when it is unseen."""
    states = int(trace.steps[row]) + 1
    position, radius = trace.position[row, :states], trace.radius[row]
    is_there = np.isfinite(position[..., 0])
    stayed = same_agents(trace.person[row, :states]) & is_there[:-1]
    stay = np.cumsum(is_there & ~np.insert(stayed, 0, False, axis=0), axis=0)
    seen = np.insert(trace.seen[row, :states], 0, True, axis=1)
    noticed = None if trace.noticed is None else np.insert(trace.noticed[row, :states], 0, True, axis=1)
    numbers: list[Int[np.ndarray, "*_"]] = []
    for agent in range(position.shape[1]):
        for number in range(1, int(stay[-1, agent]) + 1):
            (state,) = np.nonzero(is_there[:, agent] & (stay[:, agent] == number))
            first, place = int(state[0]), np.round(position[state, agent].T / QUANTUM)
            size = round(float(radius[first, agent]) / QUANTUM)
            numbers += [np.array([agent, first, len(state), size]), _bend(place), _turns(seen[state, agent])]
            if noticed is not None:
                numbers.append(_turns(noticed[state, agent]))
    gap = np.round(100.0 * np.minimum(trace.gap[row, : states - 1], 1e3))
    episode = {
        "outcome": Outcome(int(trace.outcome[row])).label[0],
        "steps": states - 1,
        "goal": trace.goal[row, 0, 0].round(3).tolist(),
        "tracks": pack(*numbers),
        "gap": pack(np.diff(gap, prepend=0.0)),
        "attention": noticed is not None,
    }
    if not isinstance(trace.rules.dynamics, Holonomic):
        episode["heading"] = pack(_bend(np.round(100.0 * np.unwrap(trace.heading[row, :states]))))
    return episode


def _bend(values: Float[np.ndarray, "*_ time"]) -> Float[np.ndarray, "*_ time"]:
    """Return second differences, which are small where a path is smooth."""
    return np.diff(np.diff(values, prepend=0.0), prepend=0.0)


def _turns(flag: Bool[np.ndarray, "state"]) -> Int[np.ndarray, "turn"]:
    """Return how often a flag, true before, changes, and the states from one change to the next."""
    (state,) = np.nonzero(np.diff(flag, prepend=True))
    return np.concatenate([[len(state)], np.diff(state, prepend=0)])


def _to_lines(lines: Sequence[Float[np.ndarray, "_ 2"]], quantum: float) -> list[Int[np.ndarray, "*_"]]:
    """Return the number of lines, that of the points of each, and the steps from point to point in quanta."""
    points = np.round(np.concatenate([np.zeros((1, 2)), *lines]) / quantum)
    return [np.array([len(lines), *map(len, lines)]), np.diff(points, axis=0)]


def _paths(planned: Mapping[int, PlannedPaths], states: int) -> str:
    """Return the paths of an episode: how many of each kind in each state, and then all of them; empty without any."""
    each = [planned.get(state, PlannedPaths()) for state in range(states)]
    lines = [line for paths in each for lines in paths for line in lines]
    if not lines:
        return ""
    index = np.repeat(np.arange(len(lines)), list(map(len, lines)))
    simple = shapely.simplify(shapely.linestrings(np.concatenate(lines), indices=index), COARSE)
    points, index = shapely.get_coordinates(simple, return_index=True)
    numbers = np.array([list(map(len, paths)) for paths in each])
    return pack(numbers, *_to_lines(np.split(points, np.flatnonzero(np.diff(index)) + 1), COARSE))
