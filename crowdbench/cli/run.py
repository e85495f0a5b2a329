"""The commands that drive a planner through cases and score it, and that make one run of several."""

from __future__ import annotations

import contextlib
import json
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from crowdbench.cli.options import (
    INTERRUPTED,
    CasesOption,
    JsonOption,
    LimitOption,
    MetricOption,
    OptionOption,
    PedestriansOption,
    PlannerOption,
    ScenarioOption,
    SetOption,
    ThreadsOption,
    assignments,
    print_table,
    use_threads,
)
from crowdbench.errors import InputError
from crowdbench.evaluate.replanning import LOOK_FIRST, Replanning
from crowdbench.settings import BATCH, DECISION_LIMIT, FIRST_RECORDED, MOST_FAILURES, RECORD

if TYPE_CHECKING:
    from crowdbench.evaluate.driver import Driver
    from crowdbench.evaluate.metrics import Metric

RECORD_HELP = (
    f"What to record: episodes for the viewer (failures: {MOST_FAILURES} at most, and the first {FIRST_RECORDED} "
    "cases; or all), only the commands, with which `crowdbench score --replay` simulates the cases again, or none."
)


def run(
    planner: PlannerOption,
    scenario: ScenarioOption = "circle_crossing_5",
    cases: CasesOption = "500",
    option: OptionOption = None,
    overrides: SetOption = None,
    pedestrians: PedestriansOption = None,
    replan_every: Annotated[
        int, typer.Option(min=1, help="Commands per observation; above 1 the planner drives open loop.")
    ] = 1,
    look_first: Annotated[
        int,
        typer.Option(
            min=1,
            help="With --replan-every, decide at every step until so many positions of the pedestrians are seen; "
            "1 starts with several commands at once.",
        ),
    ] = LOOK_FIRST,
    isolated: Annotated[
        bool, typer.Option("--isolated", help="Run the planner in a process of its own, which sees observations only.")
    ] = False,
    metric: MetricOption = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Directory for the results.", show_default="in runs/, named after the run"),
    ] = None,
    record: Annotated[str, typer.Option(help=RECORD_HELP)] = RECORD[0],
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the directory of an earlier run.")] = False,
    batch: Annotated[int, typer.Option(min=1, help="Cases that are simulated at once.")] = BATCH,
    shard: Annotated[
        str | None,
        typer.Option(help="Run one share of the batches, such as 2/8; whoever ends last puts all of them together."),
    ] = None,
    threads: ThreadsOption = None,
    decision_limit: LimitOption = DECISION_LIMIT,
    as_json: JsonOption = False,
) -> None:
    """Drive a planner through the cases of a scenario and score it."""
    use_threads(threads)
    from crowdbench import catalog, plugins
    from crowdbench.cli.console import announce_compilation, progress, say
    from crowdbench.evaluate import run as runs
    from crowdbench.evaluate.results import planner_label
    from crowdbench.evaluate.shard import WHOLE, Shard
    from crowdbench.scenario.cases import Cases

    if record not in RECORD:
        raise InputError(f"--record {record} is not one of {', '.join(RECORD)}")
    announce_compilation()
    selected = Cases.parse(cases)
    options = assignments(option or [], "--option")
    settings = assignments(overrides or [], "--set")
    loaded = catalog.load_scenario(scenario, settings, pedestrians)
    changes = settings | ({"pedestrians": pedestrians} if pedestrians else {})
    metrics = catalog.load_metrics(metric or [])
    own_metrics = {spec: plugins.source(spec) for spec in metric or []}
    replanning = Replanning(replan_every, look_first)
    with (
        _interrupts_told(),
        _planner(planner, options, isolated, decision_limit) as (driver, about),
        progress(len(selected), f"of {len(selected)} cases") as tell,
    ):
        name = driver.name
        directory = out or Path("runs") / runs.directory_name(
            name, loaded.name, selected, options | changes | replanning.settings
        )
        finished = runs.run(
            driver,
            loaded,
            selected,
            directory,
            metrics=metrics,
            about={"options": options, **about, "overrides": changes},
            asked={"planner": planner, "scenario": scenario, "pedestrians": pedestrians, "own_metrics": own_metrics},
            replanning=replanning,
            record=record,
            batch=batch,
            shard=Shard.parse(shard) if shard else WHOLE,
            overwrite=overwrite,
            progress=tell,
        )
    if finished.result is None:
        there = f"{finished.cases} of {len(selected)} cases are in {finished.folder}"
        say(f"crowdbench: {there}; the shard that ends last puts all of them together")
    elif as_json:
        print(json.dumps(finished.result, indent=2))
    else:
        changed = "".join(f", {key}={value}" for key, value in changes.items())
        what = f"{planner_label(name, options, replanning.settings)} on {loaded.name}{changed}"
        print_result(what, finished.result, metrics, directory)


def merge(
    runs: Annotated[list[Path], typer.Argument(help="Directories of runs, or of their parts (runs/NAME.parts-...).")],
    out: Annotated[Path, typer.Option(help="Directory for the merged run.")],
    metric: MetricOption = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the directory of an earlier run.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Make one run of several, whose cases follow each other."""
    from crowdbench import catalog
    from crowdbench.evaluate import merge as merging
    from crowdbench.evaluate import parts
    from crowdbench.evaluate.results import planner_label, replanning_of

    metrics = catalog.load_metrics(metric or [])
    is_whole = True
    if all((run / parts.REQUEST).exists() for run in runs):
        runs, is_whole = parts.finished(runs)
    result = merging.merge(runs, out, overwrite, interrupted=not is_whole)
    if as_json:
        print(json.dumps(result, indent=2))
        return
    label = planner_label(result["planner"], result["options"], replanning_of(result))
    print_result(f"{label} on {result['scenario']['name']}", result, metrics, out)


@contextlib.contextmanager
def _interrupts_told() -> Iterator[None]:
    """Says what an interrupted run has kept, and exits. Typer would end the command without a word."""
    from crowdbench.cli.console import say

    try:
        yield
    except KeyboardInterrupt as error:
        if not str(error):
            raise
        say(f"crowdbench: {error}")
        sys.exit(INTERRUPTED)


@contextlib.contextmanager
def _planner(
    planner: str, options: Mapping[str, Any], isolated: bool, decision_limit: float
) -> Iterator[tuple[Driver, dict[str, Any]]]:
    """The driver of a planner, and what the result says of the planner's files and process."""
    from crowdbench import catalog
    from crowdbench.evaluate.driver import Driver

    if not isolated:
        name, made = catalog.load_planner(planner, options)
        yield Driver(made, name, decision_limit), {"planner_files": catalog.planner_files(planner, options)}
        return
    from crowdbench.isolation.planner import IsolatedPlanner, Limits

    with contextlib.closing(IsolatedPlanner(planner, options, Limits(decision=decision_limit))) as apart:
        about = {"planner_files": catalog.planner_files(planner, options), "isolation": apart.usage}
        yield Driver(apart, apart.name, decision_limit), about


def print_result(what: str, result: Mapping[str, Any], metrics: Mapping[str, Metric], directory: Path) -> None:
    """Print the table of a run, and where its files are."""
    from crowdbench.cli.tables import result_table

    print_table(result_table(f"{what}, cases {result['cases']}", result, metrics))
    shown = f"{result['recorded']} episodes are recorded (crowdbench view shows them)"
    print(f"\nKept in {directory}; {shown if result['recorded'] else 'no episode is recorded'}")
