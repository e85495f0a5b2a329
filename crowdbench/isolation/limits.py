"""Resources of a process and of all that it has started: limited by a control group where there is one, and measured.

A group of cgroup v2 is made in a group that is delegated to this user: that of this process, or one above it. In it the
kernel counts processor time, of children too that nobody has waited for, and with the controllers `memory` and `pids`
all memory and all processes. Without these, memory is the sum of the proportional set sizes (PSS) and of temporary
folders with `BYTES_OF_FILE` for each file, and of files in memory without a name.
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
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import psutil

TASKS = 512
"""Processes and threads of a planner, at most."""

FILES = 50_000
"""Files in its temporary folders, at most."""

BYTES_OF_FILE = 1024
"""Memory that the kernel takes for a file, even for an empty one."""

TICK, SHORTEST = 0.1, 0.01
"""Seconds between two looks at a process, at most and, close to a limit, at least."""

_BYTES_A_SECOND, _FILES_A_SECOND = 1e10, 4e5
"""More than a process can take."""


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
    home = _home()
    if home is None:
        return "memory by PSS, processes by count, and time by that of processes and the children they have waited for"
    return f"memory and processes by {'cgroup v2' if _limits(home) else 'PSS and by count'}, and time by cgroup v2"


@functools.cache
def _home() -> Path | None:
    """Return the folder of a group of cgroup v2 in which groups can be made, one with controllers if there is any."""
    with contextlib.suppress(OSError, StopIteration, IndexError):
        mounts = Path("/proc/self/mountinfo").read_text().splitlines()
        place = Path(next(line.split()[4] for line in mounts if " - cgroup2 " in line))
        own = place / Path("/proc/self/cgroup").read_text().split("0::/")[1].split("\n")[0]
        homes = [home for home in (own, *own.parents) if home.is_relative_to(place) and _is_home(home)]
        return next(filter(_limits, homes), homes[0])
    return None


def _limits(home: Path) -> bool:
    """Return whether groups in a group can limit memory and processes."""
    return {"memory", "pids"} <= set((home / "cgroup.subtree_control").read_text().split())


def _is_home(home: Path) -> bool:
    """Return whether this process can make a group in a group, and put processes into it."""
    with contextlib.suppress(OSError):
        trial = _make_group(home)
        done = subprocess.run(launcher({"group": str(trial)}, ["true"]), capture_output=True)
        trial.rmdir()
        return done.returncode == 0
    return False


def _make_group(home: Path) -> Path:
    group = home / f"crowdbench-{uuid.uuid4().hex}"
    group.mkdir()
    return group


class Usage:
    """Resources of a process and of all that it has started, with their limits.

    Attributes:
        pid: The number of the process, once it is started.
        processors: The number of processors that it may use.
        memory: The largest memory in bytes that it was seen to have.

    Args:
        most_memory: Bytes that it may take.
        cores: The processors that it may use; empty where it cannot be kept on some.
        temporary: Folders in memory that it alone sees: what lies in them counts as its memory.
    """

    def __init__(self, most_memory: float, cores: Sequence[int], temporary: Sequence[str]) -> None:
        self.most_memory, self.cores, self.temporary = most_memory, list(cores), temporary
        self.processors = len(self.cores) or os.cpu_count() or 1
        self.memory = self.pid = 0
        self._group: Path | None = None
        self._soon = self._next = 0.0

    def command(self, settings: Mapping[str, Any], command: Sequence[str]) -> tuple[str, ...]:
        """Return the command that starts another one with settings of `launch`, under the limits."""
        settings = {**settings, "cores": self.cores}
        if home := _home():
            self._group = _make_group(home)
            settings["group"] = str(self._group)
            for name, value in {"memory.max": int(self.most_memory), "memory.swap.max": 0, "pids.max": TASKS}.items():
                if (self._group / name).exists():  # the group has the controller
                    (self._group / name).write_text(str(value))
        return launcher(settings, command)

    def processes(self) -> list[int]:
        """Return the numbers of the process and of those that it has started and that still run."""
        if grouped := self._read("cgroup.procs"):
            return [pid for pid in map(int, grouped.split()) if pid]
        found = [self.pid]
        for pid in found:
            with contextlib.suppress(psutil.Error):
                found += _children(pid)
        return found

    def seconds(self) -> float:
        """Return the processor time that all of them have taken so far, with those that have ended."""
        if counted := re.match(r"usage_usec (\d+)", self._read("cpu.stat")):
            return int(counted[1]) / 1e6
        return self._sum(_processor_seconds)

    def check(self) -> None:
        """Look at what they take, if it is time. Raises Exceeded where it is too much."""
        if (now := time.monotonic()) < self._soon:
            return
        self._soon, tasks = now + SHORTEST, self._read("cgroup.threads").count("\n")
        if tasks <= TASKS and now < self._next:
            return
        tasks = tasks or int(self._sum(psutil.Process.num_threads))
        if tasks > TASKS or re.search("max [1-9]", self._read("pids.events")):
            raise Exceeded(f"started more than {TASKS} processes and threads")
        room, files = next(filter(any, (_room(pid, self.temporary) for pid in self.processes())), (0, 0))
        if files > FILES:
            raise Exceeded(f"made more than {FILES} files")
        nameless = dict(item for pid in self.processes() for item in _nameless(pid))
        measured = self._sum(_memory) + room + BYTES_OF_FILE * files + sum(nameless.values())
        memory = int(self._read("memory.current") or measured)
        self.memory = max(self.memory, memory)
        if memory > self.most_memory or re.search("oom_kill [1-9]", self._read("memory.events")):
            taken = max(memory, self.most_memory) / 1e9
            raise Exceeded(f"took {taken:.1f} GB of memory, more than {self.most_memory / 1e9:g} GB,")
        left = min((self.most_memory - memory) / _BYTES_A_SECOND, (FILES - files) / _FILES_A_SECOND)
        self._next = time.monotonic() + min(max(left, SHORTEST), TICK)

    def kill(self) -> None:
        """End all of them. They may have ended before."""
        with contextlib.suppress(OSError):  # at once, so that none can start another one meanwhile
            if self._group:
                (self._group / "cgroup.kill").write_text("1")
        # The group of processes has what it started and what has another parent now.
        for kill, pid in [*((os.kill, pid) for pid in self.processes()), (os.killpg, self.pid)]:
            with contextlib.suppress(OSError):
                kill(pid, signal.SIGKILL)

    def close(self) -> None:
        """Remove the control group after `kill`, once all have ended."""
        end = time.monotonic() + 1.0
        while self._group and self._group.exists() and time.monotonic() < end:
            with contextlib.suppress(OSError):
                self._group.rmdir()
            time.sleep(1e-3)

    def _sum(self, measure: Callable[[psutil.Process], float]) -> float:
        """Return a sum over all of them; 0 for those that have just ended."""
        total = 0.0
        for pid in self.processes():
            with contextlib.suppress(psutil.Error, OSError):
                total += measure(psutil.Process(pid))
        return total

    def _read(self, name: str) -> str:
        """Return a file of the control group; empty where there is none."""
        with contextlib.suppress(OSError):
            return (self._group / name).read_text() if self._group else ""
        return ""


def _children(pid: int) -> list[int]:
    with contextlib.suppress(OSError):
        lists = [path.read_text() for path in Path(f"/proc/{pid}/task").glob("*/children")]
        if lists:  # elsewhere it takes a hundred times as long to find them
            return [int(child) for children in lists for child in children.split()]
    return [child.pid for child in psutil.Process(pid).children()]


def _processor_seconds(process: psutil.Process) -> float:
    """Return the processor time of a process, and of its children that it has waited for."""
    own, system, *children = process.cpu_times()[:4]
    # Linux counts to the nanosecond, and shows only hundredths of a second elsewhere.
    return sum(children) + (time.clock_gettime(~process.pid << 3 | 2) if sys.platform == "linux" else own + system)


def _memory(process: psutil.Process) -> int:
    with contextlib.suppress(OSError):  # it may keep others from reading it
        found = re.search(r"^Pss: +(\d+)", Path(f"/proc/{process.pid}/smaps_rollup").read_text(), re.MULTILINE)
        return 1024 * int(found[1]) if found else 0
    return int(process.memory_info().rss)


def _nameless(pid: int) -> Iterator[tuple[tuple[int, int], int]]:
    """Yield the bytes of the files in memory without a name that a process has open, by what tells them apart."""
    with contextlib.suppress(OSError):
        for file in Path(f"/proc/{pid}/fd").iterdir():
            if os.readlink(file).startswith("/memfd:"):
                yield (file.stat().st_dev, file.stat().st_ino), 512 * file.stat().st_blocks


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
