"""A process that answers messages through pipes, under limits of time and memory that its parent enforces."""

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

from crowdbench.isolation.limits import SHORTEST, TICK, Usage
from crowdbench.isolation.protocol import MessageKind, ProtocolError, receive, send
from crowdbench.isolation.untrusted_text import one_line
from crowdbench.utils.errors import InputError
from crowdbench.utils.resources import FairLimit

PRINTED = 10_000
"""Characters of a process's output that are shown, at most."""


class TooSlow(Exception):
    """Raised if the process exceeded its time limit; it was ended."""


class Process:
    """A process that reads and answers the messages of `crowdbench.isolation.protocol`.

    Its standard error is printed line by line after its name, as ASCII without commands for terminals and services that
    read logs.

    Args:
        settings: The settings of `crowdbench.isolation.launch`.
        folder: Its working directory; the present one if None.

    Attributes:
        usage: Its resources.
        seconds: Total time in which the parent waited for its answers.
        spent: The same without the time in which it waited for a processor, if answers took long. If that is less, its
            processor time divided by the number of processors that it may use.

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
        # In a separate session, so that Ctrl-C at a terminal reaches only the parent, which then ends the process.
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

    def ask(self, limit: float, kind: MessageKind, *parts: bytes | memoryview) -> tuple[MessageKind, bytearray]:
        """Send a message and wait for the answer.

        Before any exception is raised, the process is ended, and its descendants as far as they can be found.

        Args:
            limit: Longest time for the answer in seconds, without time in which it waits for a processor.

        Returns:
            Kind and content of the answer.

        Raises:
            TooSlow: The process exceeded the time limit.
            Exceeded: The process exceeded another limit.
            ProtocolError: The process has ended, or answered in another format.
        """
        self._start, self._before = time.monotonic(), None
        self._next_look = self._start + min(TICK, limit / 20)
        self._limit = FairLimit(limit, self.usage.processes)
        try:
            send(self._write, kind, *parts)
            return receive(self._readinto)
        except ProtocolError as error:
            raise ProtocolError(self._status() or str(error)) from None
        except BaseException:
            self.end()
            raise
        finally:
            self.seconds += time.monotonic() - self._start
            spent = self._limit.spent()
            if self._before is not None:
                spent = max(spent, self._shared())
            self.spent += spent

    def _write(self, content: memoryview) -> int:
        self._wait(self._sink, select.POLLOUT)
        return os.write(self._sink, content)

    def _readinto(self, buffer: memoryview) -> int:
        self._wait(self._source, select.POLLIN)
        return os.readv(self._source, [buffer])

    def _wait(self, pipe: int, event: int) -> None:
        """Wait until a pipe is ready, and check the limits of the process meanwhile."""
        poll = select.poll()
        poll.register(pipe, event)
        poll.register(self._output, select.POLLIN)
        self._watch()
        while True:
            ready = dict(poll.poll(1e3 * SHORTEST))
            if pipe in ready:
                return
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
        """Return its processor time since the message, divided by the number of processors that it may use."""
        now = time.monotonic() - self._start
        taken = self.usage.seconds() / self.usage.processors
        if self._before is None:  # full use is assumed until the first check: short answers cost nothing
            self._before = taken - now
        return taken - self._before

    def _show(self) -> bool:
        """Print the lines of its output so far, and return whether there may be more."""
        try:
            content = os.read(self._output, 65536)
        except BlockingIOError:
            return True
        *lines, self._line = (self._line + content).split(b"\n")
        if not content or len(self._line) > PRINTED:
            lines, self._line = [*lines, self._line], b""
        for line in filter(None, lines):
            if self._printed < PRINTED:
                text = line[:PRINTED].decode("ascii", "backslashreplace")
                print(one_line(f"planner {self.name}: {text}", 2 * PRINTED), file=sys.stderr)
            self._printed += len(line)
        return bool(content)

    def end(self) -> None:
        """Kill it, with all that it has started. It may have ended before."""
        if self._pipes[0].closed:
            return
        self.usage.kill()
        self._process.wait()
        self.usage.close()
        for _ in range(16):  # an escaped process without a sandbox may print forever
            if not select.select([self._output], [], [], 0.0)[0] or not self._show():
                break
        for pipe in self._pipes:
            pipe.close()

    def _status(self) -> str:
        """End the process. Return how it had already ended; empty if it had not."""
        with contextlib.suppress(subprocess.TimeoutExpired):  # raised if it has only closed its pipes
            self._process.wait(TICK)
        code = self._process.returncode
        self.end()
        if code is None:
            return ""
        status = f"signal {signal.Signals(-code).name}" if code < 0 else f"status {code}"
        return f"ended its process ({status})"
