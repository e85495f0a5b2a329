"""The commands that read runs: compare, score, export."""

from __future__ import annotations

import dataclasses
import json
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from crowdbench.cli.cases import make_loader
from crowdbench.cli.console import BAD, GOOD, announce_compilation, print_table, progress, say, write
from crowdbench.utils.errors import InputError
from crowdbench.utils.tables import Format, format_tables, plain

if TYPE_CHECKING:
    from crowdbench.metrics.registry import Metric
    from crowdbench.results.run_result import RunResult
    from crowdbench.runs.replay import Loader


def compare(reference: Path, others: list[Path], metric: list[str] | None = None, format: Format | None = None) -> None:
    """Compare runs with one of them, paired by case.

    Runs in several scenarios are compared with the planner of the first run, in each scenario and in all together.

    Args:
        reference: Directory of the run that others are compared with.
        others: Directories of other runs on the same cases.
        metric: A metric. Repeatable. By default, all metrics for two runs, and some for more runs.
        format: Write only the comparison, as a table; latex needs the package booktabs.
    """
    from crowdbench.metrics.registry import info_of
    from crowdbench.results.compare import DIFFERENCE, compare_to, comparison_grid

    comparisons = compare_to(reference, others)
    for warning in dict.fromkeys(warning for comparison in comparisons for warning in comparison.warnings):
        say(f"crowdbench: {warning}")
    grid = comparison_grid(comparisons, metric or [])
    if format is not None:
        print(format_tables([grid], format))
        return
    column = grid.header.index(DIFFERENCE)

    def color_of(row: int, cell: str) -> str:
        record = grid.records[row]
        if cell != grid.rows[row][column] or not record["significant"]:
            return ""
        gain = info_of(record["metric"]).sign * record["difference"].mean
        return GOOD if gain > 0.0 else BAD if gain < 0.0 else ""

    print_table(grid, color_of)
    several = len({comparison.scenario for comparison in comparisons}) > 1
    for comparison in comparisons:
        for line in comparison.list_changed_cases():
            before, _, after = line.partition(" (")[0].partition(", ")
            colors = {after: GOOD, before: BAD}
            color = next((color for text, color in colors.items() if text.endswith(" success")), "")
            write(f"{comparison.scenario}: {line}" if several else line, color)


def score(
    run: Path,
    metric: list[str] | None = None,
    pedestrians: list[str] | None = None,
    layout: str | None = None,
    data: Path | None = None,
    out: Annotated[Path | None, typer.Option(show_default="write nothing")] = None,
    overwrite: bool = False,
    as_json: bool = False,
) -> None:
    """Compute the metrics of a run again from its commands or tracks, and report differences from its files.

    All cases are simulated again from the stored commands, without the planner.

    Args:
        run: Directory of a run, or a file with the commands of one case, such as the game of the documentation's start
            page writes.
        metric: Your file with metrics, ./mine.py, which are computed, too. Repeatable.
        pedestrians: Your file of a pedestrian policy that the run used, ./mine.py. Repeatable.
        layout: Your file of a layout that the run used, ./mine.py.
        out: Directory for the run with all metrics that were computed, such as a metric that failed in the run.
    """
    from crowdbench.metrics.registry import OF_FLEETS
    from crowdbench.metrics.user_metrics import load_metrics
    from crowdbench.results.run_result import RunResult
    from crowdbench.runs.attempt import drive_attempt

    metrics, load = load_metrics(metric or []), make_loader(pedestrians, layout, data)
    with tempfile.TemporaryDirectory() as folder:
        stored = drive_attempt(run, Path(folder) / "run") if run.suffix == ".json" else RunResult.read(run)
        metrics |= OF_FLEETS if stored.vehicles > 1 else {}
        agrees = _score(stored, run, metrics, load, out, overwrite, as_json)
    if not agrees:
        sys.exit(1)


def _score(
    stored: RunResult,
    run: Path,
    metrics: Mapping[str, Metric],
    load: Loader,
    out: Path | None,
    overwrite: bool,
    as_json: bool,
) -> bool:
    """Compute the metrics of a run again, and return whether its files agree; see `score`."""
    from crowdbench.results.result_file import digest_of, has_run
    from crowdbench.results.table import metric_grid
    from crowdbench.runs.score import replay_run, scored_parts, write_scored
    from crowdbench.utils.files import check_free

    if out is not None and not has_run(out, digest_of(scored_parts(stored, metrics))):
        check_free(out, overwrite)
    announce_compilation()
    scenario = load(stored) if stored.is_simulated else None
    for warning in stored.warnings:
        say(f"crowdbench: {warning}")
    with progress(len(stored.episodes)) as report:
        replay = replay_run(stored, scenario, metrics, report)
    episodes, summary = replay.episodes, replay.episodes.summary()
    if as_json:
        about = {"planner": stored.label, "scenario": stored.result["scenario"]["name"]}
        rows = dataclasses.replace(episodes, block=None).to_arrow().to_pylist()
        result = {"episodes": rows, "metrics": plain(summary), "rates": episodes.rates, "comparison": replay.to_json()}
        print(json.dumps({**about, **result}, indent=2))
    else:
        title = f"{stored.label} on {stored.result['scenario']['name']}, computed again from {run}"
        print_table(metric_grid(title, summary, episodes.rates, metrics, False, episodes.blocks.get("blocks")))
        write(f"\n{replay}")
    if out is not None:
        write_scored(stored, replay, metrics, out, overwrite)
        say(f"crowdbench: {out} has the run with all metrics")
    return not replay.differences


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
    from crowdbench.export.replay_page import PAGE, export_page
    from crowdbench.export.steps import STEPS
    from crowdbench.export.tracks import FOLDER, export_tracks
    from crowdbench.results.run_result import RunResult
    from crowdbench.utils import files

    if len(runs) > 1 and format != "replay":
        raise InputError(f"--format {format} takes one run, and {len(runs)} are given")
    mark = PAGE if format == "replay" else STEPS
    files.check_free(out, overwrite, mark)
    announce_compilation()
    results = [RunResult.read(run) for run in runs]
    number = sum(len(result.episodes) for result in results)
    load = make_loader(pedestrians, layout, data)
    with files.new_directory(out, overwrite, mark) as folder, progress(number) as report:
        if format == "replay":
            cases = export_page(results, load, folder, report)
        else:
            cases = export_tracks(results[0], load, folder, report, format)
    if format == "replay":
        print(f"{cases} cases in {out / PAGE}")
    else:
        first = min(path.name for path in (out / FOLDER).iterdir())
        print(f"{cases} cases in {out / FOLDER}, such as {first}; their steps are in {out / STEPS}")
