"""The command line: reads options, calls the modules that do the work, and prints results.

Only the module of the requested command is imported. It imports further modules when the command runs, so that the
command line starts fast.
"""

from __future__ import annotations

import contextlib
import functools
import importlib.metadata
import os
import sys
from collections.abc import Callable
from importlib.metadata import EntryPoint, entry_points
from typing import Annotated

import typer

from crowdbench.cli.console import BAD, DEBUG, INTERRUPTED, NOTHING_KEPT, failure, flush_output, prepare_streams, say
from crowdbench.cli.options import help_from_docstring
from crowdbench.utils import interrupts, watchdog
from crowdbench.utils.errors import InputError
from crowdbench.utils.terminal import width

COMMANDS = {
    "run": ("Run", "run:run"),
    "suite": ("Run", "suite:suite"),
    "cross": ("Run", "cross:cross"),
    "new-planner": ("Run", "new_planner:new_planner"),
    "check": ("Run", "check:check"),
    "train": ("Run", "train:train"),
    "merge": ("Run", "run:merge"),
    "list": ("Look", "listing:list_"),
    "view": ("Look", "cases:view"),
    "render": ("Look", "figures:render"),
    "plot": ("Look", "figures:plot"),
    "table": ("Look", "table:table"),
    "compare": ("Look", "results:compare"),
    "score": ("Look", "results:score"),
    "export": ("Look", "results:export"),
}
"""The commands in the order of --help, with their group in --help, and their function in a module of this folder."""

WIDE = 70
"""Smallest number of columns for the tables of --help."""

EXAMPLES = {
    "run": "--planner orca --cases val:40",
    "suite": "orca --cases 20",
    "cross": "orca mppi --cases 20",
    "new-planner": "mine",
    "check": "./mine.py",
    "train": "sarl",
    "merge": "runs/one runs/two --out runs/both",
    "view": "runs/one",
    "render": "runs/one --out case.png",
    "plot": "success runs/one runs/two",
    "table": "runs/one runs/two",
    "compare": "runs/one runs/two",
    "score": "runs/one",
    "export": "runs/one --out tracks",
}
"""Arguments of each command that needs some, for the error of a command without them."""

ENTRY_POINTS = "crowdbench.commands"
"""The group of entry points of commands that other distributions add."""

ELSEWHERE = dict.fromkeys(("submit", "verify"), "pip install ./leaderboards")
"""Commands of other distributions, and how to install them from a clone of the repository."""


def _print_version(is_wanted: bool | None) -> None:
    if is_wanted:
        print(importlib.metadata.version("crowdbench"))
        raise typer.Exit


def crowdbench(
    version: Annotated[bool | None, typer.Option("--version", callback=_print_version, is_eager=True)] = None,
) -> None:
    """Benchmark planners that navigate in crowds.

    Args:
        version: Print the version and stop.
    """


def build_app(name: str | None = None) -> typer.Typer:
    """Return the command line with one command, or with all commands.

    Args:
        name: The only command. If there is none of this name, the command line has all.

    Raises:
        InputError: The command is one of a distribution that is not installed.
    """
    app = _new_app(f"Add {DEBUG} to any command to see the traceback of an error.")
    app.callback()(help_from_docstring(crowdbench))
    points = [EntryPoint(own, f"crowdbench.cli.{function}", group) for own, (group, function) in COMMANDS.items()]
    if name not in COMMANDS:
        # The modules of other distributions must import little, as the modules of this folder do.
        points += entry_points(group=ENTRY_POINTS)
    chosen = [point for point in points if point.name == name]
    if name in ELSEWHERE and not chosen:
        raise InputError(f"the command {name} is not installed: in a clone of crowdbench, {ELSEWHERE[name]}")
    for point in chosen or points:
        group = "Boards" if point.group == ENTRY_POINTS else point.group
        app.command(point.name, rich_help_panel=group)(help_from_docstring(point.load()))
    return app


def build_script(command: Callable[..., None]) -> typer.Typer:
    """Return the command line of a script with one command."""
    app = _new_app()
    app.command()(help_from_docstring(command))
    return app


def _new_app(epilog: str | None = None) -> typer.Typer:
    # Markdown joins the lines of a docstring's paragraph. Its tables would break words on a narrow terminal.
    is_narrow = (width(sys.stdout) or WIDE) < WIDE
    return typer.Typer(add_completion=False, rich_markup_mode=None if is_narrow else "markdown", epilog=epilog)


@functools.cache
def __getattr__(name: str) -> object:
    """Return `app`, the command line with all commands, when it is first used."""
    if name == "app":
        return build_app()
    raise AttributeError(f"module 'crowdbench.cli' has no attribute {name!r}")


def main(script: Callable[..., None] | None = None) -> None:
    """Run the command line. For an error print one sentence, and exit with a status other than 0.

    Args:
        script: The command of a script that has only one; None for the commands of crowdbench.
    """
    # This is read when the threads of the simulator and of torch start. With active waiting they are much slower if
    # another program uses the cores: ORCA takes 4 times as long, an update of a training 30 times.
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    debug = DEBUG in sys.argv
    arguments = [argument for argument in sys.argv[1:] if argument != DEBUG]
    if script is None and not arguments:
        arguments = ["--help"]
    prepare_streams()
    interrupts.handle()
    watchdog.enable()
    try:
        app = build_script(script) if script else build_app(arguments[0])
        status = app(arguments, standalone_mode=False)
        flush_output()
    except BaseException as error:
        report = failure(error)
        if report is None or (debug and not isinstance(error, SystemExit)):
            raise
        sentence, status = report
        if type(error).__name__ == "MissingParameter" and arguments[0] in EXAMPLES:
            sentence += f" For example: crowdbench {arguments[0]} {EXAMPLES[arguments[0]]}"
        with contextlib.suppress(OSError):
            flush_output()
        say(f"crowdbench: {sentence}", BAD)
        sys.exit(status)
    if status == INTERRUPTED:
        say(f"crowdbench: {NOTHING_KEPT}")
    sys.exit(status)
