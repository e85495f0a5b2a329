"""Certificates of cases: commands by which the vehicle succeeds, found by cheap means first."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numba
import numpy as np
from jaxtyping import Float

from crowdbench.catalog import load_planner
from crowdbench.certify.crowds import Crowd, Known, Reacting, known_steps, with_perfect_sight
from crowdbench.certify.search import Effort, SearchResult, Task, search
from crowdbench.core.types import Outcome, Trace
from crowdbench.planners.driver import Driver
from crowdbench.runs.replay import Playback
from crowdbench.runs.rollout import rollout
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario

PLANNERS = ("orca_margin", "orca", "social_force")
"""Planners that decide fast, and need no torch. A run of theirs that succeeds is a certificate."""

SEARCH = "search"
"""What a certificate is from that no planner gave."""

KNOWN = (Effort(cell=0.2, states=2_000), Effort(cell=0.1, states=20_000))
REACTING = (Effort(cell=0.2, states=256), Effort(cell=0.2, states=1_024))
"""The efforts one after the other, where people's ways are known, and where a world is simulated for each state."""


class Certificate(NamedTuple):
    """What was found for a case.

    Attributes:
        case: Its number.
        means: What gave the commands, the name of a planner or `SEARCH`; empty where none were found.
        margin: The margin that was asked for in metres, not a number where none were found.
        gap: The smallest gap to pedestrians and obstacles in metres, likewise.
        seconds: The time to the goal, likewise.
        is_exhausted: Whether the whole grid of a search was looked through, and none were found.
        commands: The commands of all steps until the vehicle arrives; none where none were found, nor in a row of a
            table.
    """

    case: int
    means: str = ""
    margin: float = math.nan
    gap: float = math.nan
    seconds: float = math.nan
    is_exhausted: bool = False
    commands: Float[np.ndarray, "step 2"] = np.empty((0, 2))


def certificates(
    scenario: Scenario, cases: Cases, margins: Sequence[float], progress: Callable[[float], None]
) -> list[Certificate]:
    """Find certificates.

    Args:
        scenario: The scenario of the cases.
        cases: The cases.
        margins: The margins to try, in metres, the widest first.
        progress: Called with the number of cases that are done.

    Returns:
        One for each case. It does not depend on the others.

    Raises:
        InputError: The scenario breaks its contract.
    """
    driven = [
        (name, rollout(Driver(load_planner(name)[1], name), scenario, cases, undisturbed=False)) for name in PLANNERS
    ]
    found: dict[int, Certificate] = {}
    exhausted: set[int] = set()
    for margin in margins:
        there = len(found)
        for name, trace in driven:
            for each in _in_trace(trace, name, margin):
                found.setdefault(each.case, each)
        if len(found) > there:
            progress(len(found) - there)
        left = [case for case in cases.indices.tolist() if case not in found]
        for each in _search_cases(scenario, cases.split, left, margin, exhausted):
            found[each.case] = each
            progress(1)
    if len(found) < len(cases):
        progress(len(cases) - len(found))
    return [found.get(case, Certificate(case, is_exhausted=case in exhausted)) for case in cases.indices.tolist()]


def _in_trace(trace: Trace, means: str, margin: float) -> Iterator[Certificate]:
    """The certificates among some episodes, with gaps of at least `margin` in metres; `means` gave their commands."""
    gaps = np.fmin(np.fmin.reduce(trace.gap, axis=1), np.fmin.reduce(trace.wall_gap, axis=1))
    for row in np.flatnonzero((trace.outcome == Outcome.SUCCESS) & (gaps >= margin)).tolist():
        commands = trace.command[row, : trace.steps[row]]
        seconds = trace.rules.dt * len(commands)
        yield Certificate(int(trace.case[row]), means, margin, float(gaps[row]), seconds, commands=commands)


def _search_cases(
    scenario: Scenario, split: str, cases: list[int], margin: float, exhausted: set[int]
) -> Iterator[Certificate]:
    """Search for commands in cases that no planner has solved, and yield those by which the vehicle succeeds.

    The cases whose whole grid was looked through are added to `exhausted`.
    """
    if not cases:
        return
    simulated, is_visible = with_perfect_sight(scenario), scenario.rules.visible
    # Whether anybody's way depends on the vehicle's: who sees it does, and who is placed where it is not.
    is_placed = scenario.crowd.arrival in ("new_goal", "respawn") or scenario.crowd.goal_change is not None
    heeds_vehicle = is_visible or is_placed or scenario.tracks is not None
    world = simulated.draw(split, np.array(cases))
    tasks = [Task.of(world, row) for row in range(len(cases))]

    def replay(row: int, result: SearchResult) -> Certificate | None:
        """The certificate that commands are if the vehicle succeeds by them in the simulator."""
        if result.commands is None:
            return None
        commands = np.zeros((1, scenario.rules.max_steps, 2))
        commands[0, : len(result.commands)] = result.commands
        alone = Cases(split, cases[row], cases[row] + 1)
        trace = rollout(Driver(Playback(commands), SEARCH), scenario, alone, undisturbed=False)
        return next(_in_trace(trace, SEARCH, margin), None)

    left = list(range(len(cases)))
    if not is_visible:
        steps, rows, left = known_steps(simulated, world), left, []

        def search_known(row: int) -> SearchResult:
            return _search_harder(tasks[row], Known([step.row(row) for step in steps]), margin, KNOWN)

        # Threads, because the compiled search lets others go on.
        with ThreadPoolExecutor(numba.get_num_threads()) as pool:
            for row, result in zip(rows, pool.map(search_known, rows), strict=True):
                certificate = replay(row, result)
                if certificate is not None:
                    yield certificate
                    continue
                left.append(row)
                if result.is_exhaustive and not heeds_vehicle:
                    exhausted.add(cases[row])
    if heeds_vehicle:
        for row in left:
            crowd = Reacting(simulated, world.take(np.array([row])))
            certificate = replay(row, _search_harder(tasks[row], crowd, margin, REACTING))
            if certificate is not None:
                yield certificate


def _search_harder(task: Task, crowd: Crowd, margin: float, efforts: Sequence[Effort]) -> SearchResult:
    """Search with one effort after the other until commands are found; the margin is in metres."""
    result = SearchResult(None, False)
    for effort in efforts:
        result = search(task, crowd, margin, effort)
        if result.commands is not None:
            break
    return result
