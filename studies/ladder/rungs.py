"""The rungs of a ladder: the same search with increasing knowledge."""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable
from pathlib import Path

from crowdbench import METRICS, Driver, MPPIPlanner, Planner, Predictor, Scenario, World, load_planner, load_scenario
from crowdbench.core import PERFECT_SENSOR
from crowdbench.predict import ConstantVelocity
from crowdbench.runs import PlannerId, Run, RunSpec
from crowdbench.utils import sha256
from studies.ladder import futures
from studies.ladder.futures import FUTURES, Knowledge, Simulated

SECONDS = 5.0
"""Horizon of the search in seconds."""

WORST = 0.25
"""The share of the futures that count, the worst ones for a sequence of commands (CVaR)."""

LIMIT = 3600.0
"""Longest time of a decision in seconds, for all worlds of a batch together; rungs need not be fast."""

RUNGS = {
    "P0": "sensed state; people at constant velocity",
    "P1": "true state; people at constant velocity",
    "I": "true state; people walk by ORCA to goals inferred from headings, and ignore the vehicle",
    "G": "true goals; people walk by ORCA and ignore the vehicle",
    "GP": "true goals and policies, not who notices the vehicle",
    "P2": "everything but chance",
    "P3": "the true future",
}
"""The knowledge of each rung."""

KNOWLEDGE = dict(zip(("G", "GP", "P2", "P3"), Knowledge, strict=True))
"""The knowledge of the rungs that simulate the crowd."""


def load_rung(rung: str, spec: RunSpec, scenario: Scenario | None = None) -> Run:
    """Plan the run of a rung.

    Args:
        rung: One of `RUNGS`.
        spec: The run, whose planner is ignored. P0 has the sensor of its scenario, the other rungs a perfect one.
        scenario: The scenario of the spec, if it has been loaded before.

    Raises:
        InputError: The scenario cannot be loaded.
    """
    scenario = scenario or load_scenario(spec.scenario, spec.overrides)
    if rung != "P0":
        scenario = dataclasses.replace(scenario, rules=dataclasses.replace(scenario.rules, sensor=PERFECT_SENSOR))
    planner: Planner
    horizon, paths = max(1, round(SECONDS / scenario.rules.dt)), [Path(__file__), Path(futures.__file__)]
    foresee: Callable[[World], None] | None = None
    if rung == "I":
        options = {
            "futures": FUTURES,
            "ignoring": 1.0,
            "worst": WORST,
            "horizon": horizon,
            "samples": MPPIPlanner.search.samples,
            "weights": {"fading": MPPIPlanner.weights.fading},  # as in the other rungs
        }
        planner = load_planner("mppi_interactive", options)
        paths += sorted(Path(inspect.getfile(type(planner))).parent.glob("*.py"))
    else:
        predictor: Predictor = ConstantVelocity()
        if rung in KNOWLEDGE:
            predictor = simulated = Simulated(scenario, KNOWLEDGE[rung])
            foresee = simulated.foresee
        planner = MPPIPlanner(predictor, horizon=horizon, worst=WORST)
    named = dataclasses.replace(spec, planner=rung)
    sources = {f"{path.parent.name}/{path.name}": sha256(path) for path in paths}
    identity = PlannerId(rung, files={"study": sources})
    return Run(named, Driver(planner, rung, LIMIT), scenario, METRICS, identity, foresee=foresee)
