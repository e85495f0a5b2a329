"""Handles Ctrl-C (SIGINT) and SIGTERM only when no file is half-written, and only in crowdbench's process."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
from collections.abc import Iterator
from types import FrameType

from crowdbench.utils.errors import Interrupted

SIGNALS = (signal.SIGINT, signal.SIGTERM)


def handle() -> None:
    """Install handlers that raise `Interrupted` when Ctrl-C or SIGTERM arrives."""
    for number in SIGNALS:
        signal.signal(number, _raise)


class Interrupts:
    """Context that delays interrupts: they are recorded, and `Interrupted` is raised only in `let_through`.

    Outside the main thread, in which no signal arrives, it does nothing.

    Attributes:
        pending: True if an interrupt has arrived.
    """

    def __init__(self) -> None:
        self.pending = False
        self._open = False
        self._before: dict[int, object] = {}

    def __enter__(self) -> Interrupts:
        if threading.current_thread() is threading.main_thread():
            for number in SIGNALS:
                self._before[number] = signal.signal(number, self._note)
        return self

    def __exit__(self, *error: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)  # type: ignore[arg-type]

    @contextlib.contextmanager
    def let_through(self) -> Iterator[None]:
        """Let an interrupt raise `Interrupted`, at once if it arrived before."""
        self._open = True
        try:
            if self.pending:
                raise Interrupted
            yield
        finally:
            self._open = False

    def _note(self, number: int, frame: FrameType | None) -> None:
        self.pending = True
        if self._open:
            raise Interrupted


def _raise(number: int, frame: FrameType | None) -> None:
    raise Interrupted


# The signals end a forked process, such as a worker of a planner's pool, without a message. They are blocked during the
# fork: a signal that arrives before the handlers are reset would be lost.
_before_fork = threading.local()


def _hold_back() -> None:
    _before_fork.blocked = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)


def _let_in() -> None:
    signal.pthread_sigmask(signal.SIG_SETMASK, _before_fork.blocked)


def _reset() -> None:
    for number in SIGNALS:
        if getattr(signal.getsignal(number), "__module__", None) == __name__:
            signal.signal(number, signal.SIG_DFL)
    _let_in()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=_hold_back, after_in_parent=_let_in, after_in_child=_reset)
