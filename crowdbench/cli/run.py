"""The commands that drive a planner through cases and score it, and that merge several runs."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from crowdbench.cli.cases import replay_options
from crowdbench.cli.console import BAD, announce_compilation, exit_on_interrupt, print_table, progress, say, write
from crowdbench.cli.options import ThreadsOption, WorkersOption, assignments, use_threads
from crowdbench.runs.spec import LOOK_FIRST, Replanning
from crowdbench.utils.commands import command
from crowdbench.utils.defaults import BATCH, DECISION_LIMIT, FIRST_RECORDED, MOST_FAILURES, RECORD
from crowdbench.utils.errors import InputError

if TYPE_CHECKING:
    from crowdbench.metrics.registry import Metric
    from crowdbench.runs.parts import Parts
    from crowdbench.runs.run import Run
    from crowdbench.runs.shards import Shard
    from crowdbench.runs.spec import RunSpec
    from crowdbench.utils.executors import Executor

RECORD_HELP = (
    f"Extent of the recording: episodes for the viewer (failures: {MOST_FAILURES} at most, fewer in large crowds, and "
    f"the first {FIRST_RECORDED} cases; or all), only the commands, with which `crowdbench score` simulates "
    "the cases again, or none."
)

NON_REACTIVE_NOTE = (
    "Recorded pedestrians do not react: they never wait for the vehicle, and walk into it where they would have "
    "avoided it. So there are more collisions than among real pedestrians, and pushing through is not penalised."
)
"""Meaning of a score if pedestrians do not react."""


def run(
    planner: Annotated[str, typer.Option()],
    scenario: str = "circle_crossing_5",
    cases: str = "500",
    option: list[str] | None = None,
    others: str | None = None,
    overrides: list[str] | None = None,
    pedestrians: Annotated[str | None, typer.Option(show_default="as the scenario says")] = None,
    data: Path | None = None,
    replan_every: Annotated[int, typer.Option(min=1)] = 1,
    look_first: Annotated[int, typer.Option(min=1)] = LOOK_FIRST,
    isolated: bool = False,
    metric: list[str] | None = None,
    out: Annotated[Path | None, typer.Option(show_default="in runs/, named after the run")] = None,
    record: Annotated[str, typer.Option(help=RECORD_HELP)] = RECORD[0],
    overwrite: bool = False,
    batch: Annotated[int, typer.Option(min=1)] = BATCH,
    workers: WorkersOption = None,
    engine: str | None = None,
    shard: str | None = None,
    threads: ThreadsOption = None,
    decision_limit: float = DECISION_LIMIT,
    all_metrics: bool = False,
    as_json: bool = False,
) -> None:
    """Drive a planner through the cases of a scenario, and score it.

    Args:
        cases: 500 (the first 500 test cases), 2000:2500, test/37 (one case), val:100 (validation cases).
        others: Planner of all vehicles but the first, which alone is scored, in scenarios with several vehicles.
        pedestrians: Move all pedestrians by one policy: a name or ./mine.py.
        replan_every: Commands per observation; above 1 the planner drives open loop.
        look_first: With --replan-every, decide at every step until this number of positions of the pedestrians is
            observed; 1 starts with several commands at once.
        isolated: Run the planner in a separate process, which receives only observations.
        out: Directory for the results.
        batch: Cases that are simulated at once.
        shard: Drive one share of the cases, such as 2/8; the last shard to finish merges the run.
        all_metrics: Print all metrics, and not only the main ones; result.json has them all.
    """
    use_threads(threads)
    from crowdbench.runs.shards import Shard
    from crowdbench.runs.spec import RunSpec
    from crowdbench.scenario.cases import Cases
    from crowdbench.utils.executors import open_executor

    announce_compilation()
    spec = RunSpec(
        planner,
        scenario,
        Cases.parse(cases),
        options=assignments(option or [], "--option"),
        overrides=assignments(overrides or [], "--set"),
        pedestrians=pedestrians,
        metrics=tuple(metric or []),
        replanning=Replanning(replan_every, look_first),
        record=record,
        batch=batch,
        isolated=isolated,
        decision_limit=decision_limit,
        data=data.absolute() if data else None,
        others=others,
    )
    with open_executor(engine, workers, threads) as executor:
        loaded, directory = make_one_run(spec, out, Shard.parse(shard), overwrite, executor)
    changes = "".join(f", {key}={value}" for key, value in spec.changes.items())
    title = f"{loaded.label} on {loaded.scenario.name}{changes}"
    replay = replay_options(loaded.scenario, data)
    print_result(title, directory, loaded.metrics, as_json, all_metrics, replay)
    check_whole(loaded, directory, spec.metrics, replay)


def make_one_run(
    spec: RunSpec, out: Path | None, shard: Shard, overwrite: bool, executor: Executor | None
) -> tuple[Run, Path]:
    """Make a run, or a shard of it, and print warnings. If cases are missing, print how many are finished, and exit.

    Args:
        spec: The run.
        out: The directory of the run; if None, a directory in `runs/` that is named after the run.
        shard: The share of the cases to drive.
        overwrite: True to replace an earlier run in the directory.
        executor: Workers that drive the cases, if any.

    Returns:
        The run and its directory.
    """
    from crowdbench.runs.loading import open_run
    from crowdbench.runs.make import is_made, make_run, make_with
    from crowdbench.runs.parts import Parts
    from crowdbench.runs.spec import directory_name

    share = shard.share(spec.cases)
    with exit_on_interrupt(), progress(len(share)) as report, open_run(spec) as run:
        run.scenario.check_data(spec.data)
        warn_if_trained_otherwise(run)
        directory = out or Path("runs") / directory_name(run.driver.name, run.scenario.name, spec)
        if is_made(run, directory, overwrite):
            say(f"crowdbench: {directory} is complete, and nothing is driven again")
        if executor is None:
            is_complete = make_run(run, directory, shard=shard, overwrite=overwrite, progress=report)
        else:
            [made] = make_with(executor, [(run, directory)], shard=shard, overwrite=overwrite, progress=report)
            if made.error is not None:
                raise made.error
            is_complete = made.is_complete
    if is_complete:
        return run, directory
    say(f"crowdbench: {describe_parts(Parts.of(run, directory), shard)}")
    raise typer.Exit


def describe_parts(parts: Parts, shard: Shard) -> str:
    """Return a sentence on a run that is not complete: the cases of a shard, and of the run, that are finished."""
    from crowdbench.runs.shards import WHOLE

    cases, share = parts.run.spec.cases, shard.share(parts.run.spec.cases)
    # The folder is removed if it is empty.
    number = parts.count_finished() if parts.folder.exists() else 0
    missing = sum(map(len, parts.missing(share)))
    if not len(share):
        own = f"shard {shard} has no case, because there are {len(cases)} in all"
    elif missing:
        own = f"another process is making {missing} of the cases {share}"
    else:
        own = (
            f"the cases {share} of shard {shard} are finished" if shard != WHOLE else f"the cases {share} are finished"
        )
    where = f" in {parts.folder}" if number else ""
    return f"{own}; {number} of {len(cases)} cases are finished{where}, and the last process to finish merges the run"


def check_whole(run: Run, directory: Path, files: Sequence[str], replay: Sequence[str]) -> None:
    """Raise InputError if a complete run lacks something: a metric of the user that failed, or its recording.

    Args:
        run: The run.
        directory: Its directory.
        files: The files of the user's metrics.
        replay: The options by which the run is simulated again.
    """
    from crowdbench.results.result_file import read_result

    lacking = [name for name in run.metrics if name not in read_result(directory)["metrics"]]
    if lacking:
        reason = run.failed.get(lacking[0], f"metric {lacking[0]} failed in another process")
        given = [word for file in files for word in ("--metric", file)]
        score = command("score", directory, *given, *replay, "--out", f"{directory}-scored")
        how = "make the run again" if run.spec.record == "none" else f"compute it with `{score}`"
        raise InputError(f"{reason}: the run is kept without it; correct the metric, and {how}")
    if run.lost:
        raise InputError(f"{run.lost[0]}; the results are kept, and `crowdbench view` simulates a case again")


def warn_if_trained_otherwise(run: Run) -> None:
    """Print a warning if a scenario has more pedestrians, or another dt, than its planner was trained with."""
    planner, name, dt = run.driver.planner, run.scenario.name, run.scenario.rules.dt
    trained, most = planner.trained_pedestrians, run.scenario.max_agents - 1
    differences = []
    if trained is not None and most > trained:
        noun = "pedestrian" if trained == 1 else "pedestrians"
        differences.append(f"{trained} {noun} at most, but {name} has {most}")
    if planner.trained_dt is not None and planner.trained_dt != dt:
        differences.append(f"steps of {planner.trained_dt:g} s, but {name} has dt = {dt:g} s")
    for difference in differences:
        say(f"crowdbench: planner {run.driver.name} was trained with {difference}: its figures may be worse for that")


def merge(
    runs: list[Path],
    out: Annotated[Path, typer.Option()],
    metric: list[str] | None = None,
    overwrite: bool = False,
    all_metrics: bool = False,
    as_json: bool = False,
) -> None:
    """Merge several runs with consecutive cases into one run.

    Args:
        runs: Directories of runs, or of parts of one (runs/NAME.parts-.../*).
        out: Directory for the merged run.
        all_metrics: Print all metrics, and not only the main ones.
    """
    from crowdbench.metrics.user_metrics import load_metrics
    from crowdbench.results.episodes import result_label
    from crowdbench.runs.merge import merge as merge_runs

    metrics = load_metrics(metric or [])
    result = merge_runs(runs, out, overwrite)
    print_result(f"{result_label(result)} on {result['scenario']['name']}", out, metrics, as_json, all_metrics)


def print_result(
    title: str,
    directory: Path,
    metrics: Mapping[str, Metric],
    as_json: bool,
    all_metrics: bool,
    replay: Sequence[str] = (),
) -> None:
    """Print the table of a run, commands to view its failures, and its directory; or print its result as JSON.

    Args:
        title: The title of the table.
        directory: The directory of the run's files.
        metrics: The metrics of the run, by name.
        as_json: True to print JSON.
        all_metrics: True if all metrics are printed.
        replay: The options by which cases that are not recorded are simulated again.
    """
    from crowdbench.cli.cases import describe_cases
    from crowdbench.results.episodes import EPISODES, RECORDING, Episodes, read_estimate
    from crowdbench.results.result_file import read_result
    from crowdbench.results.table import metric_grid

    result = read_result(directory)
    if as_json:
        print(json.dumps(result, indent=2))
        return
    title = f"{title}, cases {result['run']['cases']}"
    estimates = {name: read_estimate(table) for name, table in result["metrics"].items()}
    print_table(metric_grid(title, estimates, result["rates"], metrics, all_metrics, result.get("blocks")))
    if not all_metrics:
        write(f"{len(result['metrics'])} metrics in all: --all-metrics")
    if "tracks" in result["scenario"]:
        from crowdbench.scenario.population import RECORDED

        policy = result["scenario"]["pedestrians"]["policy"]
        write(f"\nIntervals are over the {result['blocks']} blocks of recorded time that the cases are from.")
        if RECORDED in (policy if isinstance(policy, dict) else [policy]):
            write(NON_REACTIVE_NOTE)
    number = result["recorded"]
    some = "1 episode is recorded" if number == 1 else f"{number} episodes are recorded"
    recorded = f"{some} (crowdbench view shows them)" if number else "no episode is recorded"
    write(f"\nKept in {directory}; {recorded}")
    if result["stated"]["record"] != "none":
        # A case that is not recorded is simulated again.
        for outcome, cases in Episodes.read(directory / EPISODES).failures.items():
            view = command("view", directory, "--case", cases[0], *replay)
            write(f"{describe_cases(outcome, cases)}: {view}", BAD)
            if number:
                from crowdbench.record.recorded_cases import read_recorded

                recorded_case = read_recorded(directory / RECORDING, cases[0])
                for line in recorded_case.verdict if recorded_case else []:
                    write(f"  {line}")
