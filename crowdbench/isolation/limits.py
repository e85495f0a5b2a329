"""Measures the resources of a process and its descendants, and limits them by a control group if possible.

A group of cgroup v2 is made in a group that is delegated to this user: the group of this process, or one above it. The
kernel counts the processor time of the group, including children that no process has waited for. With the controllers
`memory` and `pids`, it also counts memory and processes. Without them, memory is the sum of proportional set sizes
(PSS), page tables, temporary folders with `BYTES_OF_FILE` for each file, files in memory without a name, and what pipes
and sockets can hold.
"""

from __future__ import annotations

import contextlib
import functools
import json
import os
import re
import signal
import stat
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

BYTES_OF_PIPE = 2**16
"""Memory that a pipe can hold."""

TICK, SHORTEST = 0.1, 0.01
"""Longest and shortest time in seconds between two checks of a process; the shortest applies close to a limit."""

_BYTES_A_SECOND, _FILES_A_SECOND = 1e10, 4e5
"""Upper bounds on the rates at which a process can take memory and make files."""


class Exceeded(Exception):
    """Raised if a process exceeds a limit. The message continues a sentence that begins with the planner's name."""


def usable_cores() -> list[int]:
    """Return the processors that this process may use; an empty list if the system does not report them."""
    return sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []


def launcher(settings: Mapping[str, Any], command: Sequence[str]) -> tuple[str, ...]:
    """Return the command that starts a command with the settings of `launch`."""
    script = str(Path(__file__).with_name("launch.py"))
    return (sys.executable, "-I", "-S", script, json.dumps(settings), *command)


@functools.cache
def describe_limits() -> str:
    """Return a phrase on how memory, processes and processor time of planners are limited on this machine."""
    home = _home()
    if home is None:
        return "memory by PSS, processes by count, and time by that of processes and the children they have waited for"
    memory = "cgroup v2" if _limits(home) else "PSS and by count"
    return f"memory and processes by {memory}, and time by cgroup v2"


@functools.cache
def _home() -> Path | None:
    """Return the folder of a group of cgroup v2 in which groups can be made, preferably one with controllers."""
    with contextlib.suppress(OSError, StopIteration, IndexError):
        mounts = Path("/proc/self/mountinfo").read_text().splitlines()
        place = Path(next(line.split()[4] for line in mounts if " - cgroup2 " in line))
        own = place / Path("/proc/self/cgroup").read_text().split("0::/")[1].split("\n")[0]
        homes = [home for home in (own, *own.parents) if home.is_relative_to(place) and _is_home(home)]
        return next(filter(_limits, homes), homes[0])
    return None


def _limits(home: Path) -> bool:
    """Return whether the subgroups of a group can limit memory and processes."""
    return {"memory", "pids"} <= set((home / "cgroup.subtree_control").read_text().split())


def _is_home(home: Path) -> bool:
    """Return whether this process can make a subgroup of a group, and put processes into it."""
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
    """Resources of a process and its descendants, with their limits.

    Attributes:
        pid: The id of the process; 0 before it is started.
        processors: The number of processors that it may use.
        memory: The largest memory in bytes that was measured.

    Args:
        most_memory: The limit of memory in bytes.
        cores: The processors that it may use; None for the processors of this process.
        temporary: Folders in memory that only this process can access: their contents count as its memory.
    """

    def __init__(self, most_memory: float, cores: Sequence[int] | None, temporary: Sequence[str]) -> None:
        self.most_memory = most_memory
        self.cores = usable_cores() if cores is None else list(cores)
        self.temporary = temporary
        self.processors = len(self.cores) or os.cpu_count() or 1
        self.memory = 0
        self.pid = 0
        self._group: Path | None = None
        self._next_task_check = 0.0
        self._next_full_check = 0.0

    def command(self, settings: Mapping[str, Any], command: Sequence[str]) -> tuple[str, ...]:
        """Return the command that starts another one with settings of `launch`, under the limits."""
        settings = {**settings, "cores": self.cores}
        home = _home()
        if home is not None:
            self._group = _make_group(home)
            settings["group"] = str(self._group)
            for name, value in {"memory.max": int(self.most_memory), "memory.swap.max": 0, "pids.max": TASKS}.items():
                if (self._group / name).exists():  # the group has the controller
                    (self._group / name).write_text(str(value))
        return launcher(settings, command)

    def processes(self) -> list[int]:
        """Return the ids of the process and of its descendants that still run."""
        grouped = self._read("cgroup.procs")
        if grouped:
            return [pid for pid in map(int, grouped.split()) if pid != 0]  # 0 is a process in another namespace
        found = [self.pid]
        for pid in found:
            with contextlib.suppress(psutil.Error):
                found += _children(pid)
        return found

    def seconds(self) -> float:
        """Return the processor time in seconds of all processes so far, including ended ones."""
        counted = re.match(r"usage_usec (\d+)", self._read("cpu.stat"))
        if counted:
            return int(counted[1]) / 1e6
        return self._sum(_processor_seconds)

    def check(self) -> None:
        """Measure the resources if a check is due. Raises Exceeded if a limit is exceeded."""
        now = time.monotonic()
        if now < self._next_task_check:
            return
        self._next_task_check = now + SHORTEST
        tasks = self._read("cgroup.threads").count("\n")
        if tasks <= TASKS and now < self._next_full_check:
            return
        if tasks == 0:  # there is no control group
            tasks = int(self._sum(psutil.Process.num_threads))
        if tasks > TASKS or re.search("max [1-9]", self._read("pids.events")):
            raise Exceeded(f"started more than {TASKS} processes and threads")
        room, files = self._temporary_contents()
        if files > FILES:
            raise Exceeded(f"made more than {FILES} files")
        held = {file: size for pid in self.processes() for file, size in _held(pid)}
        measured = self._sum(_memory) + room + BYTES_OF_FILE * files + sum(held.values())
        memory = int(self._read("memory.current") or measured)
        self.memory = max(self.memory, memory)
        if memory > self.most_memory or re.search("oom_kill [1-9]", self._read("memory.events")):
            taken = max(memory, self.most_memory) / 1e9
            raise Exceeded(f"took {taken:.1f} GB of memory, more than {self.most_memory / 1e9:g} GB,")
        left = min((self.most_memory - memory) / _BYTES_A_SECOND, (FILES - files) / _FILES_A_SECOND)
        self._next_full_check = time.monotonic() + min(max(left, SHORTEST), TICK)

    def kill(self) -> None:
        """Kill all processes. They may have ended before."""
        with contextlib.suppress(OSError):  # all at once, so that no process can start another one meanwhile
            if self._group:
                (self._group / "cgroup.kill").write_text("1")
        for pid in self.processes():
            with contextlib.suppress(OSError):
                os.kill(pid, signal.SIGKILL)
        with contextlib.suppress(OSError):  # the process group also contains descendants that have another parent now
            os.killpg(self.pid, signal.SIGKILL)

    def close(self) -> None:
        """Remove the control group after `kill`, once all have ended."""
        end = time.monotonic() + 1.0
        while self._group and self._group.exists() and time.monotonic() < end:
            with contextlib.suppress(OSError):
                self._group.rmdir()
            time.sleep(1e-3)

    def _temporary_contents(self) -> tuple[int, int]:
        """Return bytes and number of files in the temporary folders, which all processes in the sandbox share."""
        for pid in self.processes():
            contents = _room(pid, self.temporary)
            if contents != (0, 0):
                return contents
        return 0, 0

    def _sum(self, measure: Callable[[psutil.Process], float]) -> float:
        """Return the sum of a measure over all processes; processes that have just ended count 0."""
        total = 0.0
        for pid in self.processes():
            with contextlib.suppress(psutil.Error, OSError):
                total += measure(psutil.Process(pid))
        return total

    def _read(self, name: str) -> str:
        """Return the text of a file of the control group; empty if there is none."""
        with contextlib.suppress(OSError):
            return (self._group / name).read_text() if self._group else ""
        return ""


def _children(pid: int) -> list[int]:
    with contextlib.suppress(OSError):
        lists = [path.read_text() for path in Path(f"/proc/{pid}/task").glob("*/children")]
        if lists:  # the general method takes a hundred times as long
            return [int(child) for children in lists for child in children.split()]
    return [child.pid for child in psutil.Process(pid).children()]


def _processor_seconds(process: psutil.Process) -> float:
    """Return the processor time of a process, and of its children that it has waited for."""
    own, system, *children = process.cpu_times()[:4]
    if sys.platform != "linux":
        return own + system + sum(children)
    # This clock of Linux counts nanoseconds; `cpu_times` counts only hundredths of a second.
    return time.clock_gettime(~process.pid << 3 | 2) + sum(children)


def _memory(process: psutil.Process) -> int:
    """Return the bytes of memory of a process, including its page tables."""
    text = ""
    for name in ("status", "smaps_rollup"):
        with contextlib.suppress(OSError):  # the process may prevent others from reading it
            text += Path(f"/proc/{process.pid}/{name}").read_text()
    found = re.findall(r"^(VmRSS|VmPTE|Pss|SwapPss):\s+(\d+)", text, re.MULTILINE)
    sizes = {name: 1024 * int(size) for name, size in found}
    if not sizes:
        return int(process.memory_info().rss)
    return sizes.get("Pss", sizes.get("VmRSS", 0)) + sizes.get("SwapPss", 0) + sizes.get("VmPTE", 0)


def _held(pid: int) -> Iterator[tuple[tuple[int, int], int]]:
    """Yield device, inode and bytes of each nameless file in memory, pipe and socket that a process has open."""
    files = []
    with contextlib.suppress(OSError):
        files = list(Path(f"/proc/{pid}/fd").iterdir())
    sizes = {stat.S_IFIFO: BYTES_OF_PIPE, stat.S_IFSOCK: _bytes_of_socket()}
    for file in files:
        with contextlib.suppress(OSError):  # it may have been closed
            about = file.stat()
            is_in_memory = os.readlink(file).startswith("/memfd:")
            size = 512 * about.st_blocks if is_in_memory else sizes.get(stat.S_IFMT(about.st_mode), 0)
            yield (about.st_dev, about.st_ino), size


@functools.cache
def _bytes_of_socket() -> int:
    """Return an upper bound on the memory that a socket can hold for its peer."""
    with contextlib.suppress(OSError):
        return 2 * int(Path("/proc/sys/net/core/wmem_default").read_text())
    return 0


def _room(pid: int, folders: Sequence[str]) -> tuple[int, int]:
    """Return the bytes and the number of files in folders inside the sandbox of a process."""
    size = count = 0
    for folder in folders:
        with contextlib.suppress(OSError):
            # Opened once: until the sandbox is complete, the path leads to the folder of the machine itself.
            inside = os.open(f"/proc/{pid}/root{folder}", os.O_RDONLY | os.O_DIRECTORY)
            try:
                if os.fstat(inside).st_dev != os.stat(folder).st_dev:
                    space = os.fstatvfs(inside)
                    size += (space.f_blocks - space.f_bfree) * space.f_frsize
                    count += space.f_files - space.f_ffree - 1
            finally:
                os.close(inside)
    return size, count
