"""The command that drives a planner through the scenarios of the suite in each track of sensing, and prints scores."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from crowdbench.cli.console import announce_compilation, exit_on_interrupt, print_table, progress, say, write
from crowdbench.cli.options import ThreadsOption, WorkersOption, assignments, use_threads

if TYPE_CHECKING:
    from crowdbench.catalog import Suite
    from crowdbench.metrics.summary import Estimate
    from crowdbench.runs.run import Run
    from crowdbench.runs.spec import RunSpec
    from crowdbench.utils.executors import Executor
    from crowdbench.utils.tables import Grid

SCORE = "score"
"""The metric of the table."""

MEAN = "mean"
"""The row of the mean over the ranked scenarios."""

CLAIM = "Simulated pedestrians: no claim on robots or comfort."

Place = tuple[str, str]
"""A scenario and a track of sensing."""


def suite(
    planner: str,
    cases: Annotated[int, typer.Option(min=1)] = 100,
    option: list[str] | None = None,
    isolated: bool = False,
    out: Path = Path("runs/suite"),
    workers: WorkersOption = None,
    engine: str | None = None,
    threads: ThreadsOption = None,
    as_json: bool = False,
) -> None:
    """Drive a planner through the suite in both tracks of sensing, and print its scores and their mean.

    The same command makes only the runs that are missing.

    Args:
        planner: Name of a planner, or a file of your own: ./mine.py, ./mine.py:factory or policy.onnx.
        cases: Number of test cases of each scenario and track.
        isolated: Run the planner in a separate process, which receives only observations.
        out: Folder that keeps the runs.
    """
    use_threads(threads)
    from crowdbench.catalog import read_suite
    from crowdbench.core.types.rules import SENSING_TRACKS
    from crowdbench.plugins.kind import plugin_name
    from crowdbench.runs.spec import RunSpec
    from crowdbench.scenario.cases import Cases
    from crowdbench.utils.executors import open_executor
    from crowdbench.utils.tables import plain

    scenarios = read_suite()
    base = RunSpec(
        planner, "", Cases("test", 0, cases), options=assignments(option or [], "--option"), isolated=isolated
    )
    specs = {
        (name, track): replace(base, scenario=name, overrides={"sensor.track": track}, record="none")
        for name in (*scenarios.ranked, *scenarios.stress, *scenarios.held_out)
        for track in SENSING_TRACKS
    }
    announce_compilation()
    message = f"finished batches are kept in {out}, with which the same command goes on"
    with (
        exit_on_interrupt(message),
        open_executor(engine, workers, threads) as executor,
        progress(cases * len(specs), "of the suite") as report,
    ):
        runs, failures = _make_runs(specs, out, executor, report)
    scores = {place: _read_score(run, out) for place, run in runs.items() if place not in failures}
    for (name, track), reason in failures.items():
        say(f"{name} ({track}) counts 0, because it cannot be driven: {reason}")
    name = plugin_name(planner) + " (raw)" * any(run.driver.raw for run in runs.values())
    table = _table(f"Score of {name} on {scenarios.version}, {cases} cases", scenarios, scores)
    if as_json:
        records = {record["scenario"]: {track: record[track] for track in SENSING_TRACKS} for record in table.records}
        print(json.dumps(plain({"version": scenarios.version, "cases": cases, "scores": records}), indent=2))
        return
    print_table(table)
    write(f"\n{CLAIM} Kept in {out}")


def _make_runs(
    specs: Mapping[Place, RunSpec], out: Path, executor: Executor | None, report: Callable[[float], None]
) -> tuple[dict[Place, Run], dict[Place, str]]:
    """Make the runs that the folder lacks.

    Args:
        specs: The run of each scenario and track.
        out: The folder.
        executor: Workers that make them, if any.
        report: Called with the progress, in cases.

    Returns:
        The runs, and the error in each scenario and track that the planner cannot drive.
    """
    from crowdbench.runs.each_scenario import make_each
    from crowdbench.runs.folder import is_complete, make_in_folder, make_in_folder_with
    from crowdbench.runs.loading import open_run
    from crowdbench.utils.errors import MachineFault

    runs: dict[Place, Run] = {}

    def make(place: Place) -> None:
        done = 0.0

        def count(cases: float) -> None:
            nonlocal done
            done += cases
            report(cases)

        with open_run(specs[place]) as run:
            runs[place] = run
            if executor is None:
                try:
                    if not is_complete(run, out):
                        make_in_folder(run, out, count)
                finally:
                    report(len(run.spec.cases) - done)  # also after an error: nothing more is driven here

    failures = make_each(specs, make)
    if executor is not None:
        made = make_in_folder_with(executor, list(runs.values()), out, report)
        errors = {
            (each.parts.run.spec.scenario, each.parts.run.spec.overrides["sensor.track"]): each.error
            for each in made
            if each.error is not None
        }
        if len(errors) == len(specs):
            raise next(iter(errors.values()))
        failures |= {place: str(error) for place, error in errors.items()}
    for place, run in runs.items():
        if place not in failures and not is_complete(run, out):
            raise MachineFault(f"another process is making the run of {place[0]}: try again when it has ended")
    return runs, failures


def _read_score(run: Run, out: Path) -> Estimate:
    from crowdbench.results.episodes import read_estimate
    from crowdbench.results.result_file import read_result
    from crowdbench.runs.folder import run_directory

    return read_estimate(read_result(run_directory(run, out))["metrics"][SCORE])


def _table(title: str, scenarios: Suite, scores: Mapping[Place, Estimate]) -> Grid:
    """Return a row for each ranked scenario, for their mean, and for each other scenario, with a column for each track.

    Args:
        title: The title.
        scenarios: The suite.
        scores: The scores by scenario and track; none where the planner cannot drive, which counts 0.
    """
    from crowdbench.core.types.rules import SENSING_TRACKS
    from crowdbench.metrics.registry import info_of
    from crowdbench.metrics.scenario_means import FAILED, mean_over_scenarios, scenario_weights
    from crowdbench.metrics.summary import LEAST_CASES
    from crowdbench.results.table import NO_INTERVAL
    from crowdbench.utils.tables import Grid

    info, weights = info_of(SCORE), scenario_weights({"ranked": scenarios.ranked})

    def estimates(name: str) -> dict[str, Estimate]:
        return {track: scores.get((name, track), FAILED) for track in SENSING_TRACKS}

    ranked = {name: estimates(name) for name in scenarios.ranked}
    means = {track: mean_over_scenarios(weights, [row[track] for row in ranked.values()]) for track in SENSING_TRACKS}
    others = {f"{name} (stress)": estimates(name) for name in scenarios.stress}
    others |= {f"{name} (held out)": estimates(name) for name in scenarios.held_out}
    # The interval of a mean is shown only if each scenario that was driven has one.
    least = min((score.n for score in scores.values()), default=0)
    shown = {track: mean.for_display(least) for track, mean in means.items()}
    rows = []
    for name, row in (ranked | {MEAN: shown} | others).items():
        perfect, realistic = row.values()
        loss = info.number(perfect.mean - realistic.mean)
        rows.append([name, info.estimate(perfect), info.estimate(realistic), loss])
    records = [{"scenario": name, **row} for name, row in (ranked | {MEAN: means} | others).items()]
    note = "" if least >= LEAST_CASES else NO_INTERVAL
    return Grid(title, ["scenario", *SENSING_TRACKS, "loss"], rows, records, note=note)
