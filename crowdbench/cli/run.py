"""The commands that drive a planner, and look at what a run left."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated

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
    print_table,
    use_threads,
)
from crowdbench.errors import InputError
from crowdbench.settings import BATCH, DECISION_LIMIT, FIRST_RECORDED, MOST_FAILURES, RECORD

RECORD_HELP = f"failures ({MOST_FAILURES} at most, and the first {FIRST_RECORDED} cases), all or none."


def run(
    planner: PlannerOption,
    scenario: ScenarioOption = "circle_crossing_5",
    cases: CasesOption = "500",
    option: OptionOption = None,
    overrides: SetOption = None,
    pedestrians: PedestriansOption = None,
    replan_every: Annotated[
        int, typer.Option(min=1, help="Steps that the planner decides at once, without looking in between.")
    ] = 1,
    metric: MetricOption = None,
    out: Annotated[Path | None, typer.Option(help="runs/<planner>-<scenario>-<n> unless told.")] = None,
    record: Annotated[str, typer.Option(help=RECORD_HELP)] = RECORD[0],
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an earlier run.")] = False,
    batch: Annotated[int, typer.Option(min=1, help="Cases that run in lock-step.")] = BATCH,
    threads: ThreadsOption = None,
    decision_limit: LimitOption = DECISION_LIMIT,
    as_json: JsonOption = False,
) -> None:
    """Drive a planner through the cases of a scenario and score it."""
    use_threads(threads)
    from crowdbench import catalog, plugins
    from crowdbench.cli.console import announce_compilation, progress, say
    from crowdbench.evaluate import run as runs
    from crowdbench.evaluate.driver import Driver
    from crowdbench.evaluate.results import planner_label, replanning
    from crowdbench.scenario.cases import Cases

    if record not in RECORD:
        raise InputError(f"--record {record} is not one of {', '.join(RECORD)}")
    announce_compilation()
    wanted = Cases.parse(cases)
    options = catalog.assignments(option or [], "--option")
    name, made = catalog.load_planner(planner, options)
    settings = catalog.assignments(overrides or [], "--set")
    place = catalog.load_scenario(scenario, settings, pedestrians)
    changes = settings | ({"pedestrians": pedestrians} if pedestrians else {})
    metrics = catalog.load_metrics(metric or [])
    directory = out or Path("runs") / runs.directory_name(
        name, place.name, wanted, options | changes | replanning(replan_every)
    )
    with progress(len(wanted), "cases") as tell:
        finished = runs.run(
            Driver(made, name, decision_limit),
            place,
            wanted,
            directory,
            metrics=metrics,
            about={"options": options, "planner_file": plugins.source(planner), "overrides": changes},
            replan_every=replan_every,
            record=record,
            batch=batch,
            overwrite=overwrite,
            progress=tell,
        )
    result = finished.result
    if as_json:
        print(json.dumps(result, indent=2))
    else:
        from crowdbench.cli.tables import result_table

        changed = "".join(f", {key}={value}" for key, value in changes.items())
        title = f"{planner_label(name, options, replan_every)} on {place.name}{changed}, cases {result['cases']}"
        print_table(result_table(title, result["metrics"], metrics))
        print(f"\nKept in {directory}; {result['recorded']} episodes are recorded (crowdbench view shows them)")
    if finished.interrupted:
        say(f"crowdbench: interrupted: kept cases {result['cases']}, all that were finished in order, in {directory}")
        sys.exit(INTERRUPTED)


def compare(
    a: Annotated[Path, typer.Argument(help="The directory of a run.")],
    b: Annotated[Path, typer.Argument(help="Another, of the same scenario and cases.")],
) -> None:
    """Compare two runs case by case."""
    from crowdbench.cli.tables import changed_cases, comparison_table
    from crowdbench.evaluate.compare import compare as pair

    found = pair(a, b)
    print_table(comparison_table(found))
    print("\nRates (p: McNemar's exact test) and what counts failures are over all shared cases, the rest over those")
    print("that both solve. Intervals are of the paired difference.")
    print(changed_cases(found) or "No case ends differently.")


def view(
    run: Annotated[Path, typer.Argument(help="The directory of a run, or an .rrd file.")],
    case: Annotated[int | None, typer.Option(help="Show this case alone.")] = None,
    screenshot: Annotated[Path | None, typer.Option(help="Write a picture of the last state, open no window.")] = None,
) -> None:
    """Open a recording in the Rerun viewer."""
    from crowdbench.record import view as viewer

    viewer.view(_recording(run), case, screenshot)


def score(
    recording: Annotated[Path, typer.Argument(help="An .rrd file, or the directory of a run.")],
    metric: MetricOption = None,
    as_json: JsonOption = False,
) -> None:
    """Compute the metrics again from a recording alone."""
    from crowdbench import catalog
    from crowdbench.cli.tables import episodes_table, result_table
    from crowdbench.evaluate.score import score as measure

    metrics = catalog.load_metrics(metric or [])
    scored = measure(_recording(recording), metrics)
    if as_json:
        print(json.dumps(scored.to_json(), indent=2))
    elif scored.complete:
        title = f"{scored.planner} on {scored.scenario}, from {recording}"
        print_table(result_table(title, scored.to_json()["metrics"], metrics))
    else:
        print_table(episodes_table(scored.cases, scored.episodes))


def _recording(path: Path) -> Path:
    from crowdbench.evaluate.results import RECORDING

    return path / RECORDING if path.is_dir() else path
