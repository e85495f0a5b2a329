"""The commands that drive a planner through cases and score it, and that make one run of several."""

from __future__ import annotations

import contextlib
import json
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from crowdbench.cli.options import (
    INTERRUPTED,
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
    print_table,
    use_threads,
)
from crowdbench.errors import InputError
from crowdbench.evaluate.replanning import LOOK_FIRST, Replanning
from crowdbench.settings import BATCH, DECISION_LIMIT, FIRST_RECORDED, MOST_FAILURES, RECORD

if TYPE_CHECKING:
    from crowdbench.evaluate.metrics import Metric
    from crowdbench.evaluate.shard import Shard
    from crowdbench.evaluate.wanted import Wanted
    from crowdbench.spec import RunSpec

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
    context: typer.Context,
    planner: PlannerOption,
    scenario: ScenarioOption = "circle_crossing_5",
    board: Annotated[
        str | None,
        typer.Option(help="Instead of a scenario: all those of a board, by its rules and on its public cases."),
    ] = None,
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
    """Drive a planner through the cases of a scenario, or of all scenarios of a board, and score it."""
    on_ray = is_on_ray(on)
    use_threads(None if on_ray else threads)
    if board is not None:
        from crowdbench.cli.run_board import check_alone, is_given, run_board

        check_alone(context)
        with interrupts_told():
            run_board(
                board,
                planner,
                assignments(option or [], "--option"),
                cases if is_given(context, "cases") else None,
                data,
                out,
                as_json,
            )
        return
    from crowdbench.cli.console import announce_compilation, progress, say
    from crowdbench.evaluate import run as runs
    from crowdbench.evaluate.results import planner_label
    from crowdbench.evaluate.shard import WHOLE, Shard
    from crowdbench.scenario.cases import Cases
    from crowdbench.spec import RunSpec

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
    with interrupts_told(), spec.loaded() as wanted, progress(len(spec.cases), f"of {len(spec.cases)} cases") as tell:
        wanted.scenario.check_data(data)
        changes = {**spec.options, **spec.changes, **spec.replanning.settings}
        name = runs.directory_name(wanted.driver.name, wanted.scenario.name, spec.cases, changes)
        say_of_training(wanted)
        if wanted.scenario.certificates is not None:
            say(f"crowdbench: {wanted.scenario.certificates.sentence(wanted.scenario, wanted.cases)}")
        directory = out or Path("runs") / name
        if on_ray:
            _make_on_ray(spec, wanted, directory, own, overwrite, threads, tell)
        finished = runs.make(wanted, directory, shard=own, overwrite=overwrite, progress=None if on_ray else tell)
    if finished.result is None:
        there = f"{finished.cases} of {len(spec.cases)} cases are in {finished.folder}"
        say(f"crowdbench: {there}; the shard that ends last puts all of them together")
    elif as_json:
        print(json.dumps(finished.result, indent=2))
    else:
        changed = "".join(f", {key}={value}" for key, value in spec.changes.items())
        label = planner_label(wanted.driver.name, spec.options, spec.replanning.settings)
        print_result(f"{label} on {wanted.scenario.name}{changed}", finished.result, wanted.metrics, directory)


def say_of_training(wanted: Wanted) -> None:
    """Says where a scenario has more pedestrians than its planner was trained with."""
    from crowdbench.cli.console import say

    trained, most = wanted.driver.planner.trained_pedestrians, wanted.scenario.max_agents - 1
    if trained is not None and most > trained:
        numbers = f"{trained} pedestrian{'s'[: trained != 1]} at most, but {wanted.scenario.name} has {most}"
        say(f"crowdbench: planner {wanted.driver.name} was trained with {numbers}: its figures may be worse for that")


def _make_on_ray(
    spec: RunSpec,
    wanted: Wanted,
    directory: Path,
    shard: Shard,
    overwrite: bool,
    threads: int | None,
    tell: Callable[[float], None],
) -> None:
    """Have the workers of a Ray cluster make the parts of a run, or of a shard of it."""
    from crowdbench import cluster
    from crowdbench.evaluate.directory import check_free
    from crowdbench.evaluate.run import parts_of

    check_free(directory, overwrite)
    parts = parts_of(wanted, directory)
    with parts.told():
        cluster.make_parts([cluster.Job(spec, parts, shard.own(parts.cases))], cpus=threads or 1, progress=tell)


def merge(
    runs: Annotated[list[Path], typer.Argument(help="Directories of runs, or of their parts (runs/NAME.parts-...).")],
    out: Annotated[Path, typer.Option(help="Directory for the merged run.")],
    metric: MetricOption = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the directory of an earlier run.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Make one run of several, whose cases follow each other."""
    from crowdbench import catalog
    from crowdbench.cli.console import say
    from crowdbench.evaluate import merge as merging
    from crowdbench.evaluate import parts
    from crowdbench.evaluate.results import planner_label, replanning_of

    metrics = catalog.load_metrics(metric or [])
    is_whole = True
    if all((run / parts.REQUEST).exists() for run in runs):
        runs, is_whole = parts.finished(runs)
        if not is_whole:
            say("crowdbench: parts are missing: what is merged ends before the first of them")
    result = merging.merge(runs, out, overwrite, interrupted=not is_whole)
    if as_json:
        print(json.dumps(result, indent=2))
        return
    label = planner_label(result["planner"], result["options"], replanning_of(result))
    print_result(f"{label} on {result['scenario']['name']}", result, metrics, out)


@contextlib.contextmanager
def interrupts_told() -> Iterator[None]:
    """Says what an interrupted run has kept, and exits. Typer would end the command without a word."""
    from crowdbench.cli.console import say

    try:
        yield
    except KeyboardInterrupt as error:
        if not str(error):
            raise
        say(f"crowdbench: {error}")
        sys.exit(INTERRUPTED)


def print_result(what: str, result: Mapping[str, Any], metrics: Mapping[str, Metric], directory: Path) -> None:
    """Print the table of a run, and where its files are.

    Args:
        what: The title of the table.
        result: The run's `result.json`.
        metrics: The metrics that it has, by name.
        directory: Where its files are.
    """
    from crowdbench.cli.tables import result_table
    from crowdbench.scenario.tracked import RECORDED

    print_table(result_table(f"{what}, cases {result['cases']}", result, metrics))
    if "tracks" in result["scenario"]:
        policy = result["scenario"]["pedestrians"]["policy"]
        print(f"\nIntervals are over the {result['blocks']} blocks of recorded time that the cases are from.")
        if RECORDED in (policy if isinstance(policy, dict) else [policy]):
            print(UNHEEDED)
    shown = f"{result['recorded']} episodes are recorded (crowdbench view shows them)"
    print(f"\nKept in {directory}; {shown if result['recorded'] else 'no episode is recorded'}")
