"""The command that drives a planner through the scenarios of the suite, and prints one table."""

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
    from crowdbench.metrics.summary import Estimate
    from crowdbench.runs.run import Run
    from crowdbench.runs.spec import RunSpec
    from crowdbench.utils.executors import Executor
    from crowdbench.utils.tables import Grid

METRICS = ("success_rate", "sct")
"""The metrics of the table."""


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
    """Drive a planner through the scenarios of the suite, and print its success and SCT in each, and their means.

    The same command makes only the runs that are missing.

    Args:
        planner: Name of a planner, or a file of your own: ./mine.py, ./mine.py:factory or policy.onnx.
        cases: Number of test cases of each scenario.
        isolated: Run the planner in a separate process, which receives only observations.
        out: Folder that keeps the runs.
    """
    use_threads(threads)
    from crowdbench.catalog import suite_families
    from crowdbench.plugins.kind import plugin_name
    from crowdbench.runs.spec import RunSpec
    from crowdbench.scenario.cases import Cases
    from crowdbench.utils.executors import open_executor
    from crowdbench.utils.tables import plain

    families = suite_families()
    options = assignments(option or [], "--option")
    specs = {
        scenario: RunSpec(planner, scenario, Cases("test", 0, cases), options=options, record="none", isolated=isolated)
        for scenarios in families.values()
        for scenario in scenarios
    }
    announce_compilation()
    message = f"finished batches are kept in {out}, with which the same command goes on"
    with (
        exit_on_interrupt(message),
        open_executor(engine, workers, threads) as executor,
        progress(cases * len(specs), "of the suite") as report,
    ):
        runs, failures = _make_runs(specs, out, executor, report)
    estimates = {name: _read_estimates(run, out) for name, run in runs.items() if name not in failures}
    for name, reason in failures.items():
        say(f"{name} counts 0, because it cannot be driven: {reason}")
    table = _table(f"{plugin_name(planner)} on the suite, {cases} cases of each scenario", families, estimates)
    if as_json:
        records = {str(record["scenario"]): {name: record[name] for name in METRICS} for record in table.records}
        print(json.dumps(plain({"cases": cases, "metrics": records}), indent=2))
        return
    print_table(table)
    write(f"\nAll families of scenarios count the same in the mean. Kept in {out}")


def _make_runs(
    specs: Mapping[str, RunSpec], out: Path, executor: Executor | None, report: Callable[[float], None]
) -> tuple[dict[str, Run], dict[str, str]]:
    """Make the runs that the folder lacks.

    Args:
        specs: The run of each scenario, by its name.
        out: The folder.
        executor: Workers that make them, if any.
        report: Called with the progress, in cases.

    Returns:
        The runs, and the error of each scenario that the planner cannot drive, by the names of the scenarios.
    """
    from crowdbench.runs.each_scenario import make_each
    from crowdbench.runs.folder import is_complete, make_in_folder, make_in_folder_with
    from crowdbench.runs.loading import open_run
    from crowdbench.utils.errors import MachineFault

    runs: dict[str, Run] = {}

    def make(name: str) -> None:
        done = 0.0

        def count(cases: float) -> None:
            nonlocal done
            done += cases
            report(cases)

        with open_run(specs[name]) as run:
            runs[name] = run
            if executor is None:
                try:
                    if not is_complete(run, out):
                        make_in_folder(run, out, count)
                finally:
                    report(len(run.spec.cases) - done)  # also after an error: nothing more is driven here

    failures = make_each(specs, make)
    if executor is not None:
        made = make_in_folder_with(executor, list(runs.values()), out, report)
        errors = {each.parts.run.spec.scenario: each.error for each in made if each.error is not None}
        if len(errors) == len(specs):
            raise next(iter(errors.values()))
        failures |= {name: str(error) for name, error in errors.items()}
    for name, run in runs.items():
        if name not in failures and not is_complete(run, out):
            raise MachineFault(f"another process is making the run of {name}: try again when it has ended")
    return runs, failures


def _read_estimates(run: Run, out: Path) -> Mapping[str, Estimate]:
    from crowdbench.results.episodes import read_estimate
    from crowdbench.results.result_file import read_result
    from crowdbench.runs.folder import run_directory

    measured = read_result(run_directory(run, out))["metrics"]
    return {name: read_estimate(measured[name]) for name in METRICS}


def _table(title: str, families: Mapping[str, list[str]], estimates: Mapping[str, Mapping[str, Estimate]]) -> Grid:
    """Return a row for each scenario, and one for the mean, in which all families count the same.

    Args:
        title: The title.
        families: The names of the scenarios by family.
        estimates: The estimates by scenario and metric; none of a scenario that the planner cannot drive.
    """
    from crowdbench.metrics.registry import info_of
    from crowdbench.metrics.scenario_means import FAILED, mean_over_scenarios, scenario_weights
    from crowdbench.metrics.summary import LEAST_CASES
    from crowdbench.results.table import NO_INTERVAL, estimate_grid

    weights = scenario_weights(families)
    rows = {name: estimates.get(name, dict.fromkeys(METRICS, FAILED)) for names in families.values() for name in names}
    means = {metric: mean_over_scenarios(weights, [row[metric] for row in rows.values()]) for metric in METRICS}
    records = [{"scenario": name, **row} for name, row in (rows | {"mean": means}).items()]
    # The interval of the mean is shown only if each scenario that was driven has one.
    least = min((row["success_rate"].n for row in rows.values() if row["success_rate"].n), default=0)
    shown = {metric: mean.for_display(least) for metric, mean in means.items()}
    infos = {metric: info_of(metric) for metric in METRICS}
    grid = estimate_grid(title, [*records[:-1], {"scenario": "mean", **shown}], infos)
    return replace(grid, records=records, note="" if least >= LEAST_CASES else NO_INTERVAL)
