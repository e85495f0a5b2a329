"""The command `python -m benchmarks`."""

from __future__ import annotations

import os
import sys

import typer

from crowdbench import InputError
from crowdbench.cli import (
    ThreadsOption,
    announce_compilation,
    assignments,
    help_from_docstring,
    print_table,
    progress,
    use_threads,
)
from crowdbench.utils import Grid

SCENARIO = "circle_crossing_5"
"""The default scenario in which a planner's decisions are timed."""

CASES = "val:21"
"""The cases in which a planner's decisions are timed; the first one is only a warm-up."""


@help_from_docstring
def bench(
    planner: str | None = None,
    scenario: str = SCENARIO,
    option: list[str] | None = None,
    overrides: list[str] | None = None,
    threads: ThreadsOption = None,
) -> None:
    """Measure the speed of the simulator, of decisions, trainings and whole runs on this machine.

    --scenario, --option, --set and --threads need --planner.

    Args:
        planner: Measure only the time of this planner for a decision in a single world, in 20 cases. A name or a file
            of your own: ./mine.py.
    """
    if planner is None and (scenario != SCENARIO or option or overrides or threads):
        raise InputError("--scenario, --option, --set and --threads need --planner: say which planner to measure")
    use_threads(threads)  # before torch and numba are imported
    announce_compilation()
    if planner is not None:
        _bench_planner(planner, scenario, option or [], overrides or [])
    else:
        _bench_all()


def _bench_planner(planner: str, scenario: str, option: list[str], overrides: list[str]) -> None:
    import numpy as np

    from benchmarks.decisions import single_world_seconds
    from crowdbench import Cases, load_planner, load_scenario
    from crowdbench.plugins import plugin_name
    from crowdbench.results import planner_label

    options, cases = assignments(option, "--option"), Cases.parse(CASES)
    name, loaded = plugin_name(planner), load_planner(planner, options)
    world = load_scenario(scenario, assignments(overrides, "--set"))
    with progress(len(cases) - 1) as tell:
        seconds = single_world_seconds(loaded, world, cases, tell)
    median, late = 1e3 * np.percentile(seconds, [50, 99])
    print(
        f"{planner_label(name, options)} on {world.name}: {len(seconds)} decisions in one world alone take "
        f"{median:.3g} ms (median), {late:.3g} ms (99th percentile); a step takes {1e3 * world.rules.dt:g} ms"
    )


def _bench_all() -> None:
    from benchmarks import commands, decisions, simulator

    modules = simulator, decisions, commands
    suite = [work for module in modules for name, work in vars(module).items() if name.startswith("measure_")]
    rows: list[tuple[str, str, str, str]] = []
    with progress(len(suite), f"of {len(suite)} measurements") as tell:
        for measure in suite:
            rows += (measured.row() for measured in measure())
            tell(1)
    print_table(Grid("Speed", ("work", "crowdbench", "CrowdNav, recorded", "ratio"), rows, align="lrrr"))
    print("\nSARL's decisions are made with random weights, which cost as much as trained ones.")
    print("CrowdNav's times were recorded earlier, on another machine: they are not measured in this run.")


app = typer.Typer(add_completion=False, rich_markup_mode="markdown")
app.command()(bench)

if __name__ == "__main__":
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # as the command line does
    try:
        app()
    except InputError as error:
        sys.exit(f"benchmarks: {error}")
