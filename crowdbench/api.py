"""Runs from Python: `run` drives a planner through cases and scores it, `rollout` returns its trajectories."""

from __future__ import annotations

import contextlib
import dataclasses
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from crowdbench import catalog
from crowdbench.core.types import Trace, World
from crowdbench.metrics.registry import METRICS, Metric
from crowdbench.metrics.user_metrics import RESERVED
from crowdbench.planners.driver import Driver
from crowdbench.planners.planner import Planner
from crowdbench.result import Result, TemporaryFolder, as_path, find_earlier
from crowdbench.runs import rollout as lockstep
from crowdbench.runs.identity import new_key
from crowdbench.runs.loading import hold_out, load_run
from crowdbench.runs.make import make_run
from crowdbench.runs.parts import GOES_ON
from crowdbench.runs.rollout import Progress
from crowdbench.runs.run import Run, fit_batch
from crowdbench.runs.spec import EVERY_STEP, Replanning, RunSpec
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario
from crowdbench.utils.assignments import read_overrides
from crowdbench.utils.defaults import RECORD
from crowdbench.utils.errors import InputError, require
from crowdbench.utils.progress_bars import announce_compilation
from crowdbench.utils.progress_bars import progress as show_progress

A_PLANNER = "a name, a file or a Planner, such as MyPlanner()"

BATCHES = 4
"""Largest size of a trace that `rollout` returns, as a multiple of the traces of a batch of a run."""


def run(
    planner: str | Planner,
    scenario: str = "circle_crossing_5",
    cases: int | str | Cases = 500,
    *,
    options: Mapping[str, Any] | None = None,
    overrides: Mapping[str, Any] | Sequence[str] | None = None,
    pedestrians: str | None = None,
    metrics: Mapping[str, Metric] | None = None,
    data: Path | str | None = None,
    out: Path | str | None = None,
    key: str | None = None,
    record: str | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> Result:
    """Drive a planner through the cases of a scenario and score it, as `crowdbench run` does.

    A notebook cell can be executed again. If `out` contains the same run, it is read. If it contains a run that differs
    only in the random key of a planner or metric without `key`, the run is made again and replaces the earlier one.

    Args:
        planner: Name or file of a planner, or a planner object.
        scenario: The scenario's name or file.
        cases: Number of test cases, or cases in the format of `crowdbench run --cases`, such as "val:100".
        options: Options of a planner that is given by its name or file.
        overrides: Other values for keys of the scenario, by dotted key, or texts such as `["vehicle.visible=true"]`.
        pedestrians: The name or the file of a policy that moves all pedestrians.
        metrics: Metrics of your own by name: functions of a trace, measured after the built-in ones.
        data: The folder with recorded tracks, if the scenario needs them.
        out: The directory for the results; None for a temporary one, see `Result.save`.
        key: Your name for this version of a planner or of metrics that are defined in Python. An interrupted run can
            be continued only with a key: without it, crowdbench cannot detect whether they have changed.
        record: Extent of the recording, one of `defaults.RECORD`. By default "failures" with `out`, otherwise
            "commands".
        overwrite: True to replace an earlier run in `out`.
        progress: Called after each step with the progress of the step, as a fractional number of episodes, such as
            `tqdm(total=500, unit_scale=True).update`; None to show a bar, or lines without a terminal.

    Raises:
        InputError: An input does not exist, a plug-in breaks its contract, or the run cannot be written. A metric that
            fails only in a later case is left out of the result, with a warning.
    """
    require("planner", planner, isinstance(planner, str | Planner), A_PLANNER)
    if options and not isinstance(planner, str):
        raise InputError("options are for a planner that is named: give them to the planner that you construct")
    if key is not None and isinstance(planner, str) and not metrics:
        raise InputError("key is for what was made in Python: a planner or metrics; leave it out")
    require("scenario", scenario, isinstance(scenario, str), "a name, or a file such as './mine.toml'")
    require("options", options, isinstance(options, Mapping | None), "a table such as {'speed': 0.5}")
    require("data", data, isinstance(data, str | Path | None), "the folder with recorded tracks, or None")
    require("key", key, isinstance(key, str | None), "a text, or None")
    require("progress", progress, progress is None or callable(progress), "a function of a number, or None")
    directory = None if out is None else as_path("out", out)
    _check_metrics(metrics)
    spec = RunSpec(
        planner if isinstance(planner, str) else type(planner).__name__,
        scenario,
        Cases.parse(str(cases)),
        options=options or {},
        overrides=read_overrides(overrides),
        pedestrians=pedestrians,
        record=record if record is not None else "commands" if out is None else RECORD[0],
        data=None if data is None else Path(data).absolute(),
    )
    announce_compilation()
    loaded = load_run(spec, None if isinstance(planner, str) else planner, key=key)
    if metrics:
        identity = dataclasses.replace(loaded.planner, key=loaded.planner.key or key or new_key())
        loaded = dataclasses.replace(loaded, metrics={**loaded.metrics, **metrics}, planner=identity)
    loaded.scenario.check_data(spec.data)
    if directory is None:
        result = _run_in_temporary_folder(loaded, progress)
    else:
        result = _run_in_directory(loaded, directory, overwrite, progress)
    for reason in (*loaded.failed.values(), *loaded.lost):
        warnings.warn(f"{reason}: the result is without it", stacklevel=2)
    return dataclasses.replace(result, _loaded=loaded.scenario)


def _check_metrics(metrics: object) -> None:
    """Raise InputError unless metrics of a user are None, or functions by names that no column has."""
    right = "functions of a trace by name, such as {'mine': mine}"
    require("metrics", metrics, isinstance(metrics, Mapping | None), right)
    for name, metric in metrics.items() if isinstance(metrics, Mapping) else ():
        require("metrics", metrics, isinstance(name, str) and callable(metric), right)
        if name in METRICS or name in RESERVED:
            raise InputError(f"a column {name} exists already: give the metric another name")


def _run_in_temporary_folder(loaded: Run, progress: Progress | None) -> Result:
    """Make a run in a folder that is removed with its result. If the run fails, its finished parts are kept."""
    folder = TemporaryFolder()
    try:
        with _shown(loaded, progress) as report:
            make_run(loaded, folder.path / "run", progress=report)
    except BaseException as error:
        folder.keep_if_filled()
        notes = getattr(error, "__notes__", [])
        notes[:] = [note.replace(GOES_ON, "") for note in notes]  # another run has another folder
        raise
    return dataclasses.replace(Result.read(folder.path / "run"), _temporary=folder)


def _run_in_directory(loaded: Run, out: Path, overwrite: bool, progress: Progress | None) -> Result:
    """Make a run in a directory, unless the same run is in it."""
    has_other_key = find_earlier(out, loaded.id.parts) not in ("", loaded.id.digest)
    with _shown(loaded, progress) as report:
        if not make_run(loaded, out, overwrite=overwrite or has_other_key, progress=report):
            raise InputError(f"another process is making the run {out}: try again when it has ended")
    return Result.read(out)


def _shown(loaded: Run, progress: Progress | None) -> contextlib.AbstractContextManager[Progress]:
    return contextlib.nullcontext(progress) if progress else show_progress(len(loaded.spec.cases))


def rollout(
    planner: str | Planner,
    scenario: str | Scenario,
    cases: int | str | Cases,
    *,
    others: str | Planner | None = None,
    replanning: Replanning = EVERY_STEP,
    keep_logs: bool = False,
    undisturbed: bool = True,
    watch: Callable[[World], None] | None = None,
) -> Trace:
    """Drive a planner through cases, all in lock-step, and return the trajectories of all episodes.

    `trace.position[row, :, 0]` is the path of the vehicle in the row-th case; `trace.episode(row)` is one episode
    without the padding after its end. See `Trace`.

    Args:
        planner: A planner, such as one of `load_planner`, or its name or file.
        scenario: A scenario, such as one of `load_scenario`, or its name or file.
        cases: Number of test cases, or cases in the format of `crowdbench run --cases`, such as "val:20".
        others: The planner of all vehicles but the first one of each case; None if `planner` drives all.
        replanning: The steps at which the planner gets an observation.
        keep_logs: True if the trace contains the logs of the planner.
        undisturbed: True if the trace contains the paths of cooperative pedestrians without the vehicle, which some
            metrics need. The crowd of each episode is then simulated a second time.
        watch: Called with the worlds before each step.

    Raises:
        InputError: An input does not exist, the planner or the scenario breaks its contract, or the trace would be too
            large.
    """
    require("planner", planner, isinstance(planner, str | Planner), A_PLANNER)
    require("others", others, isinstance(others, str | Planner | None), f"{A_PLANNER}, or None")
    require("scenario", scenario, isinstance(scenario, str | Scenario), "a name, a file or a Scenario")
    require("watch", watch, watch is None or callable(watch), "a function of the worlds, or None")
    require("replanning", replanning, isinstance(replanning, Replanning), "Replanning(every=8), for example")
    if isinstance(scenario, str):
        scenario = catalog.load_scenario(scenario)
    if others is not None and scenario.rules.vehicles == 1:
        raise InputError(f"others is for several vehicles, but {scenario.name} has one: set vehicle.number")
    chosen = Cases.parse(str(cases))
    most = BATCHES * fit_batch(len(chosen), scenario)
    if len(chosen) > most:
        raise InputError(f"a trace of {len(chosen)} cases of {scenario.name} is too large: roll out {most} or fewer")
    announce_compilation()
    driver, team = _driver(planner, scenario), None if others is None else _driver(others, scenario)
    settings: dict[str, Any] = {"keep_logs": keep_logs, "undisturbed": undisturbed, "watch": watch}
    try:
        return lockstep.rollout(driver, scenario, chosen, others=team, replanning=replanning, **settings)
    except lockstep.LogsTooLarge as error:
        raise InputError(f"the planner's logs are too large: roll out {error.fitting} cases or fewer") from None


def _driver(planner: str | Planner, scenario: Scenario) -> Driver:
    planner = catalog.load_planner(planner) if isinstance(planner, str) else planner
    name = type(planner).__name__
    return Driver(hold_out(planner, name, scenario), name)
