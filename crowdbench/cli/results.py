"""The commands that read runs: compare, score, export."""

from __future__ import annotations

import dataclasses
import functools
import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from crowdbench.cli.cases import load_scenario, recording_of
from crowdbench.cli.console import announce_compilation, print_table, progress, say
from crowdbench.utils.errors import InputError
from crowdbench.utils.tables import Format, Grid, format_tables, plain

if TYPE_CHECKING:
    from crowdbench.metrics.info import Metric
    from crowdbench.results.episodes import Episodes
    from crowdbench.results.run_result import RunResult
    from crowdbench.scenario.scenario import Scenario


def compare(reference: Path, others: list[Path], metric: list[str] | None = None, format: Format | None = None) -> None:
    """Compare runs with one of them, paired by case.

    Runs in several scenarios are compared with the planner of the first run, in each scenario and in all together.

    Args:
        reference: Directory of the run that others are compared with.
        others: Directories of other runs on the same cases.
        metric: A metric. Repeatable. By default, all metrics for two runs, and some for more runs.
        format: Write only the comparison, as a table; latex needs the package booktabs.
    """
    from crowdbench.results.compare import compare_to, comparison_grid
    from crowdbench.results.result_file import STATED

    comparisons = compare_to(reference, others)
    for warning in dict.fromkeys(warning for comparison in comparisons for warning in comparison.warnings):
        say(f"crowdbench: {warning}")
    say(STATED)
    grid = comparison_grid(comparisons, metric or [])
    if format is not None:
        print(format_tables([grid], format))
        return
    print_table(grid)
    print("\nRates (p: McNemar's exact test) and metrics that include failures are over all shared cases, the others")
    print("over the cases that both runs solve. Intervals are of the paired difference, and go with p.")
    if len(comparisons) > 1:
        print("p corrected: for the number of tests of a metric (Holm 1979), separately for all scenarios together.")
    several = len({comparison.scenario for comparison in comparisons}) > 1
    for comparison in comparisons:
        for line in comparison.list_changed_cases():
            print(f"{comparison.scenario}: {line}" if several else line)


def score(
    recording: Path,
    metric: list[str] | None = None,
    replay: bool = False,
    pedestrians: list[str] | None = None,
    layout: str | None = None,
    data: Path | None = None,
    as_json: bool = False,
) -> None:
    """Compute the metrics of a run again: from its recording, or by a replay of its commands.

    Args:
        recording: Directory of a run, or an .rrd file.
        replay: Simulate all cases again from the recorded commands, without the planner, and report differences from
            the run's files.
        pedestrians: With --replay: your file of a pedestrian policy that the run used, ./mine.py. Repeatable.
        layout: With --replay: your file of a layout that the run used, ./mine.py.
    """
    if replay:
        from crowdbench.metrics.user_metrics import load_metrics
        from crowdbench.results.run_result import RunResult

        announce_compilation()
        run = RunResult.read_unchecked(recording)
        _replay(run, load_scenario(run, pedestrians, layout, data), load_metrics(metric or []), as_json)
        return
    given = {"--layout": layout, "--data": data, "--pedestrians": pedestrians}
    if wrong := [flag for flag, value in given.items() if value]:
        raise InputError(f"{wrong[0]} is for --replay: a recording contains all tracks")
    from crowdbench.metrics.user_metrics import load_metrics
    from crowdbench.record.contents import read
    from crowdbench.results.episodes import Episodes
    from crowdbench.results.result_file import STATED
    from crowdbench.results.run_result import RunResult
    from crowdbench.results.table import metric_grid
    from crowdbench.runs.replay import check_recorded

    checked = RunResult.read(recording) if recording.is_dir() else None
    metrics, contents = load_metrics(metric or []), read(recording_of(recording))
    episodes = Episodes.of(contents.trace, metrics)
    if checked is not None:
        for warning in checked.warnings:
            say(f"crowdbench: {warning}")
        say(STATED)
        check_recorded(checked, episodes, metrics)
    # Rates over some of the cases would be biased, because failures have priority in recordings.
    summary = episodes.summary() if len(episodes) == (contents.cases if checked is None else len(checked.cases)) else {}
    if as_json:
        about = {"planner": contents.planner, "scenario": contents.scenario, "cases": contents.cases}
        rows = dataclasses.replace(episodes, block=None).to_arrow().to_pylist()
        result = {"metrics": plain(summary), "rates": episodes.rates} if summary else {}
        print(json.dumps({**about, "episodes": rows, **result}, indent=2))
    elif summary:
        title = f"{contents.planner} on {contents.scenario}, from {recording}"
        print_table(metric_grid(title, summary, episodes.rates, metrics, all_metrics=False))
    else:
        print_table(_episodes_table(contents.cases, episodes))


def _episodes_table(cases: int, episodes: Episodes) -> Grid:
    """Return the episodes of a recording that lacks some of `cases`, without means, which would be biased."""
    from crowdbench.core.types import Outcome
    from crowdbench.metrics.registry import METRICS

    title = f"{len(episodes)} of {cases} cases are recorded; rates over these alone would be biased"
    shown = ["navigation_time", "path_length", "minimum_gap", "discomfort", "max_velocity_change", "jerk"]
    shown += [name for name in episodes.columns if name not in METRICS]
    outcomes = [Outcome(outcome).label for outcome in episodes.outcome]
    infos = episodes.infos
    values = ([infos[name].number(value) for value in episodes.columns[name]] for name in shown)
    rows = list(zip(map(str, episodes.case.tolist()), outcomes, *values, strict=True))
    header = ("case", "outcome", *(infos[name].heading for name in shown))
    return Grid(title, header, rows, align="rl".ljust(len(header), "r"))


def _replay(run: RunResult, scenario: Scenario, metrics: Mapping[str, Metric], as_json: bool) -> None:
    """Print the result of a replay, and exit with status 1 if anything differs."""
    from crowdbench.runs.replay import replay_run

    with progress(len(run.commands.case)) as report:
        result = replay_run(run, scenario, metrics, report)
    print(json.dumps(result.to_json(), indent=2) if as_json else result)
    if result.differences:
        sys.exit(1)


def export(
    runs: list[Path],
    out: Annotated[Path, typer.Option()],
    format: Literal["txt", "socnav", "rosbag2", "replay"] = "txt",
    pedestrians: list[str] | None = None,
    layout: str | None = None,
    data: Path | None = None,
    overwrite: bool = False,
) -> None:
    """Write the tracks of a run and a table of its steps for other programs, or a page that plays runs in a browser.

    The cases are simulated again from the recorded commands, without the planner. The recorded drives of a robot are
    written as they are.

    Args:
        runs: Directory of a run; of several runs for a replay.
        out: Directory to write: `tracks/` has a file for each case, with a line `frame person x y` for each position
            in metres. The vehicle is person 0, and a frame is a step. `steps.parquet` has a row for each step, with the
            observation of the environments, the command, CrowdNav's reward, and whether the episode ends.
        format: Format of the tracks. socnav: JSON files of SocNav3 (arXiv:2509.01251), whose metric predicts human
            ratings of a trajectory. These runs have no human ratings. rosbag2: ROS 2 bags (MCAP) for RViz and Foxglove,
            with the extra ros. replay: a page, `index.html`, that plays the cases of the runs, with several planners
            side by side, and needs no server.
        pedestrians: Your file of a pedestrian policy that the run used, ./mine.py. Repeatable.
        layout: Your file of a layout that the run used, ./mine.py.
    """
    from crowdbench.export.export import STEPS
    from crowdbench.export.export import export as write
    from crowdbench.export.replay_page import PAGE, export_page
    from crowdbench.results.run_result import RunResult
    from crowdbench.utils import files

    if len(runs) > 1 and format != "replay":
        raise InputError(f"--format {format} takes one run, and {len(runs)} are given")
    mark = PAGE if format == "replay" else STEPS
    files.check_free(out, overwrite, mark)
    announce_compilation()
    results = [RunResult.read(run) for run in runs]
    number = sum(len(result.episodes) for result in results)
    load = functools.partial(load_scenario, pedestrians=pedestrians, layout=layout, data=data)
    with files.new_directory(out, overwrite, mark) as folder, progress(number) as report:
        if format == "replay":
            cases = export_page(results, load, folder, report)
        else:
            cases = write(results[0], load, folder, report, format)
    print(f"{cases} cases in {out}")
