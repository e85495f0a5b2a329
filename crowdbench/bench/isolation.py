"""What it costs to have a planner in a process of its own."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Iterator

from crowdbench.bench.measurement import Measurement
from crowdbench.bench.timing import in_turns, seconds
from crowdbench.catalog import load_planner, load_scenario
from crowdbench.evaluate.driver import Driver
from crowdbench.evaluate.rollout import rollout
from crowdbench.isolation.planner import IsolatedPlanner
from crowdbench.isolation.sandbox import level
from crowdbench.planners.base import Planner
from crowdbench.scenario.cases import Cases

PLANNER = "orca"
"""A planner that decides fast, so that its share in the time is small and that of the pipes large."""


def measure_isolation(worlds: int = 500, rounds: int = 7) -> Iterator[Measurement]:
    """Rollouts of one batch, the planner here and in its own process by turns.

    Args:
        worlds: Number of worlds.
        rounds: How many times both are measured.
    """
    with contextlib.closing(IsolatedPlanner(PLANNER, {})) as apart:
        works = [functools.partial(seconds, _rollout(planner, worlds)) for planner in (load_planner(PLANNER)[1], apart)]
        here, there = in_turns(rounds, *works)
    work = f"rollout of {worlds} worlds, ORCA vehicle"
    yield Measurement(work, 1e3 * here, "ms")
    yield Measurement(f"the same, the vehicle in its own process ({level()})", 1e3 * there, "ms")
    yield Measurement("more time with the vehicle in its own process", 100 * (there / here - 1), "%")


def _rollout(planner: Planner, worlds: int) -> Callable[[], object]:
    driver = Driver(planner, PLANNER)
    return functools.partial(rollout, driver, load_scenario("circle_crossing_5"), Cases("val", 0, worlds))
