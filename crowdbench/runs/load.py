"""Loads runs: finds the planner, the scenario and the metrics that a `RunSpec` names."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from typing import Any

from crowdbench import catalog
from crowdbench.metrics.load import load_metrics
from crowdbench.planners.base import Planner
from crowdbench.planners.driver import Driver
from crowdbench.plugins.load import source_digest
from crowdbench.runs.run import Run
from crowdbench.runs.spec import RunSpec
from crowdbench.scenario.scenario import Scenario
from crowdbench.utils.errors import plugin_errors


def load_run(spec: RunSpec, planner: Planner | None = None, scenario: Scenario | None = None) -> Run:
    """Load a run with its planner in this process.

    Args:
        spec: The run; where a planner is given, the spec only says what it is called.
        planner: The planner where it was made in Python.
        scenario: The scenario that the spec names, where it has been loaded before.

    Raises:
        InputError: Something that the spec names does not exist, or does not take these options or overrides.
    """
    scenario = scenario or catalog.load_scenario(spec.scenario, spec.overrides, spec.pedestrians, spec.data)
    name, files = spec.planner, {}
    if planner is None:
        name, planner = catalog.load_planner(spec.planner, spec.options)
        files = catalog.planner_files(spec.planner, spec.options)
    if scenario.tracks:
        with plugin_errors(f"planner {name} raised", " in unseen()"):
            planner = planner.unseen(scenario.tracks.scene)
    return _make_run(spec, Driver(planner, name, spec.decision_limit), scenario, {"planner_files": files})


@contextlib.contextmanager
def open_run(spec: RunSpec) -> Iterator[Run]:
    """Load a run, isolated where its spec says so, and end the planner's own process afterwards.

    Raises:
        InputError: As `load_run` does.
    """
    if not spec.isolated:
        yield load_run(spec)
        return
    from crowdbench.isolation.planner import IsolatedPlanner, Limits

    scenario = catalog.load_scenario(spec.scenario, spec.overrides, spec.pedestrians, spec.data)
    limits, scene = Limits(decision=spec.decision_limit), scenario.tracks.scene if scenario.tracks else None
    with contextlib.closing(IsolatedPlanner(spec.planner, spec.options, limits, scene=scene)) as planner:
        files = catalog.planner_files(spec.planner, spec.options)
        details = {"planner_files": files, "isolation": planner.usage}
        yield _make_run(spec, Driver(planner, planner.name, spec.decision_limit), scenario, details)


def _make_run(spec: RunSpec, driver: Driver, scenario: Scenario, details: Mapping[str, Any]) -> Run:
    origin = {
        "planner": spec.planner,
        "scenario": spec.scenario,
        "pedestrians": spec.pedestrians,
        "own_metrics": {metric: source_digest(metric) for metric in spec.metrics},
    }
    return Run(spec, driver, scenario, load_metrics(spec.metrics), origin, details)
