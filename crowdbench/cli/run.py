"""The commands that drive a planner through cases and score it, and that make one run of several."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from crowdbench.cli.failures import exit_on_interrupt
from crowdbench.cli.options import (
    CasesOption,
    DataOption,
    JsonOption,
    LimitOption,
    MetricOption,
    OnOption,
    OptionOption,
    PedestriansOption,
    PlannerOption,
    ScenarioOption,
    SetOption,
    ThreadsOption,
    assignments,
    is_on_ray,
    use_threads,
)
from crowdbench.cli.tables import print_table, result_table
from crowdbench.runs.spec import LOOK_FIRST, Replanning
from crowdbench.utils.defaults import BATCH, DECISION_LIMIT, FIRST_RECORDED, MOST_FAILURES, RECORD
from crowdbench.utils.errors import InputError

if TYPE_CHECKING:
    from crowdbench.metrics import Metric
    from crowdbench.runs.run import Run

RECORD_HELP = (
    f"What to record: episodes for the viewer (failures: {MOST_FAILURES} at most, fewer in large crowds, and the first "
    f"{FIRST_RECORDED} cases; or all), only the commands, with which `crowdbench score --replay` simulates the cases "
    "again, or none."
)


UNHEEDED = (
    "Recorded people do not react: they walk into a vehicle that they would have gone around, and never wait for one. "
    "So there are more collisions than among real people, and a planner that pushes its way through is not penalised."
)
"""What a score means where people do not react."""


def run(
    planner: PlannerOption,
    scenario: ScenarioOption = "circle_crossing_5",
    cases: CasesOption = "500",
    option: OptionOption = None,
    overrides: SetOption = None,
    pedestrians: PedestriansOption = None,
    data: DataOption = None,
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
    on: OnOption = None,
    threads: ThreadsOption = None,
    decision_limit: LimitOption = DECISION_LIMIT,
    as_json: JsonOption = False,
) -> None:
    """Drive a planner through the cases of a scenario, and score it."""
    on_ray = is_on_ray(on)
    use_threads(None if on_ray else threads)
    from crowdbench.cli.console import announce_compilation, progress, say
    from crowdbench.runs.load import open_run
    from crowdbench.runs.results import read_result
    from crowdbench.runs.shards import WHOLE, Shard, make_run
    from crowdbench.runs.spec import RunSpec, directory_name
    from crowdbench.scenario.cases import Cases

    if record not in RECORD:
        raise InputError(f"--record {record} is not one of {', '.join(RECORD)}")
    announce_compilation()
    spec = RunSpec(
        planner,
        scenario,
        Cases.parse(cases),
        assignments(option or [], "--option"),
        assignments(overrides or [], "--set"),
        pedestrians,
        tuple(metric or []),
        Replanning(replan_every, look_first),
        record,
        batch,
        isolated,
        decision_limit,
        data.absolute() if data else None,  # workers of a cluster have other working directories
    )
    own = Shard.parse(shard) if shard else WHOLE
    with (
        exit_on_interrupt(),
        open_run(spec) as loaded,
        progress(len(spec.cases), f"of {len(spec.cases)} cases") as tell,
    ):
        loaded.scenario.check_data(data)
        say_of_training(loaded)
        if loaded.scenario.certificates is not None:
            say(f"crowdbench: {loaded.scenario.certificates.sentence(spec.cases)}")
        directory = out or Path("runs") / directory_name(loaded.driver.name, loaded.scenario.name, spec)
        if on_ray:
            from crowdbench.runs.on_ray import make_run_on_ray

            make_run_on_ray(loaded, directory, own, overwrite, cpus=threads or 1, progress=tell)
        there = make_run(loaded, directory, shard=own, overwrite=overwrite, progress=None if on_ray else tell)
    if not there.is_whole:
        kept = f"{there.cases} of {len(spec.cases)} cases are in {there.folder}"
        say(f"crowdbench: {kept}; the shard that ends last puts all of them together")
        return
    result = read_result(directory)
    changed = "".join(f", {key}={value}" for key, value in spec.changes.items())
    title = f"{loaded.label} on {loaded.scenario.name}{changed}"
    print_result(title, result, loaded.metrics, directory, as_json)


def say_of_training(run: Run) -> None:
    """Says where a scenario has more pedestrians than its planner was trained with."""
    from crowdbench.cli.console import say

    trained, most = run.driver.planner.trained_pedestrians, run.scenario.max_agents - 1
    if trained is not None and most > trained:
        numbers = f"{trained} pedestrian{'s'[: trained != 1]} at most, but {run.scenario.name} has {most}"
        say(f"crowdbench: planner {run.driver.name} was trained with {numbers}: its figures may be worse for that")


def merge(
    runs: Annotated[list[Path], typer.Argument(help="Directories of runs, or of their parts (runs/NAME.parts-...).")],
    out: Annotated[Path, typer.Option(help="Directory for the merged run.")],
    metric: MetricOption = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the directory of an earlier run.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Make one run of several, whose cases follow each other."""
    from crowdbench.cli.console import say
    from crowdbench.metrics.load import load_metrics
    from crowdbench.runs.merge import merge as merge_runs
    from crowdbench.runs.results import result_label
    from crowdbench.runs.shards import REQUEST, find_finished

    metrics = load_metrics(metric or [])
    is_whole = True
    if all((run / REQUEST).exists() for run in runs):
        runs, is_whole = find_finished(runs)
        if not is_whole:
            say("crowdbench: parts are missing: what is merged ends before the first of them")
    result = merge_runs(runs, out, overwrite, interrupted=not is_whole)
    print_result(f"{result_label(result)} on {result['scenario']['name']}", result, metrics, out, as_json)


def print_result(
    title: str, result: Mapping[str, Any], metrics: Mapping[str, Metric], directory: Path, as_json: bool
) -> None:
    """Print the table of a run, and where its files are, or its result as JSON.

    Args:
        title: The title of the table.
        result: The run's `result.json`.
        metrics: The metrics that it has, by name.
        directory: Where its files are.
        as_json: Whether to print JSON.
    """
    if as_json:
        print(json.dumps(result, indent=2))
        return
    from crowdbench.scenario.population import RECORDED

    print_table(result_table(f"{title}, cases {result['cases']}", result, metrics))
    if "tracks" in result["scenario"]:
        policy = result["scenario"]["pedestrians"]["policy"]
        print(f"\nIntervals are over the {result['blocks']} blocks of recorded time that the cases are from.")
        if RECORDED in (policy if isinstance(policy, dict) else [policy]):
            print(UNHEEDED)
    shown = f"{result['recorded']} episodes are recorded (crowdbench view shows them)"
    print(f"\nKept in {directory}; {shown if result['recorded'] else 'no episode is recorded'}")
