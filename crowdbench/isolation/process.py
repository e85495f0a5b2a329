"""A process that is asked through pipes, under limits of time and memory that its parent measures and enforces."""

from __future__ import annotations

import contextlib
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from crowdbench.isolation.limits import SHORTEST, TICK, Exceeded, Usage
from crowdbench.isolation.protocol import Broken, Kind, receive, send
from crowdbench.utils.errors import InputError, harmless
from crowdbench.utils.resources import FairLimit

PRINTED = 10_000
"""Characters of a process's output that are shown, at most."""


class TooSlow(Exception):
    """The process took longer than it may, and was ended."""


class Process:
    """A process that speaks the messages of `crowdbench.isolation.protocol`.

    Its standard error is shown line by line after its name, as ASCII that no terminal and no service that reads
    logs takes for a command.

    Args:
        name: Its name in its output.
        command: The command to start.
        settings: The settings of `crowdbench.isolation.launch`.
        usage: Its limits.
        folder: Its working directory; the present one if None.

    Attributes:
        usage: Its resources.
        seconds: Time in which it was waited for, so far.
        spent: The same without time in which it waited for a processor itself, as far as answers took long; or its
            processor time, shared by the processors that it may use, if that is more.

    Raises:
        InputError: This operating system has no such pipes, or the process cannot be started.
    """

    def __init__(
        self, name: str, command: Sequence[str], settings: Mapping[str, Any], usage: Usage, folder: Path | None = None
    ) -> None:
        if not hasattr(select, "poll"):
            raise InputError(f"a planner cannot be isolated on {sys.platform}: this takes Linux or macOS")
        self.name, self.usage = name, usage
        self.seconds = self.spent = 0.0
        self._before: float | None = None
        self._printed, self._line = 0, b""
        # In a session of its own, so that Ctrl-C at a terminal reaches the parent alone, which then ends it.
        self._process = subprocess.Popen(
            usage.command(settings, command),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            bufsize=0,
            start_new_session=True,
            cwd=folder,
        )
        usage.pid = self._process.pid
        self._pipes = [pipe for pipe in (self._process.stdin, self._process.stdout, self._process.stderr) if pipe]
        self._sink, self._source, self._output = (pipe.fileno() for pipe in self._pipes)
        for pipe in self._pipes:
            os.set_blocking(pipe.fileno(), False)

    @property
    def memory(self) -> int:
        """Return the largest memory in bytes that it was seen to have."""
        return self.usage.memory

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
        self._start, self._before = time.monotonic(), None
        self._next_look = self._start + min(TICK, limit / 20)
        self._limit = FairLimit(limit, self.usage.processes)
        try:
            send(self._write, kind, *parts)
            return receive(self._readinto)
        except Exceeded as error:
            self.end()
            raise Broken(str(error)) from None
        except Broken as error:
            raise Broken(self._status() or str(error)) from None
        except BaseException:
            self.end()
            raise
        finally:
            self.seconds += time.monotonic() - self._start
            self.spent += self._limit.spent() if self._before is None else max(self._limit.spent(), self._shared())

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
        poll.register(self._output, select.POLLIN)
        self._watch()
        while not (ready := dict(poll.poll(1e3 * SHORTEST))).keys() & {pipe}:
            if self._output in ready and not self._show():
                poll.unregister(self._output)
            self._watch()

    def _watch(self) -> None:
        self.usage.check()
        now = time.monotonic()
        if now >= self._next_look:
            self._next_look = now + min(TICK, self._limit.seconds / 20)
            if self._limit.over() or self._shared() > self._limit.seconds:
                raise TooSlow

    def _shared(self) -> float:
        """Return its processor time since it was asked, shared by the processors that it may use."""
        now, taken = time.monotonic() - self._start, self.usage.seconds() / self.usage.processors
        if self._before is None:  # at the first look it may have used all of them: short answers cost nothing
            self._before = taken - now
        return taken - self._before

    def _show(self) -> bool:
        """Show the lines that it has printed so far, and return whether there may be more."""
        try:
            content = os.read(self._output, 65536)
        except BlockingIOError:
            return True
        *lines, self._line = (self._line + content).split(b"\n")
        if not content or len(self._line) > PRINTED:
            lines, self._line = [*lines, self._line], b""
        for line in filter(None, lines):
            if self._printed < PRINTED:
                text = line[:PRINTED].decode(errors="replace")
                print(harmless(f"planner {self.name}: {text}"), file=sys.stderr)
            self._printed += len(line)
        return bool(content)

    def end(self) -> None:
        """Kill it, with all that it has started. It may have ended before."""
        if self._pipes[0].closed:
            return
        self.usage.kill()
        self._process.wait()
        self.usage.close()
        for _ in range(16):  # what escaped from a process without a sandbox may print for ever
            if not select.select([self._output], [], [], 0.0)[0] or not self._show():
                break
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
