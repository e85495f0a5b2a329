"""The command line: reads options, calls what does the work, prints. Imports what a command needs when it runs."""

from __future__ import annotations

import importlib.metadata
import json
import signal
import sys
from pathlib import Path
from types import FrameType
from typing import Annotated, Any

import typer
from typer.exceptions import TyperException

from crowdbench.errors import InputError
from crowdbench.settings import BATCH, DECISION_LIMIT, FIRST_RECORDED, MOST_FAILURES, RECORD

DEBUG = "--debug"
INTERRUPTED = 130

app = typer.Typer(
    add_completion=False,
    epilog=f"{DEBUG}, anywhere, shows the traceback of an error.",
)

PlannerOption = Annotated[str, typer.Option(help="A name, ./mine.py or ./mine.py:factory.")]
OptionOption = Annotated[list[str] | None, typer.Option("--option", help="key=value for the planner; repeatable.")]
ScenarioOption = Annotated[str, typer.Option(help="A name or ./mine.toml.")]
CasesOption = Annotated[str, typer.Option(help="500 (the first 500 test cases), 2000:2500, val:100, 37:38.")]
SetOption = Annotated[
    list[str] | None, typer.Option("--set", help="key=value in the scenario, such as vehicle.visible=true; repeatable.")
]
PedestriansOption = Annotated[str | None, typer.Option(help="The policy of all pedestrians: a name or ./mine.py.")]
MetricOption = Annotated[
    list[str] | None, typer.Option("--metric", help="A metric of your own: ./mine.py; repeatable.")
]
LimitOption = Annotated[float, typer.Option(help="Seconds that a planner may think about one step of a batch.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print the result as JSON instead of a table.")]

RECORD_HELP = f"failures ({MOST_FAILURES} at most, and the first {FIRST_RECORDED} cases), all or none."


def _version(wanted: bool | None) -> None:
    if wanted:
        print(importlib.metadata.version("crowdbench"))
        raise typer.Exit


@app.callback()
def crowdbench(
    version: Annotated[
        bool | None, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and stop.")
    ] = None,
) -> None:
    """The benchmark for navigation in crowds."""


@app.command()
def run(
    planner: PlannerOption,
    scenario: ScenarioOption = "circle_crossing_5",
    cases: CasesOption = "500",
    option: OptionOption = None,
    overrides: SetOption = None,
    pedestrians: PedestriansOption = None,
    metric: MetricOption = None,
    out: Annotated[Path | None, typer.Option(help="[default: runs/<planner>-<scenario>-<n>]")] = None,
    record: Annotated[str, typer.Option(help=RECORD_HELP)] = RECORD[0],
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an earlier run.")] = False,
    batch: Annotated[int, typer.Option(min=1, help="Cases that run in lock-step.")] = BATCH,
    threads: Annotated[int | None, typer.Option(min=1, help="Threads of the simulator. [default: all cores]")] = None,
    decision_limit: LimitOption = DECISION_LIMIT,
    as_json: JsonOption = False,
) -> None:
    """Drive a planner through the cases of a scenario and score it."""
    from crowdbench import catalog, plugins
    from crowdbench import run as runs
    from crowdbench.cases import Cases
    from crowdbench.console import announce_compilation, progress, say
    from crowdbench.driver import Driver

    if record not in RECORD:
        raise InputError(f"--record {record} is not one of {', '.join(RECORD)}")
    announce_compilation()
    _use_threads(threads)
    wanted = Cases.parse(cases)
    options = catalog.assignments(option or [], "--option")
    name, made = catalog.load_planner(planner, options)
    settings = catalog.assignments(overrides or [], "--set")
    place = catalog.load_scenario(scenario, settings, pedestrians)
    changes = settings | ({"pedestrians": pedestrians} if pedestrians else {})
    metrics = catalog.load_metrics(metric or [])
    directory = out or Path("runs") / runs.directory_name(name, place.name, wanted, options | changes)
    with progress(len(wanted), "cases") as tell:
        finished = runs.run(
            Driver(made, name, decision_limit),
            place,
            wanted,
            directory,
            metrics=metrics,
            about={"options": options, "planner_file": plugins.source(planner), "overrides": changes},
            record=record,
            batch=batch,
            overwrite=overwrite,
            progress=tell,
        )
    result = finished.result
    if as_json:
        print(json.dumps(result, indent=2))
    else:
        from crowdbench.results import planner_label
        from crowdbench.tables import result_table

        changed = "".join(f", {key}={value}" for key, value in changes.items())
        title = f"{planner_label(name, options)} on {place.name}{changed}, cases {result['cases']}"
        _print(result_table(title, result["metrics"], metrics))
        print(f"\nKept in {directory}; {result['recorded']} episodes are recorded (crowdbench view shows them)")
    if finished.interrupted:
        say(f"crowdbench: interrupted: kept cases {result['cases']}, all that were finished in order, in {directory}")
        sys.exit(INTERRUPTED)


@app.command("list")
def list_(
    kind: Annotated[str, typer.Argument(help="planners, pedestrians, scenarios or metrics.")],
) -> None:
    """List planners, pedestrians, scenarios or metrics."""
    from crowdbench import catalog
    from crowdbench.tables import listing_table

    listings = {
        "planners": catalog.PLANNERS.names,
        "pedestrians": catalog.PEDESTRIANS.names,
        "scenarios": catalog.scenarios,
    }
    if kind == "metrics":
        from crowdbench.metrics import METRICS

        rows = [(name, (metric.__doc__ or "").partition("\n")[0]) for name, metric in METRICS.items()]
    elif kind in listings:
        rows = listings[kind]()
    else:
        raise InputError(f"nothing is listed as {kind!r}: ask for {', '.join(listings)} or metrics")
    _print(listing_table(kind, rows))


@app.command()
def check(
    planner: Annotated[str, typer.Argument(help="A name, ./mine.py or ./mine.py:factory.")],
    option: OptionOption = None,
    scenario: ScenarioOption = "circle_crossing_5",
    cases: CasesOption = "val:20",
    decision_limit: LimitOption = DECISION_LIMIT,
) -> None:
    """Say point by point whether a planner keeps the contract."""
    from crowdbench import catalog
    from crowdbench.cases import Cases
    from crowdbench.check import check as examine
    from crowdbench.console import announce_compilation
    from crowdbench.tables import check_table

    announce_compilation()
    options = catalog.assignments(option or [], "--option")
    name, _ = catalog.load_planner(planner, options)
    points = examine(
        lambda: catalog.load_planner(planner, options)[1],
        name,
        catalog.load_scenario(scenario),
        Cases.parse(cases),
        decision_limit,
    )
    _print(check_table(name, points))
    if not all(point.kept for point in points):
        raise typer.Exit(1)


@app.command()
def compare(
    a: Annotated[Path, typer.Argument(help="The directory of a run.")],
    b: Annotated[Path, typer.Argument(help="Another, of the same scenario and cases.")],
) -> None:
    """Compare two runs case by case."""
    from crowdbench.compare import compare as pair
    from crowdbench.tables import changed_cases, comparison_table

    found = pair(a, b)
    _print(comparison_table(found))
    print("\nRates (p: McNemar's exact test) and what counts failures are over all shared cases, the rest over those")
    print("that both solve. Intervals are of the paired difference.")
    print(changed_cases(found) or "No case ends differently.")


@app.command()
def view(
    run: Annotated[Path, typer.Argument(help="The directory of a run, or an .rrd file.")],
    case: Annotated[int | None, typer.Option(help="Show this case alone.")] = None,
    screenshot: Annotated[Path | None, typer.Option(help="Write a picture of the last state, open no window.")] = None,
) -> None:
    """Open a recording in the Rerun viewer."""
    from crowdbench import record

    record.view(_recording(run), case, screenshot)


@app.command()
def score(
    recording: Annotated[Path, typer.Argument(help="An .rrd file, or the directory of a run.")],
    metric: MetricOption = None,
    as_json: JsonOption = False,
) -> None:
    """Compute the metrics again from a recording alone."""
    from crowdbench import catalog
    from crowdbench.score import score as measure
    from crowdbench.tables import episodes_table, result_table

    metrics = catalog.load_metrics(metric or [])
    scored = measure(_recording(recording), metrics)
    if as_json:
        print(json.dumps(scored.to_json(), indent=2))
    elif scored.complete:
        title = f"{scored.planner} on {scored.scenario}, from {recording}"
        _print(result_table(title, scored.to_json()["metrics"], metrics))
    else:
        _print(episodes_table(scored.cases, scored.episodes))


@app.command()
def bench() -> None:
    """Measure the speed here, beside navground's where that is installed."""
    from crowdbench.bench.measure import rows
    from crowdbench.console import progress
    from crowdbench.tables import bench_table

    with progress(9, "measurements") as tell:
        measured = []
        for row in rows():
            measured.append(row)
            tell(1)
    _print(bench_table(measured))
    if all(row.theirs is None for row in measured):
        print("\nnavground is not installed, so its column is skipped: pip install 'crowdbench[bench]'")


def main() -> None:
    """The entry point: every error of the user's is one sentence and a non-zero exit."""
    debug = DEBUG in sys.argv
    arguments = [argument for argument in sys.argv[1:] if argument != DEBUG] or ["--help"]
    signal.signal(signal.SIGTERM, _interrupt)
    try:
        status = app(arguments, standalone_mode=False)
        if status == INTERRUPTED:
            print("crowdbench: interrupted: nothing was kept", file=sys.stderr)
        sys.exit(status)
    except (InputError, TyperException) as error:
        if debug:
            raise
        message = error.format_message() if isinstance(error, TyperException) else str(error)
        print(f"crowdbench: {message}", file=sys.stderr)
        sys.exit(2 if isinstance(error, TyperException) else 1)
    except OSError as error:
        if debug:
            raise
        print(f"crowdbench: the output cannot be written: {error.strerror or error}", file=sys.stderr)
        sys.exit(1)


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt


def _recording(path: Path) -> Path:
    from crowdbench.results import RECORDING

    return path / RECORDING if path.is_dir() else path


def _use_threads(threads: int | None) -> None:
    import numba

    if threads is not None:
        if threads > numba.config.NUMBA_NUM_THREADS:
            raise InputError(f"--threads {threads} is more than the {numba.config.NUMBA_NUM_THREADS} there are")
        numba.set_num_threads(threads)


def _print(table: Any) -> None:
    from rich.console import Console

    # By itself, since a table breaks its title at its own width.
    print(table.title)
    table.title = None
    # Without a terminal there is no width to fit; brackets are units, not markup.
    Console(width=None if sys.stdout.isatty() else 200, markup=False).print(table)
