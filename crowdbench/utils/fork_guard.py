"""End processes that a planner forks and that would go on with the run."""

from __future__ import annotations

import contextlib
import os


class ForkGuard:
    """Context that ends forked processes that leave it, because they would write, and remove, the same files.

    Args:
        who: Name of the forking object, for the message.
    """

    def __init__(self, who: str) -> None:
        self._who = who

    def __enter__(self) -> None:
        self._process = os.getpid()

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if os.getpid() == self._process:
            return
        if isinstance(error, SystemExit) and isinstance(error.code, int | None):
            os._exit(error.code or 0)
        sentence = f"a process that {self._who} has forked went on with the run and was ended: use os._exit(0)"
        with contextlib.suppress(OSError):  # the stream may be closed
            os.write(2, f"crowdbench: {sentence}\n".encode(errors="backslashreplace"))
        os._exit(1)
