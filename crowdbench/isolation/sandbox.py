"""Commands that start a planner's process: in a sandbox of bubblewrap if it is available, or else as a plain process.

The sandbox contains only Python, crowdbench, the system's libraries and the planner's files, all read-only: no board,
no season, no entry. It has no network, no other process and no capabilities. Its temporary folders are limited, and
some system calls fail in it: see `crowdbench.isolation.launch`.
"""

from __future__ import annotations

import functools
import os
import platform
import shutil
import subprocess
import sys
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from crowdbench.isolation.launch import MACHINES
from crowdbench.isolation.limits import TASKS, launcher
from crowdbench.plugins.kind import ROOT
from crowdbench.utils.compiled import cache_folder

CLIENT = (sys.executable, "-P", "-m", "crowdbench.isolation.client")
"""Command that makes a Python planner in its process. With `-P`, a file in the current folder replaces no module."""

BUBBLEWRAP = "bubblewrap"
PROCESS = "process"

TEMPORARY = ("/tmp", "/dev/shm")
"""The folders of the sandbox that can be written, each of `LARGEST_TEMPORARY` bytes at most; they count as memory."""

LARGEST_TEMPORARY = 10**9

_FILTER = 9
"""The descriptor of the filter of system calls, which `launch` makes."""

_ALONE = ("bwrap", "--die-with-parent", "--unshare-all", "--cap-drop", "ALL", "--seccomp", str(_FILTER))
_USER = ("--unshare-user", "--disable-userns", "--uid", "65534", "--gid", "65534", "--proc", "/proc", "--dev", "/dev")

_LIBRARIES = ("bin", "sbin", "lib", "lib32", "lib64", "libx32", "libexec")
_SYSTEM = [f"{place}/{name}" for place in ("/usr", "/usr/local", "") for name in _LIBRARIES]
"""Not all of /usr, because it may contain a checkout."""

_SETTINGS = ("/etc/ld.so.cache", "/etc/alternatives", "/etc/localtime", "/sys/devices/system/cpu")
_PACKAGE = Path(__file__).parent.parent

_ENVIRONMENT = ("PATH", "HOME", "LANG", "LC_ALL", "PYTHONPATH", "XDG_CACHE_HOME", "LD_LIBRARY_PATH")
_ENVIRONMENT_OF = ("OMP_", "OPENBLAS_", "MKL_", "NUMBA_")
"""Environment variables that a planner receives: names, and beginnings of names. Others may contain secrets."""


def command(
    program: Path | None, readable: Iterable[Path] = (), folder: Path | None = None, hidden: Iterable[Path] = ()
) -> tuple[str, ...]:
    """Return the command that starts a planner's process.

    Args:
        program: A planner that is an executable program; None for one that crowdbench can load.
        readable: Files and folders that the planner may read in addition to Python and crowdbench. Without bubblewrap
            it can read more.
        folder: The working directory; the present one if None.
        hidden: Folders that it may not read, except for `readable`, even if they are in folders of Python.
    """
    plain = CLIENT if program is None else (str(program.resolve()),)
    if level() == PROCESS:
        return plain
    executable = [] if program is None else [program.resolve()]
    bubblewrap = _bubblewrap([*readable, *executable], folder or Path.cwd(), hidden)
    return (*bubblewrap, *launcher({"rlimits": {"CORE": 0, "NOFILE": 1024, "NPROC": TASKS}}, plain))


def settings() -> dict[str, Any]:
    """Return the settings of `launch` for the command that `command` returns."""
    return {} if level() == PROCESS else {"filter": _FILTER}


def temporary() -> tuple[str, ...]:
    """Return the folders in memory that only a planner's process can access; none without bubblewrap."""
    return () if level() == PROCESS else TEMPORARY


@functools.cache
def level() -> str:
    """Return the level of isolation of planners on this machine: see docs/isolation.md."""
    if shutil.which("bwrap") is None or platform.machine() not in MACHINES:
        return PROCESS
    # bubblewrap may be installed, but not permitted to create namespaces.
    trial = launcher({"filter": _FILTER}, [*_bubblewrap((), Path("/"), ()), sys.executable, "-I", "-S", "-c", ""])
    done = subprocess.run(trial, stdin=subprocess.DEVNULL, capture_output=True)
    return PROCESS if done.returncode else BUBBLEWRAP


def _bubblewrap(readable: Iterable[Path], folder: Path, hidden: Iterable[Path]) -> tuple[str, ...]:
    options = [*_ALONE, *_USER]
    for system in map(Path, _SYSTEM):
        if system.is_symlink():
            options += ["--symlink", os.readlink(system), str(system)]
        elif system.is_dir():
            options += ["--ro-bind", str(system), str(system)]
    for temporary in TEMPORARY:
        options += ["--size", str(LARGEST_TEMPORARY), "--tmpfs", temporary]
    places = list(_python())
    covers = _covers([*places, *map(Path, _SYSTEM)], hidden)
    options += _binds(places)
    for cover in covers:
        options += ["--tmpfs", str(cover)]
    options += _binds(readable)
    for setting in _SETTINGS:
        options += ["--ro-bind-try", setting, setting]
    options += ["--dir", str(folder.absolute()), "--chdir", str(folder.absolute())]
    for place in ("/", "/dev", *map(str, covers)):
        options += ["--remount-ro", place]
    options += ["--clearenv"]
    for name, value in {**_environment(), "TMPDIR": TEMPORARY[0]}.items():
        options += ["--setenv", name, value]
    return (*options, "--")


def _covers(places: Iterable[Path], hidden: Iterable[Path]) -> list[Path]:
    """Return the paths of hidden folders inside the visible places."""
    folders = {folder.resolve() for folder in (ROOT / "leaderboards", ROOT / ".git", *hidden) if folder.is_dir()}
    return [
        place / folder.relative_to(place.resolve())
        for folder in folders
        for place in places
        if folder.is_relative_to(place.resolve())
    ]


def _binds(paths: Iterable[Path]) -> list[str]:
    options = []
    for path in paths:
        options += ["--ro-bind", str(path.resolve()), str(path.absolute())]
    return options


def _python() -> Iterator[Path]:
    """Yield the folders of Python, of its packages and of crowdbench."""
    prefixes = dict.fromkeys((Path(sys.base_prefix), Path(sys.prefix)))
    python = [prefix / name for prefix in prefixes for name in (*_LIBRARIES, "pyvenv.cfg")]
    packages = [Path(path) for path in sys.path if Path(path).name in ("site-packages", "dist-packages")]
    yield from filter(Path.exists, dict.fromkeys([*python, *packages, *crowdbench_places()]))


def crowdbench_places() -> list[Path]:
    """Return the package, the planners and scenarios that ship, and the compiled functions."""
    return [_PACKAGE, ROOT / "agents", ROOT / "scenarios", cache_folder()]


def _environment() -> Mapping[str, str]:
    return {
        name: value for name, value in os.environ.items() if name in _ENVIRONMENT or name.startswith(_ENVIRONMENT_OF)
    }
