"""The rungs of a ladder: the same search with increasing knowledge, and certificates."""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable
from pathlib import Path

import numpy as np
from jaxtyping import Float

from crowdbench import (
    METRICS,
    Cases,
    Driver,
    MPPIPlanner,
    Observation,
    Planner,
    Predictor,
    Scenario,
    World,
    load_planner,
    load_scenario,
)
from crowdbench.core import PERFECT_SENSOR
from crowdbench.planners import FilteredPlanner
from crowdbench.predict import ConstantVelocity
from crowdbench.runs import PlannerId, Run, RunSpec
from crowdbench.utils import sha256
from studies.certificates.certificate import CODE, certificates, play_back
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
    "C": "a certificate",
}
"""The knowledge of each rung."""

KNOWLEDGE = dict(zip(("G", "GP", "P2", "P3"), Knowledge, strict=True))
"""The knowledge of the rungs that simulate the crowd."""


class CertifiedPlanner(Planner):
    """Planner that replays certificates. They are searched with the true future when a batch of episodes starts.

    Args:
        scenario: The scenario, with a perfect sensor of the vehicle.
        split: The split of its cases.
    """

    native = True
    privileged = True

    def __init__(self, scenario: Scenario, split: str) -> None:
        self._scenario, self._split = scenario, split
        self._commands: Planner

    def foresee(self, world: World) -> None:
        """Search for the commands when episodes of successive cases start."""
        if world.step[0] == 0:
            cases = Cases(self._split, int(world.case[0]), int(world.case[-1]) + 1)
            # Any gap above 0 is a success, so that no wider margin is required.
            found = certificates(self._scenario, cases, [0.0], lambda share: None)
            self._commands = play_back([each.commands for each in found], self._scenario)

    def plan(self, obs: Observation) -> Float[np.ndarray, "world 2"]:
        """Return the command of this step; none if no certificate was found."""
        return self._commands.plan(obs)


def load_rung(rung: str, spec: RunSpec, scenario: Scenario | None = None) -> Run:
    """Plan the run of a rung.

    Args:
        rung: One of `RUNGS`.
        spec: The run, whose planner is ignored.
        scenario: The scenario of the spec, if it has been loaded before.

    Raises:
        InputError: The scenario cannot be loaded.
    """
    scenario = scenario or load_scenario(spec.scenario, spec.overrides)
    if rung != "P0":
        scenario = dataclasses.replace(scenario, rules=dataclasses.replace(scenario.rules, sensor=PERFECT_SENSOR))
    planner: Planner
    horizon, paths = max(1, round(SECONDS / scenario.rules.dt)), [Path(__file__), Path(futures.__file__), *CODE]
    foresee: Callable[[World], None] | None = None
    if rung == "C":
        planner = certified = CertifiedPlanner(scenario, spec.cases.split)
        foresee = certified.foresee
    elif rung == "I":
        options = {
            "futures": FUTURES,
            "ignoring": 1.0,
            "worst": WORST,
            "horizon": horizon,
            "samples": MPPIPlanner.search.samples,
        }
        planner = load_planner("mppi_interactive", options)
        paths += sorted(Path(inspect.getfile(type(planner))).parent.glob("*.py"))
    else:
        predictor: Predictor = ConstantVelocity()
        if rung in KNOWLEDGE:
            predictor = simulated = Simulated(scenario, KNOWLEDGE[rung])
            foresee = simulated.foresee
        planner = MPPIPlanner(predictor, horizon=horizon, worst=WORST)
        if scenario.rules.sensor != PERFECT_SENSOR:
            planner = FilteredPlanner(planner)
    named = dataclasses.replace(spec, planner=rung)
    sources = {f"{path.parent.name}/{path.name}": sha256(path) for path in paths}
    identity = PlannerId(rung, files={"study": sources})
    return Run(named, Driver(planner, rung, LIMIT), scenario, METRICS, identity, foresee=foresee)
