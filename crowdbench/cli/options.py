"""What commands share: their options, and how they print."""

from __future__ import annotations

import os
import sys
from typing import Annotated, Any

import typer

from crowdbench.errors import InputError

INTERRUPTED = 130
"""The exit status after Ctrl-C."""

PlannerOption = Annotated[str, typer.Option(help="A name, ./mine.py or ./mine.py:factory.")]
OptionOption = Annotated[
    list[str] | None, typer.Option("--option", help="key=value for the planner or predictor; repeatable.")
]
ScenarioOption = Annotated[str, typer.Option(help="A name or ./mine.toml.")]
CasesOption = Annotated[str, typer.Option(help="500 (the first 500 test cases), 2000:2500, val:100, 37:38.")]
SetOption = Annotated[
    list[str] | None, typer.Option("--set", help="key=value in the scenario, such as vehicle.visible=true; repeatable.")
]
PedestriansOption = Annotated[str | None, typer.Option(help="The policy of all pedestrians: a name or ./mine.py.")]
MetricOption = Annotated[
    list[str] | None, typer.Option("--metric", help="A metric of your own: ./mine.py; repeatable.")
]
LimitOption = Annotated[
    float, typer.Option(help="Seconds that a planner may think each time it is asked, about a whole batch.")
]
ThreadsOption = Annotated[int | None, typer.Option(min=1, help="Threads to use. All cores unless told.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print the result as JSON instead of a table.")]


def use_threads(threads: int | None) -> None:
    """Let the simulator and networks use that many threads, or all. Raises InputError where there are fewer.

    To be called before numba and torch are imported, which read it then: they share a pool of threads, and each would
    undo what the other is told later.
    """
    if threads is not None:
        available = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        if threads > available:
            raise InputError(f"--threads {threads} is more than the {available} there are")
        os.environ |= {"NUMBA_NUM_THREADS": str(threads), "OMP_NUM_THREADS": str(threads)}


def print_table(table: Any) -> None:
    """Print a table, its title by itself, as wide as it needs where there is no terminal."""
    from rich.console import Console

    # By itself, since a table breaks its title at its own width.
    print(table.title)
    table.title = None
    # Without a terminal there is no width to fit; brackets are units, not markup.
    Console(width=None if sys.stdout.isatty() else 200, markup=False).print(table)
