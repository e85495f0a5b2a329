"""What a process takes with all that it has started: limited by a control group where there is one, and measured.

A group of cgroup v2 is made by systemd, or in the group of this process where that is writable. In it the kernel counts
processor time, of children too that nobody has waited for, and with the controllers `memory` and `pids` all memory and
all processes. Without these, memory is the sum of the proportional set sizes (PSS), of files in memory without a name,
and of temporary folders with `BYTES_OF_FILE` for each file.
"""

from __future__ import annotations

import contextlib
import functools
import json
import os
import re
import signal
import subprocess
import sys
import time
import uuid
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import psutil

TASKS = 512
"""Processes and threads of a planner, at most."""

FILES = 50_000
"""Files in its temporary folders, at most."""

BYTES_OF_FILE = 1024
"""What the kernel takes for a file, even for an empty one."""

TICK, SHORTEST = 0.1, 0.01
"""Seconds between two looks at a process, at most and, close to a limit, at least."""

_BYTES_A_SECOND, _FILES_A_SECOND = 1e10, 4e5
"""More than a process can take."""

_TRIAL = """
import pathlib
place = "/sys/fs/cgroup" + pathlib.Path("/proc/self/cgroup").read_text().split("0::")[1].strip()
[pathlib.Path(place, name).read_text() for name in ("memory.max", "pids.max", "cpu.stat")]
"""


class Exceeded(Exception):
    """A process takes more than it may. The message is what comes after its name."""


def usable_cores() -> list[int]:
    """Return the processors that this process may use; none where the system does not say."""
    return sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []


def launcher(settings: Mapping[str, Any], command: Sequence[str]) -> tuple[str, ...]:
    """Return the command that starts a command with the settings of `launch`."""
    script = str(Path(__file__).with_name("launch.py"))
    return (sys.executable, "-I", "-S", script, json.dumps(settings), *command)


@functools.cache
def describe() -> str:
    """Return how memory, processes and processor time of planners are limited on this machine, for a sentence."""
    if _systemd(1e9, 1):
        return "memory, processes and processor time by cgroup v2"
    home = _home()
    found = [] if home is None else (home / "cgroup.subtree_control").read_text().split()
    memory, tasks = ("cgroup v2" if name in found else other for name, other in (("memory", "PSS"), ("pids", "count")))
    processor = "cgroup v2" if home else "processes and the children that they have waited for"
    return f"memory by {memory}, processes by {tasks}, and processor time by {processor}"


@functools.cache
def _home() -> Path | None:
    """Return the folder of this process's control group of version 2 if groups can be made in it."""
    try:
        mounts = Path("/proc/self/mountinfo").read_text().splitlines()
        home = _group_of("self", next(line.split()[4] for line in mounts if " - cgroup2 " in line))
        with contextlib.suppress(OSError):  # where other processes are in the group, controllers stay as they are
            (home / "cgroup.subtree_control").write_text("+memory +pids")
        trial = _make_group(home)
        done = subprocess.run(launcher({"group": str(trial)}, [sys.executable, "-c", ""]), capture_output=True)
        trial.rmdir()
    except (OSError, StopIteration, IndexError):
        return None
    return home if done.returncode == 0 else None


@functools.cache
def _systemd(memory: float, cores: int) -> tuple[str, ...]:
    """Return the command by which systemd starts another one in a group with these limits; empty if it cannot."""
    limits = {"MemoryMax": int(memory), "MemorySwapMax": 0, "TasksMax": TASKS, "CPUQuota": f"{100 * cores}%"}
    options = [word for name, value in limits.items() for word in ("-p", f"{name}={value}")]
    who = () if os.geteuid() == 0 else ("--user",)
    command = ("systemd-run", *who, "--scope", "--quiet", "--collect", *options, "--")
    with contextlib.suppress(OSError):
        trial = subprocess.run([*command, sys.executable, "-c", _TRIAL], capture_output=True, stdin=subprocess.DEVNULL)
        if trial.returncode == 0:
            return command
    return ()


def _group_of(process: str, place: str = "/sys/fs/cgroup") -> Path:
    return Path(place + Path(f"/proc/{process}/cgroup").read_text().split("0::")[1].split()[0])


def _make_group(home: Path) -> Path:
    group = home / f"crowdbench-{uuid.uuid4().hex}"
    group.mkdir()
    return group


class Usage:
    """What a process takes with all that it has started, and its limits.

    Attributes:
        memory: The largest memory in bytes that it was seen to have.

    Args:
        most_memory: Bytes that it may take.
        cores: The processors that it may use; empty where it cannot be kept on some.
        temporary: Folders in memory that it alone sees: what lies in them counts as its memory.
    """

    def __init__(self, most_memory: float, cores: Sequence[int], temporary: Sequence[str]) -> None:
        self.most_memory, self.cores, self.temporary = most_memory, list(cores), temporary
        self.memory = 0
        self._systemd = _systemd(most_memory, self.processors)
        self._group: Path | None = None
        self._pid, self._next = 0, 0.0

    @property
    def processors(self) -> int:
        """Return the number of processors that it may use."""
        return len(self.cores) or os.cpu_count() or 1

    def command(self, settings: Mapping[str, Any], command: Sequence[str]) -> tuple[str, ...]:
        """Return the command that starts another one with settings of `launch`, under the limits."""
        settings = {**settings, "cores": self.cores}
        home = None if self._systemd else _home()
        if home is not None:
            self._group = _make_group(home)
            settings["group"] = str(self._group)
            for name, value in {"memory.max": int(self.most_memory), "memory.swap.max": 0, "pids.max": TASKS}.items():
                if (self._group / name).exists():  # the group has the controller
                    (self._group / name).write_text(str(value))
        return (*self._systemd, *launcher(settings, command))

    def begin(self, pid: int) -> None:
        """Take over the process that the command has started."""
        self._pid = pid

    def processes(self) -> list[int]:
        """Return the numbers of the process and of those that it has started and that still run."""
        if grouped := self._read("cgroup.procs"):
            return [pid for pid in map(int, grouped.split()) if pid]
        found = [self._pid]
        for pid in found:
            with contextlib.suppress(psutil.Error):
                found += _children(pid)
        return found

    def seconds(self) -> float:
        """Return the processor time that all of them have taken so far, with those that have ended."""
        if counted := re.match(r"usage_usec (\d+)", self._read("cpu.stat")):
            return int(counted[1]) / 1e6
        return sum(map(_processor_seconds, self.processes()))

    def check(self) -> None:
        """Look at what they take, if it is time. Raises Exceeded where it is too much."""
        tasks = self._read("cgroup.threads").count("\n")
        if tasks <= TASKS and time.monotonic() < self._next:
            return
        processes = self.processes()
        if (tasks or sum(map(_tasks, processes))) > TASKS or re.search("max [1-9]", self._read("pids.events")):
            raise Exceeded(f"started more than {TASKS} processes and threads")
        room, files = next(filter(any, (_room(pid, self.temporary) for pid in processes)), (0, 0))
        if files > FILES:
            raise Exceeded(f"made more than {FILES} files")
        nameless = dict(item for pid in processes for item in _nameless(pid))
        measured = sum(map(_memory, processes)) + room + BYTES_OF_FILE * files + sum(nameless.values())
        memory = int(self._read("memory.current") or measured)
        self.memory = max(self.memory, memory)
        if memory > self.most_memory or re.search("oom_kill [1-9]", self._read("memory.events")):
            taken = max(memory, self.most_memory) / 1e9
            raise Exceeded(f"took {taken:.1f} GB of memory, more than {self.most_memory / 1e9:g} GB,")
        left = min((self.most_memory - memory) / _BYTES_A_SECOND, (FILES - files) / _FILES_A_SECOND)
        self._next = time.monotonic() + min(max(left, SHORTEST), TICK)

    def kill(self) -> None:
        """End all of them. They may have ended before."""
        with contextlib.suppress(OSError, TypeError):  # at once, so that none can start another one meanwhile
            Path(self._group, "cgroup.kill").write_text("1")  # type: ignore[arg-type]
        for pid in self.processes():
            with contextlib.suppress(OSError):
                os.kill(pid, signal.SIGKILL)
        with contextlib.suppress(OSError):  # what it started and what has another parent now
            os.killpg(self._pid, signal.SIGKILL)

    def close(self) -> None:
        """Remove the control group after `kill`, once all have ended."""
        for _ in range(100 if self._group else 0):
            with contextlib.suppress(OSError):
                self._group.rmdir()  # type: ignore[union-attr]
                return
            time.sleep(SHORTEST)

    def _read(self, name: str) -> str:
        """Return a file of the control group; empty where there is none."""
        with contextlib.suppress(OSError, IndexError):
            if self._group is None and self._systemd and (its := _group_of(str(self._pid))) != _group_of("self"):
                self._group = its
            return (self._group / name).read_text() if self._group else ""
        return ""


def _children(pid: int) -> list[int]:
    lists = list(Path(f"/proc/{pid}/task").glob("*/children"))
    if not lists:  # the kernel has none, or there is no /proc
        return [child.pid for child in psutil.Process(pid).children()]
    children: list[int] = []
    for path in lists:
        with contextlib.suppress(OSError):
            children += map(int, path.read_text().split())
    return children


def _processor_seconds(pid: int) -> float:
    """Return the processor time of a process, and of its children that it has waited for."""
    with contextlib.suppress(psutil.Error, OSError):
        own, system, *children = psutil.Process(pid).cpu_times()[:4]
        # Linux counts to the nanosecond, and shows only hundredths of a second elsewhere.
        return sum(children) + (time.clock_gettime(~pid << 3 | 2) if sys.platform == "linux" else own + system)
    return 0.0


def _tasks(pid: int) -> int:
    with contextlib.suppress(psutil.Error):
        return int(psutil.Process(pid).num_threads())
    return 0


def _memory(pid: int) -> int:
    with contextlib.suppress(OSError, TypeError):
        rollup = Path(f"/proc/{pid}/smaps_rollup").read_text()
        return 1024 * int(re.search(r"^Pss: +(\d+)", rollup, re.MULTILINE)[1])  # type: ignore[index]
    with contextlib.suppress(psutil.Error):
        return int(psutil.Process(pid).memory_info().rss)
    return 0


def _nameless(pid: int) -> Iterator[tuple[tuple[int, int], int]]:
    """Yield the bytes of the files in memory without a name that a process has open, by what tells them apart."""
    with contextlib.suppress(OSError):
        for file in Path(f"/proc/{pid}/fd").iterdir():
            with contextlib.suppress(OSError):
                if os.readlink(file).startswith("/memfd:"):
                    status = file.stat()
                    yield (status.st_dev, status.st_ino), 512 * status.st_blocks


def _room(pid: int, folders: Sequence[str]) -> tuple[int, int]:
    """Return the bytes and the number of files in folders as a process in a sandbox sees them."""
    size = count = 0
    for folder in folders:
        with contextlib.suppress(OSError):
            # Opened once: while the sandbox is being made the path leads to the machine's own folder.
            inside = os.open(f"/proc/{pid}/root{folder}", os.O_RDONLY | os.O_DIRECTORY)
            try:
                if os.fstat(inside).st_dev != os.stat(folder).st_dev:
                    space = os.fstatvfs(inside)
                    size += (space.f_blocks - space.f_bfree) * space.f_frsize
                    count += space.f_files - space.f_ffree - 1
            finally:
                os.close(inside)
    return size, count
