"""A process that is asked through pipes, under limits of time and memory that its parent measures and enforces."""

from __future__ import annotations

import contextlib
import os
import random
import select
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import psutil

from crowdbench.isolation.protocol import Broken, Kind, receive, send
from crowdbench.utils.errors import InputError
from crowdbench.utils.resources import FairLimit

TICK = 0.1
"""Seconds between two looks at the memory of a process."""


class TooSlow(Exception):
    """The process took longer than it may, and was ended."""


class Process:
    """A process that speaks the messages of `crowdbench.isolation.protocol`.

    Args:
        command: The command to start.
        most_memory: Bytes that it may take, with the processes which it starts.
        folder: Its working directory; the present one if None.
        temporary: Folders in memory that it alone sees: what lies in them counts as its memory.

    Attributes:
        seconds: Time in which it was waited for, so far.
        spent: The same without time in which it waited for a processor itself, as far as answers took long.
        memory: The largest memory in bytes that it was seen to have.

    Raises:
        InputError: This operating system has no such pipes, or the process cannot be started.
    """

    def __init__(
        self, command: Sequence[str], most_memory: float, folder: Path | None = None, temporary: Sequence[str] = ()
    ) -> None:
        if not hasattr(select, "poll"):
            raise InputError(f"a planner cannot be isolated on {sys.platform}: this takes Linux or macOS")
        self.most_memory = most_memory
        self.temporary = temporary
        self.seconds = self.spent = 0.0
        self.memory = 0
        self._looked = 0.0
        # In a session of its own, so that Ctrl-C at a terminal reaches the parent alone, which then ends it.
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0, start_new_session=True, cwd=folder
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._pipes = self._process.stdin, self._process.stdout
        self._sink, self._source = (pipe.fileno() for pipe in self._pipes)
        os.set_blocking(self._sink, False)
        os.set_blocking(self._source, False)

    def ask(self, limit: float, kind: Kind, *parts: bytes | memoryview) -> tuple[Kind, bytearray]:
        """Send a message and wait for the answer.

        Whatever is raised, the process is ended first, and everything that it has started as far as it can be found.

        Args:
            limit: Seconds that it may take; time in which it waits for a processor does not count.
            kind: Kind of the message.
            parts: Its content.

        Returns:
            Kind and content of the answer.

        Raises:
            TooSlow: It took longer.
            Broken: It has ended, took more memory than it may, or answered in another format.
        """
        start = time.monotonic()
        self._limit = FairLimit(limit, lambda: (process.pid for process in self._everybody()))
        try:
            send(self._write, kind, *parts)
            return receive(self._readinto)
        except Broken as error:
            raise Broken(self._status() or str(error)) from None
        except BaseException:
            self.end()
            raise
        finally:
            self.seconds += time.monotonic() - start
            self.spent += self._limit.spent()

    def _write(self, content: memoryview) -> int:
        self._wait(self._sink, select.POLLOUT)
        return os.write(self._sink, content)

    def _readinto(self, buffer: memoryview) -> int:
        self._wait(self._source, select.POLLIN)
        return os.readv(self._source, [buffer])

    def _wait(self, pipe: int, event: int) -> None:
        """Wait until a pipe is ready, and look at the process again and again meanwhile."""
        poll = select.poll()
        poll.register(pipe, event)
        self._watch()
        while not poll.poll(1e3 * TICK):
            self._watch()

    def _watch(self) -> None:
        if self._limit.over():
            raise TooSlow
        now = time.monotonic()
        if now - self._looked >= TICK:
            self._looked = now
            processes = list(self._everybody())
            memory = sum(map(_memory, processes)) + sum(_size(processes[-1], folder) for folder in self.temporary)
            self.memory = max(self.memory, memory)
            if memory > self.most_memory:
                taken = f"took {self.memory / 1e9:.1f} GB of memory, more than {self.most_memory / 1e9:g} GB,"
                raise Broken(taken)

    def _everybody(self) -> Iterator[psutil.Process]:
        """The process and those that it has started."""
        with contextlib.suppress(psutil.Error):
            process = psutil.Process(self._process.pid)
            yield process
            yield from process.children(recursive=True)

    def pin(self) -> int | None:
        """Have it, and all that it has started, use one core alone, any of them. macOS cannot do that.

        Returns:
            The core.
        """
        if not hasattr(os, "sched_setaffinity"):
            return None
        core = random.choice(sorted(os.sched_getaffinity(0)))
        for process in list(self._everybody()):
            for thread in Path(f"/proc/{process.pid}/task").glob("*"):
                with contextlib.suppress(OSError):
                    os.sched_setaffinity(int(thread.name), {core})
        return core

    @contextlib.contextmanager
    def stopped(self, core: int | None) -> Iterator[None]:
        """Stop it, with all that it has started, and be on its core meanwhile."""
        everybody = list(self._everybody())
        cores = None if core is None else os.sched_getaffinity(0)
        for process in everybody:
            with contextlib.suppress(psutil.Error):
                process.suspend()
        try:
            if core is not None:
                os.sched_setaffinity(0, {core})
            yield
        finally:
            if cores is not None:
                os.sched_setaffinity(0, cores)
            for process in everybody:
                with contextlib.suppress(psutil.Error):
                    process.resume()

    def processor_seconds(self) -> float:
        """The time of processors that it has taken so far, with all that it has started and that still runs."""
        total = 0.0
        for process in list(self._everybody()):
            with contextlib.suppress(psutil.Error):
                times = process.cpu_times()
                total += times.user + times.system
        return total

    def end(self) -> None:
        """Kill it, with all that it has started. It may have ended before."""
        for process in list(self._everybody()):
            with contextlib.suppress(psutil.Error):
                process.kill()
        with contextlib.suppress(OSError):  # what it started and what has another parent now
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        for pipe in self._pipes:
            pipe.close()

    def _status(self) -> str:
        """End it, and tell how it has ended by itself before; empty if it had not."""
        with contextlib.suppress(subprocess.TimeoutExpired):  # where it has only closed its pipes
            self._process.wait(TICK)
        code = self._process.returncode
        self.end()
        if code is None:
            return ""
        return f"ended its process ({f'signal {signal.Signals(-code).name}' if code < 0 else f'status {code}'})"


def _memory(process: psutil.Process) -> int:
    with contextlib.suppress(psutil.Error):
        return int(process.memory_info().rss)
    return 0


def _size(process: psutil.Process, folder: str) -> int:
    """The bytes in a folder as a process in a sandbox sees it."""
    with contextlib.suppress(OSError):
        # Opened once: while the sandbox is being made the path leads to the machine's own folder, then to another one.
        inside = os.open(f"/proc/{process.pid}/root{folder}", os.O_RDONLY | os.O_DIRECTORY)
        try:
            if os.fstat(inside).st_dev != os.stat(folder).st_dev:
                space = os.fstatvfs(inside)
                return (space.f_blocks - space.f_bfree) * space.f_frsize
        finally:
            os.close(inside)
    return 0
