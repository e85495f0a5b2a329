"""The command line: reads options, calls the modules that do the work, prints.

Commands import what they need when they run, so that the command line starts fast.
"""

from __future__ import annotations

import importlib.metadata
import os
import sys
from collections.abc import Callable
from typing import Annotated

import typer

from crowdbench import interrupts
from crowdbench.cli import (
    bench,
    boards,
    certify,
    check,
    evaluate_predictor,
    figures,
    listing,
    results,
    run,
    streams,
    study,
    train,
    validity,
)
from crowdbench.cli.console import say
from crowdbench.cli.failures import DEBUG, NOTHING_KEPT, failure
from crowdbench.cli.options import INTERRUPTED

COMMANDS: dict[str, Callable[..., None]] = {
    "run": run.run,
    "merge": run.merge,
    "train": train.train,
    "list": listing.list_,
    "check": check.check,
    "certify": certify.certify,
    "compare": results.compare,
    "study": study.study,
    "reproduce": study.reproduce,
    "view": results.view,
    "table": figures.table,
    "plot": figures.plot,
    "render": figures.render,
    "score": results.score,
    "evaluate-predictor": evaluate_predictor.evaluate_predictor,
    "validity": validity.validity,
    "bench": bench.bench,
    "new-planner": boards.new_planner,
    "submit": boards.submit,
    "verify": boards.verify,
}
"""The commands in the order of --help."""

app = typer.Typer(
    add_completion=False,
    rich_markup_mode="markdown",  # joins the lines of a docstring's paragraph
    epilog=f"Add {DEBUG} to any command to see the traceback of an error.",
)
for name, command in COMMANDS.items():
    app.command(name)(command)
app.add_typer(boards.app, name="leaderboard")


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
    """A benchmark for navigation in crowds."""


def main() -> None:
    """The entry point. It prints one sentence for an error, and exits with a status other than 0."""
    # Read when the threads of the simulator and of torch start. They would wait for each other busily, which takes many
    # times as long where another program wants the cores: ORCA 4 times, an update of a training 30 times.
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    debug = DEBUG in sys.argv
    arguments = [argument for argument in sys.argv[1:] if argument != DEBUG] or ["--help"]
    streams.prepare()
    interrupts.handle()
    try:
        status = app(arguments, standalone_mode=False)
        streams.flush()
    except BaseException as error:
        failed = failure(error)
        if failed is None or (debug and not isinstance(error, SystemExit)):
            raise
        say(f"crowdbench: {failed.sentence}")
        sys.exit(failed.status)
    if status == INTERRUPTED:
        say(f"crowdbench: {NOTHING_KEPT}")
    sys.exit(status)
