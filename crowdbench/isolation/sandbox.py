"""How a planner's process is started: in a sandbox of bubblewrap where it is there, or else as a plain process."""

from __future__ import annotations

import functools
import shutil
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

CLIENT = (sys.executable, "-P", "-m", "crowdbench.isolation.client")
"""What makes a planner of Python in its own process; `-P`, so that a file in the current folder replaces no module."""

BUBBLEWRAP = "bubblewrap"
PROCESS = "process"


def command(
    program: Path | None, hidden: Iterable[Path] = (), shown: Iterable[Path] = (), folder: Path | None = None
) -> tuple[str, ...]:
    """The command that starts a planner's process.

    Args:
        program: A planner that is a program of its own, or None for one that crowdbench can load.
        hidden: Folders that the planner must not read. Without bubblewrap it can.
        shown: Folders inside those that it may read all the same.
        folder: The working directory; the present one if None.
    """
    started = CLIENT if program is None else (str(program.resolve()),)
    return started if level() == PROCESS else (*_bubblewrap(hidden, shown, folder), *started)


@functools.cache
def level() -> str:
    """How well planners can be kept apart on this machine, `bubblewrap` or `process`: see `docs/isolation.md`."""
    if shutil.which("bwrap") is None:
        return PROCESS
    # It may be there and not be allowed to make namespaces.
    tried = subprocess.run([*_bubblewrap(), sys.executable, "-c", ""], stdin=subprocess.DEVNULL, capture_output=True)
    return BUBBLEWRAP if tried.returncode == 0 else PROCESS


def _bubblewrap(hidden: Iterable[Path] = (), shown: Iterable[Path] = (), folder: Path | None = None) -> tuple[str, ...]:
    """No network, no other process to be seen, every file read-only but for temporary ones that nobody else sees."""
    options: list[str] = []
    current = folder or Path.cwd()
    for place in map(Path.resolve, hidden):
        if place.is_dir():
            options += ["--tmpfs", str(place)]
            current = Path("/") if current.is_relative_to(place) else current
    for place in map(Path.resolve, shown):
        options += ["--ro-bind", str(place), str(place)]
    always = "--die-with-parent --unshare-all --ro-bind / / --dev /dev --proc /proc --tmpfs /var/tmp"
    last = "--setenv", "TMPDIR", "/var/tmp", "--chdir", str(current), "--"
    return ("bwrap", *always.split(), *options, *last)
