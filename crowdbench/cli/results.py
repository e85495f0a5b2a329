"""The commands that look at what runs left: compare, view, score."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated

import typer

from crowdbench.cli.options import DataOption, JsonOption, MetricOption, print_table
from crowdbench.errors import InputError
from crowdbench.evaluate.formats import Format, written


def compare(
    reference: Annotated[Path, typer.Argument(help="Directory of the run that others are compared with.")],
    others: Annotated[list[Path], typer.Argument(help="Directories of other runs on the same scenario and cases.")],
    metric: Annotated[
        list[str] | None, typer.Option(help="A metric. Repeatable; else all for two runs, some for more.")
    ] = None,
    format: Annotated[
        Format | None, typer.Option(help="Write the comparison alone, as a table; latex needs the package booktabs.")
    ] = None,
) -> None:
    """Compare runs with one of them, paired by case."""
    from crowdbench.cli.console import say
    from crowdbench.cli.tables import changed_cases, comparison_table, grid_table
    from crowdbench.evaluate.compare import compare_to
    from crowdbench.figures.table import comparison

    found = compare_to(reference, others)
    for doubt in dict.fromkeys(doubt for one in found for doubt in one.doubts):
        say(f"crowdbench: {doubt}")
    if format is not None:
        print(written([comparison(found, metric or [])], format))
        return
    if len(found) == 1 and not metric:
        print_table(comparison_table(found[0]))
    else:
        cases = ", ".join(dict.fromkeys(str(one.cases) for one in found))
        print_table(
            grid_table(f"Compared with {found[0].names[0]}: {cases} shared cases", comparison(found, metric or []))
        )
    print("\nRates (p: McNemar's exact test) and metrics that include failures are over all shared cases, the others")
    print("over the cases that both runs solve. Intervals are of the paired difference.")
    if len(found) > 1:
        print(f"The p-values of a metric are corrected for the number of runs, {len(found)} (Holm 1979).")
    for one in found:
        print(changed_cases(one) or f"No case ends differently in {one.names[1]}.")


def view(
    runs: Annotated[
        list[Path],
        typer.Argument(help="Directory of a run, or an .rrd file; several show one case of each, side by side."),
    ],
    case: Annotated[int | None, typer.Option(help="Show only this case.")] = None,
    worst: Annotated[
        str | None,
        typer.Option(help="Show the recorded case in which this metric, such as jerk, is worst in the (first) run."),
    ] = None,
    time: Annotated[
        float | None, typer.Option(min=0.0, help="Show this moment of the case first, in seconds, not its end.")
    ] = None,
    screenshot: Annotated[
        Path | None,
        typer.Option(help="Write a picture of the case to this .png file; no window opens."),
    ] = None,
    web: Annotated[bool, typer.Option("--web", help="Open it in a browser.")] = False,
) -> None:
    """Open a recording in the Rerun viewer, or the same case of several."""
    from crowdbench.record import view as viewer

    paths = [recording_of(run) for run in runs]
    if worst is not None:
        if case is not None:
            raise InputError("--worst chooses the case: leave out --case or --worst")
        shared = set.intersection(*(set(viewer.recorded_cases(path)) for path in paths))
        case = _worst(runs[0], worst, sorted(shared))
        print(f"case {case}")
    if len(paths) == 1:
        viewer.view(paths[0], case, screenshot, seconds=time, web=web)
    elif case is None:
        raise InputError("several runs are shown side by side in one case: give --case 37 or --worst METRIC")
    else:
        viewer.view_beside(paths, case, screenshot, seconds=time, web=web)


def _worst(run: Path, metric: str, recorded: list[int]) -> int:
    """The recorded case of a run with the worst value of a metric.

    Args:
        run: The directory of the run.
        metric: The metric's name.
        recorded: The cases that are recorded.

    Raises:
        InputError: It is no directory of a run, or has no such metric, or none in a recorded case.
    """
    import numpy as np

    from crowdbench.evaluate.metrics import MORE_IS_BETTER
    from crowdbench.evaluate.results import EPISODES, Episodes

    if not run.is_dir():
        raise InputError(f"--worst needs the directory of a run, whose {EPISODES} has the metrics, not {run}")
    episodes = Episodes.read(run / EPISODES)
    if metric not in episodes.columns:
        raise InputError(f"{run} has no metric {metric}; it has {', '.join(episodes.columns)}")
    values = episodes.columns[metric].astype(float) * (-1.0 if metric in MORE_IS_BETTER else 1.0)
    values[~np.isin(episodes.case, recorded)] = np.nan
    if np.isnan(values).all():
        raise InputError(f"{metric} is not defined in any recorded case of {run}")
    return int(episodes.case[np.nanargmax(values)])


def score(
    recording: Annotated[Path, typer.Argument(help="Directory of a run, or an .rrd file.")],
    metric: MetricOption = None,
    replay: Annotated[
        bool,
        typer.Option(
            "--replay",
            help="Simulate all cases again from the recorded commands, without the planner, and say what in the run's "
            "files differs.",
        ),
    ] = False,
    pedestrians: Annotated[
        list[str] | None,
        typer.Option(
            help="With --replay: the file of a pedestrian policy of your own that the run had, ./mine.py. Repeatable."
        ),
    ] = None,
    layout: Annotated[
        str | None, typer.Option(help="With --replay: the file of a layout of your own that the run had, ./mine.py.")
    ] = None,
    data: DataOption = None,
    as_json: JsonOption = False,
) -> None:
    """Compute the metrics of a run again: from its recording, or by a replay of its commands."""
    if replay:
        _replay(recording, metric or [], pedestrians or [], layout, data, as_json)
        return
    if layout:
        raise InputError("--layout is for --replay: a recording says where everybody started")
    if data:
        raise InputError("--data is for --replay: a recording says where everybody walked")
    if pedestrians:
        raise InputError("--pedestrians is for --replay: a recording says where the pedestrians walked")
    from crowdbench import catalog
    from crowdbench.cli.console import say
    from crowdbench.cli.tables import episodes_table, result_table
    from crowdbench.evaluate.results import RECORDING
    from crowdbench.evaluate.score import score as measure
    from crowdbench.evaluate.seal import doubts

    if recording.is_dir():
        for doubt in doubts(recording, (RECORDING,)):
            say(f"crowdbench: {doubt}")
    metrics = catalog.load_metrics(metric or [])
    scored = measure(recording_of(recording), metrics)
    if as_json:
        print(json.dumps(scored.to_json(), indent=2))
    elif scored.complete:
        title = f"{scored.planner} on {scored.scenario}, from {recording}"
        print_table(result_table(title, scored.to_json(), metrics))
    else:
        print_table(episodes_table(scored.cases, scored.episodes))


def _replay(
    directory: Path, metrics: list[str], pedestrians: list[str], layout: str | None, data: Path | None, as_json: bool
) -> None:
    """Print what a replay finds, and exit with 1 if anything differs."""
    from crowdbench import catalog
    from crowdbench.cli.console import announce_compilation, progress
    from crowdbench.evaluate.replay import RunFiles, replay
    from crowdbench.evaluate.results import RESULT

    announce_compilation()
    measured = catalog.load_metrics(metrics)
    files = RunFiles.read(directory)
    source = str(directory / RESULT)
    scenario = catalog.load_recorded_scenario(files.result["scenario"], source, pedestrians, layout, data)
    cases = len(files.commands.case)
    with progress(cases, f"of {cases} cases") as tell:
        found = replay(files, scenario, measured, tell)
    print(json.dumps(found.to_json(), indent=2) if as_json else found)
    if found.differences:
        sys.exit(1)


def recording_of(path: Path) -> Path:
    """The recording of a run, given by its directory or by the file itself."""
    from crowdbench.evaluate.results import RECORDING

    return path / RECORDING if path.is_dir() else path
