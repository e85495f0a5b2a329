"""The command that makes the folder of a new planner."""

from __future__ import annotations

from pathlib import Path

from crowdbench.cli.console import say
from crowdbench.utils.commands import command
from crowdbench.utils.errors import InputError


def new_planner(name: str, out: Path = Path()) -> None:
    """Make the folder of a planner of your own: a planner that works, its test, and its card for leaderboards.

    Args:
        name: A name of lower-case letters, digits and underscores.
        out: Folder in which the planner's folder is created.
    """
    from crowdbench.catalog import PLANNERS
    from crowdbench.plugins.new_planner import make_planner

    if name in PLANNERS.built_in():
        raise InputError(f"a planner that ships is called {name!r}: take another name")
    folder = make_planner(name, out)
    file = folder / f"{name}.py"
    say(
        f"made {folder}: {name}.py drives, test_{name}.py tests it (with pytest), card.toml says what it is\n"
        f"  {command('check', file)}\n"
        f"  {command('run', '--planner', file)}\n"
        f"  {command('suite', file, '--cases', 10)}"
    )
