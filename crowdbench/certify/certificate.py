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
from crowdbench.certify.search import Effort, Found, Task, search
from crowdbench.evaluate.driver import Driver
from crowdbench.evaluate.playback import Playback
from crowdbench.evaluate.rollout import rollout
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario
from crowdbench.types import Outcome, Trace

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
        commands: The commands of all steps until the vehicle arrives; none where none were found.
        margin: The margin that was asked for in metres, not a number where none were found.
        gap: The smallest gap to pedestrians and obstacles in metres, not a number where none were found.
        is_exhausted: Whether the whole grid of a search was looked through, and none were found.
    """

    case: int
    means: str = ""
    commands: Float[np.ndarray, "step 2"] = np.empty((0, 2))
    margin: float = math.nan
    gap: float = math.nan
    is_exhausted: bool = False


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
    driven = [(name, _driven(name, scenario, cases)) for name in PLANNERS]
    found: dict[int, Certificate] = {}
    searched = _Searched(scenario, cases)
    for margin in margins:
        there = len(found)
        for name, trace in driven:
            for each in _in_trace(trace, name, margin):
                found.setdefault(each.case, each)
        if len(found) > there:
            progress(len(found) - there)
        for each in searched.certificates([case for case in cases.indices.tolist() if case not in found], margin):
            found[each.case] = each
            progress(1)
    if len(found) < len(cases):
        progress(len(cases) - len(found))
    numbers = cases.indices.tolist()
    return [found.get(case, Certificate(case, is_exhausted=case in searched.exhausted)) for case in numbers]


def _driven(name: str, scenario: Scenario, cases: Cases) -> Trace:
    """The episodes of a planner."""
    return rollout(Driver(load_planner(name)[1], name), scenario, cases)


def _in_trace(trace: Trace, means: str, margin: float) -> Iterator[Certificate]:
    """The certificates among some episodes.

    Args:
        trace: The episodes.
        means: What gave their commands.
        margin: Smallest gap in metres.
    """
    gaps = np.fmin(np.fmin.reduce(trace.gap, axis=1), np.fmin.reduce(trace.wall_gap, axis=1))
    for row in np.flatnonzero((trace.outcome == Outcome.SUCCESS) & (gaps >= margin)).tolist():
        commands = trace.command[row, : trace.steps[row]]
        yield Certificate(int(trace.case[row]), means, commands, margin, float(gaps[row]))


class _Searched:
    """Looks for commands in cases that no planner has solved.

    Attributes:
        exhausted: The cases whose whole grid was looked through at the narrowest margin so far.

    Args:
        scenario: The scenario.
        cases: The cases.
    """

    def __init__(self, scenario: Scenario, cases: Cases) -> None:
        self.scenario = scenario
        self.split = cases.split
        self.exhausted: set[int] = set()
        self._simulated = with_perfect_sight(scenario)

    def certificates(self, cases: list[int], margin: float) -> Iterator[Certificate]:
        """Yield what is found, each replayed.

        Args:
            cases: The numbers of cases.
            margin: Smallest gap in metres.
        """
        if not cases:
            return
        world = self._simulated.draw(self.split, np.array(cases))
        tasks = [Task.of(world, row) for row in range(len(cases))]
        rows, left = list(range(len(cases))), list[int]()
        if not self.scenario.rules.visible:
            steps = known_steps(self._simulated, world)

            def look(row: int) -> Found:
                return _looked(tasks[row], Known([step.row(row) for step in steps]), margin, KNOWN)

            # Threads, because the compiled search lets others go on.
            with ThreadPoolExecutor(numba.get_num_threads()) as pool:
                for row, found in zip(rows, pool.map(look, rows), strict=True):
                    certificate = self._replayed(cases[row], found, margin)
                    if certificate is not None:
                        yield certificate
                    elif found.is_exhaustive and not _heeds_vehicle(self.scenario):
                        self.exhausted.add(cases[row])
                    left += [row] if certificate is None else []
        if _heeds_vehicle(self.scenario):
            for row in rows if self.scenario.rules.visible else left:
                crowd = Reacting(self._simulated, world.take(np.array([row])))
                certificate = self._replayed(cases[row], _looked(tasks[row], crowd, margin, REACTING), margin)
                if certificate is not None:
                    yield certificate

    def _replayed(self, case: int, found: Found, margin: float) -> Certificate | None:
        """The certificate that commands are if the vehicle succeeds by them in the simulator."""
        if found.commands is None:
            return None
        commands = np.zeros((1, self.scenario.rules.max_steps, 2))
        commands[0, : len(found.commands)] = found.commands
        driver = Driver(Playback(commands), SEARCH)
        trace = rollout(driver, self.scenario, Cases(self.split, case, case + 1))
        return next(_in_trace(trace, SEARCH, margin), None)


def _heeds_vehicle(scenario: Scenario) -> bool:
    """Whether anybody's way depends on the vehicle's: who sees it does, and who is placed where it is not."""
    placed = scenario.arrival in ("new_goal", "respawn") or scenario.goal_change is not None
    return scenario.rules.visible or placed or scenario.tracks is not None


def _looked(task: Task, crowd: Crowd, margin: float, efforts: Sequence[Effort]) -> Found:
    """Search with one effort after the other until commands are found.

    Args:
        task: Where the vehicle goes.
        crowd: The crowd at the start.
        margin: Smallest gap in metres.
        efforts: How thoroughly to search.
    """
    found = Found(None, False)
    for effort in efforts:
        found = search(task, crowd, margin, effort)
        if found.commands is not None:
            break
    return found
