"""Commands that start a planner's process: in a sandbox of bubblewrap if it is available, or else as a plain process.

The sandbox contains only Python, crowdbench, the system's libraries and the planner's files, all read-only: no board,
no season, no entry. It has no network, no other process and no capabilities, and is never root of the machine. Its
temporary folders are limited, and it has a list of system calls: see `crowdbench.isolation.launch`.
"""

from __future__ import annotations

import functools
import os
import platform
import shutil
import subprocess
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from crowdbench.isolation.launch import MACHINES
from crowdbench.isolation.limits import TASKS, launcher
from crowdbench.plugins.kind import ROOT
from crowdbench.utils.compiled import cache_folder
from crowdbench.utils.errors import MachineFault

CLIENT = (sys.executable, "-P", "-m", "crowdbench.isolation.client")
"""Command that makes a Python planner in its process. With `-P`, a file in the current folder replaces no module."""

BUBBLEWRAP = "bubblewrap"
PROCESS = "process"

TEMPORARY = ("/tmp", "/dev/shm")
"""The folders of the sandbox that can be written, each of `LARGEST_TEMPORARY` bytes at most; they count as memory."""

LARGEST_TEMPORARY = 10**9

_FILTER = 9
"""The descriptor of the filter of system calls, which `launch` makes."""

_NOBODY = 65534
"""The user in the sandbox. If root starts the sandbox, it is this user of the machine, so that it is never root."""

_ALONE = ("bwrap", "--die-with-parent", "--seccomp", str(_FILTER), "--cap-drop", "ALL")
_NAMESPACES = ("--unshare-ipc", "--unshare-pid", "--unshare-net", "--unshare-uts", "--unshare-cgroup-try")
_AS_USER = ("--unshare-user", "--disable-userns", "--uid", str(_NOBODY), "--gid", str(_NOBODY))
_AS_ROOT = ("--cap-add", "CAP_SETUID", "--cap-add", "CAP_SETGID", "--cap-add", "CAP_SETPCAP")
"""Capabilities with which `launch` becomes nobody. In a namespace of users, a planner would be root for the machine."""

_PROC = ("cpuinfo", "filesystems", "meminfo", "mounts", "net", "self", "stat", "thread-self", "uptime", "version")
"""The files of /proc that the sandbox shows in addition to its own processes."""

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

    Raises:
        MachineFault: Root starts it, and nobody else may read one of the files.
    """
    plain = CLIENT if program is None else (str(program.resolve()),)
    if level() == PROCESS:
        return plain
    files = [*readable, *([] if program is None else [program.resolve()])]
    if _is_root():
        inside = [path for folder in files for path in (folder, *folder.rglob("*"))]
        _check_that_nobody_may_read([*_python(), *inside])
    return (*_bubblewrap(files, folder or Path.cwd(), hidden), *_inside(plain))


def _check_that_nobody_may_read(paths: Iterable[Path]) -> None:
    for path in filter(Path.exists, paths):
        needed = 0o5 if path.is_dir() else 0o4
        if path.stat().st_mode & needed != needed:
            raise MachineFault(
                f"{path} cannot be read by planners, since root runs them as the user nobody: allow it by "
                f"`chmod -R o+rX {path}`, or run crowdbench as another user"
            )


def _inside(command: Sequence[str]) -> tuple[str, ...]:
    """Return the command that bubblewrap starts in the sandbox."""
    if _is_root():  # nobody may have other processes on this machine
        return launcher({"rlimits": {"NOFILE": 1024, "NPROC": 8 * TASKS}, "user": _NOBODY}, command)
    return launcher({"rlimits": {"NOFILE": 1024, "NPROC": TASKS}}, command)


def settings() -> dict[str, Any]:
    """Return the settings of `launch` for the command that `command` returns."""
    return {} if level() == PROCESS else _settings()


def _settings() -> dict[str, Any]:
    no_core_not_even_to_a_program = {"CORE": 1}
    settings = {"filter": _FILTER, "rlimits": no_core_not_even_to_a_program}
    return {**settings, "owner": _NOBODY} if _is_root() else settings


def _is_root() -> bool:
    return os.geteuid() == 0


def temporary() -> tuple[str, ...]:
    """Return the folders in memory that only a planner's process can access; none without bubblewrap."""
    return () if level() == PROCESS else TEMPORARY


@functools.cache
def level() -> str:
    """Return the level of isolation of planners on this machine: see docs/isolation.md."""
    if shutil.which("bwrap") is None or platform.machine() not in MACHINES:
        return PROCESS
    # bubblewrap may be installed, but not permitted to create namespaces.
    inside = _inside([sys.executable, "-I", "-S", "-c", ""])
    trial = launcher(_settings(), [*_bubblewrap((), Path("/"), ()), *inside])
    done = subprocess.run(trial, stdin=subprocess.DEVNULL, capture_output=True)
    return PROCESS if done.returncode else BUBBLEWRAP


def _bubblewrap(readable: Iterable[Path], folder: Path, hidden: Iterable[Path]) -> tuple[str, ...]:
    options = [*_ALONE, *_NAMESPACES, *(_AS_ROOT if _is_root() else _AS_USER)]
    options += ["--proc", "/proc", *_covers_of_proc(), "--dev", "/dev", "--ro-bind", "/dev/null", "/dev/zero"]
    for system in map(Path, _SYSTEM):
        if system.is_symlink():
            options += ["--symlink", os.readlink(system), str(system)]
        elif system.is_dir():
            options += _binds([system])
    for temporary in TEMPORARY:
        options += ["--perms", "1777", "--size", str(LARGEST_TEMPORARY), "--tmpfs", temporary]
    places = list(_python())
    covers = _covers([*places, *map(Path, _SYSTEM)], hidden)
    options += _binds(places)
    for cover in covers:
        options += ["--tmpfs", str(cover)]
    options += _binds(readable)
    options += _binds(filter(Path.exists, map(Path, _SETTINGS)))
    options += ["--dir", str(folder.absolute()), "--chdir", str(folder.absolute())]
    for place in ("/", "/dev", *map(str, covers)):
        options += ["--remount-ro", place]
    options += ["--clearenv"]
    for name, value in {**_environment(), "TMPDIR": TEMPORARY[0]}.items():
        options += ["--setenv", name, value]
    return (*options, "--")


def _covers_of_proc() -> list[str]:
    """Return options that cover the settings of the kernel, and what it tells of the machine and of other processes."""
    options = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit() or entry.name in _PROC:
            continue
        if entry.is_dir():
            options += ["--tmpfs", str(entry), "--remount-ro", str(entry)]
        else:
            options += ["--ro-bind", "/dev/null", str(entry)]
    return [*options, "--tmpfs", "/proc/1", "--remount-ro", "/proc/1"]


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
        for folder in reversed(path.absolute().parents):
            options += ["--dir", str(folder)]  # which nobody may enter, unlike one that root's bubblewrap makes itself
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
