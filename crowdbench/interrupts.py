"""Ctrl-C and kill, let through only where nothing can be left half-done."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator
from types import FrameType


class Interrupts:
    """In a `with` statement, notes Ctrl-C (SIGINT) and SIGTERM in `asked` instead of raising KeyboardInterrupt.

    Inside `let_through` they raise it. Outside the main thread, where no signal arrives, it does nothing.
    """

    def __init__(self) -> None:
        self.asked = False
        self._open = False
        self._before: dict[int, object] = {}

    def __enter__(self) -> Interrupts:
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                self._before[number] = signal.signal(number, self._note)
        return self

    def __exit__(self, *error: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)  # type: ignore[arg-type]

    @contextlib.contextmanager
    def let_through(self) -> Iterator[None]:
        """Raise KeyboardInterrupt as usual, at once if it was asked for before."""
        self._open = True
        try:
            if self.asked:
                raise KeyboardInterrupt
            yield
        finally:
            self._open = False

    def _note(self, number: int, frame: FrameType | None) -> None:
        self.asked = True
        if self._open:
            raise KeyboardInterrupt
