"""Loads runs: the planner, the scenario and the metrics that a `RunSpec` names, and the scenario of a stored run."""

from __future__ import annotations

import contextlib
import copy
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from crowdbench import catalog
from crowdbench.metrics.user_metrics import load_metrics
from crowdbench.planners.driver import Driver
from crowdbench.planners.planner import Planner
from crowdbench.plugins.kind import plugin_name
from crowdbench.results.result_file import RESULT
from crowdbench.results.run_result import RunResult
from crowdbench.runs.identity import PlannerId, id_of_object, new_key
from crowdbench.runs.run import Run
from crowdbench.runs.spec import RunSpec
from crowdbench.scenario.scenario import Scenario
from crowdbench.utils.errors import InputError
from crowdbench.utils.resources import plugin_in_time, start_limit


def load_run(
    spec: RunSpec, planner: Planner | None = None, scenario: Scenario | None = None, key: str | None = None
) -> Run:
    """Load a run with its planner in this process.

    Args:
        spec: The run. If `planner` is given, `spec.planner` is only its name.
        planner: A planner object that a user constructed, if any.
        scenario: The scenario that the spec names, if it is loaded already.
        key: The author's name for this version of a planner object; without a key, no run is resumed with it.

    Raises:
        InputError: A plug-in or scenario in the spec does not exist, or does not accept these options or overrides.
    """
    name, is_named = spec.planner, planner is None
    with start_limit(spec.decision_limit):
        scenario = scenario or catalog.load_scenario(spec.scenario, spec.overrides, spec.pedestrians, spec.data)
        if planner is None:
            planner = catalog.load_planner(spec.planner, spec.options)
            name = plugin_name(spec.planner)
        driver = Driver(hold_out(planner, name, scenario), name, spec.decision_limit)
        metrics, others = load_metrics(spec.metrics, scenario.rules.vehicles), load_others(spec, scenario, driver)
    if is_named:
        identity = identify(spec.planner, spec.options, driver)
    else:
        identity = id_of_object(planner, name, driver.facts, key or new_key())
    return Run(spec, driver, scenario, metrics, identity, others, is_named=is_named)


def load_others(spec: RunSpec, scenario: Scenario, driver: Driver) -> tuple[Driver, PlannerId] | None:
    """Load the planner of all vehicles but the first, if the spec names one.

    Args:
        spec: The run.
        scenario: Its scenario.
        driver: The driver of the first vehicle.

    Raises:
        InputError: There is one vehicle only, or the two planners take different observations.
    """
    if spec.others is None:
        return None
    if scenario.rules.vehicles == 1:
        raise InputError(f"--others is {spec.others}, but {scenario.name} has one vehicle: set vehicle.number")
    others = Driver(catalog.load_planner(spec.others, {}), plugin_name(spec.others), spec.decision_limit)
    if others.raw != driver.raw and scenario.rules.sensor.detector is not None:
        raise InputError(
            f"planner {driver.name} and --others {others.name} need different trackers: one of them is raw"
        )
    return others, identify(spec.others, {}, others)


def hold_out(planner: Planner, name: str, scenario: Scenario) -> Planner:
    """Return a planner for a scenario: with networks that were trained without the scene of its recorded tracks.

    Raises InputError, with the name of the planner, if the planner has none.
    """
    if not scenario.tracks:
        return planner
    with plugin_in_time(f"planner {name} raised", " in for_held_out_scene()"):
        return planner.for_held_out_scene(scenario.tracks.scene)


@contextlib.contextmanager
def open_run(spec: RunSpec) -> Iterator[Run]:
    """Load a run, isolated if its spec requests it, and end the planner's process afterwards.

    Raises:
        InputError: As `load_run` does.
    """
    if not spec.isolated:
        yield load_run(spec)
        return
    from crowdbench.isolation.isolated_planner import IsolatedPlanner, ResourceLimits

    scenario = catalog.load_scenario(spec.scenario, spec.overrides, spec.pedestrians, spec.data)
    limits, scene = ResourceLimits(decision=spec.decision_limit), scenario.tracks.scene if scenario.tracks else None
    with contextlib.closing(IsolatedPlanner(spec.planner, spec.options, limits, scene=scene)) as planner:
        driver = Driver(planner, planner.name, spec.decision_limit)
        identity = identify(spec.planner, spec.options, driver)
        others = load_others(spec, scenario, driver)
        metrics = load_metrics(spec.metrics, scenario.rules.vehicles)
        yield Run(spec, driver, scenario, metrics, identity, others, planner.usage)


def identify(
    planner: str, options: Mapping[str, Any], driver: Driver, named: Mapping[str, Any] | None = None
) -> PlannerId:
    """Return the identity of a planner that was loaded by name or from a file.

    Args:
        planner: The name or the file of the planner, see `catalog.load_planner`.
        options: The options with which the planner was loaded.
        driver: The driver of the planner.
        named: The options as written in a result, if they name files by other paths; None for `options`.
    """
    return PlannerId(
        driver.name,
        options if named is None else named,
        catalog.planner_files(planner, options),
        driver.facts,
    )


def load_stored_scenario(
    run: RunResult, pedestrians: Sequence[str] = (), layout: str | None = None, data: Path | None = None
) -> Scenario:
    """Load the scenario of a stored run from its `result.json`, with the files of the user that the run had.

    Args:
        run: The stored run.
        pedestrians: The files of the user's pedestrian policies in the run.
        layout: The file of the layout, if the run used a layout of the user.
        data: The folder with recorded tracks, if the run used recorded tracks.

    Raises:
        InputError: A file is missing or differs from the run, or the scenario's digest or an override contradicts its
            table.
    """
    path, table, right = run.directory / RESULT, run.result["scenario"], run.result["run"]["scenario"]

    def load(table: Mapping[str, Any]) -> Scenario:
        return catalog.load_recorded_scenario(table, str(path), pedestrians, layout, data)

    scenario = load(table)
    scenario.check_data(data)
    if scenario.digest != right:
        raise InputError(f"{path}: run.scenario is {right}, but its table scenario has the digest {scenario.digest}")
    changed = copy.deepcopy({**table, **scenario.table})
    of_layout = [(f"layout.{name}", value) for name, value in changed.get("layout", {}).items()]
    for key, value in run.result["stated"]["overrides"].items():
        # The table has the contents of files, and numbers in the types of the layout's parameters, such as 6.0 for 6.
        if key == "layout.map" or catalog.names_file(value) or (key, value) in of_layout:
            continue
        catalog.set_key(changed, "pedestrians.policy" if key == "pedestrians" else key, value, path)
    if changed != {**table, **scenario.table} and load(changed).digest != right:
        raise InputError(f"{path}: stated.overrides differ from its table scenario")
    return scenario
