"""How a planner's process is started: in a sandbox of bubblewrap where it is there, or else as a plain process.

The sandbox shows Python, crowdbench, the system's libraries and the planner's own files, all read-only, and nothing
else. It has no network, no other process and no capabilities, and its temporary folders are limited.
"""

from __future__ import annotations

import functools
import os
import shutil
import subprocess
import sys
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from crowdbench.plugins.load import ROOT
from crowdbench.utils.compiled import store

CLIENT = (sys.executable, "-P", "-m", "crowdbench.isolation.client")
"""Command that makes a planner of Python in its own process; `-P`, so that a file in the current folder replaces no
module."""

BUBBLEWRAP = "bubblewrap"
PROCESS = "process"

TEMPORARY = ("/tmp", "/dev/shm")
"""The folders of the sandbox that can be written, each of `LARGEST_TEMPORARY` bytes at most; they count as memory."""

LARGEST_TEMPORARY = 10**9

MISSING = {
    BUBBLEWRAP: "",
    "bubblewrap without a user namespace": "it was the user who runs the command, without capabilities",
    PROCESS: "in a process of the same user, which could read and write files and use the network",
}
"""Promises of a sandbox that each level breaks; none for the best."""

_ALONE = ("bwrap", "--die-with-parent", "--unshare-all", "--cap-drop", "ALL", "--proc", "/proc", "--dev", "/dev")
_USER = {
    BUBBLEWRAP: ("--unshare-user", "--disable-userns", "--uid", "65534", "--gid", "65534"),
    "bubblewrap without a user namespace": (),
}

_SYSTEM = ("/usr", "/bin", "/sbin", "/lib", "/lib32", "/lib64", "/libx32")
_SETTINGS = ("/etc/ld.so.cache", "/etc/alternatives", "/etc/localtime", "/sys/devices/system/cpu")
_PACKAGE = Path(__file__).parent.parent

_ENVIRONMENT = ("PATH", "HOME", "LANG", "LC_ALL", "PYTHONPATH", "XDG_CACHE_HOME", "LD_LIBRARY_PATH")
_ENVIRONMENT_OF = ("OMP_", "OPENBLAS_", "MKL_", "NUMBA_")
"""Variables of the environment that a planner gets: names, and how names begin. The rest may hold secrets."""


def command(program: Path | None, readable: Iterable[Path] = (), folder: Path | None = None) -> tuple[str, ...]:
    """The command that starts a planner's process.

    Args:
        program: A planner that is a program of its own, or None for one that crowdbench can load.
        readable: Files and folders that the planner may read beside Python and crowdbench. Without bubblewrap it can
            read more.
        folder: The working directory; the present one if None.
    """
    plain = CLIENT if program is None else (str(program.resolve()),)
    if level() == PROCESS:
        return plain
    executable = [] if program is None else [program.resolve()]
    return (*_bubblewrap(level(), [*readable, *executable], folder or Path.cwd()), *plain)


def temporary() -> tuple[str, ...]:
    """The folders in memory that only a planner's process sees; none without bubblewrap."""
    return () if level() == PROCESS else TEMPORARY


@functools.cache
def level() -> str:
    """How well planners can be kept apart on this machine, the first of `MISSING` that works: see docs/isolation.md."""
    if shutil.which("bwrap") is None:
        return PROCESS
    for name in _USER:  # it may be there and not be allowed to make namespaces
        trial = [*_bubblewrap(name, (), Path("/")), sys.executable, "-c", ""]
        if subprocess.run(trial, stdin=subprocess.DEVNULL, capture_output=True).returncode == 0:
            return name
    return PROCESS


def _bubblewrap(level: str, readable: Iterable[Path], folder: Path) -> tuple[str, ...]:
    options = [*_ALONE, *_USER[level]]
    for system in map(Path, _SYSTEM):
        if system.is_symlink():
            options += ["--symlink", os.readlink(system), str(system)]
        elif system.is_dir():
            options += ["--ro-bind", str(system), str(system)]
    for temporary in TEMPORARY:
        options += ["--size", str(LARGEST_TEMPORARY), "--tmpfs", temporary]
    for path in [*_python(), *readable]:
        options += ["--ro-bind", str(path.resolve()), str(path.absolute())]
    for setting in _SETTINGS:
        options += ["--ro-bind-try", setting, setting]
    options += ["--dir", str(folder.absolute()), "--chdir", str(folder.absolute())]
    options += ["--remount-ro", "/", "--remount-ro", "/dev", "--clearenv"]
    for name, value in {**_environment(), "TMPDIR": TEMPORARY[0]}.items():
        options += ["--setenv", name, value]
    return (*options, "--")


def _python() -> Iterator[Path]:
    """Where Python lies with its packages, and crowdbench."""
    packages = [Path(path) for path in sys.path if Path(path).name in ("site-packages", "dist-packages")]
    folders = [Path(sys.base_prefix), Path(sys.prefix), *packages, *crowdbench_places()]
    yield from filter(Path.exists, dict.fromkeys(folders))


def crowdbench_places() -> list[Path]:
    """The package, the planners and scenarios that ship, and the compiled functions."""
    return [_PACKAGE, ROOT / "agents", ROOT / "scenarios", *store.folders()]


def _environment() -> Mapping[str, str]:
    return {
        name: value for name, value in os.environ.items() if name in _ENVIRONMENT or name.startswith(_ENVIRONMENT_OF)
    }
