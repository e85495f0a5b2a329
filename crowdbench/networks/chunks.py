"""Threads that share the work of networks. In each of them, torch uses a single thread."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator

import torch

from crowdbench.utils.threads import share

CHUNK = 4096
"""Rows in one call of a network: few enough for its layers to stay in a core's cache, and enough work for a thread."""


def in_chunks(work: Callable[[slice], None], rows: int, chunk: int) -> None:
    """Process all rows in as many threads as torch uses; a single chunk is processed in the calling thread.

    Each chunk is processed by a single thread, so its bits do not depend on the number of threads. The threads wait for
    each other only once, and sleep meanwhile. Torch's own threads busy-wait after every operation of a network, which
    takes many times as long if another program uses the cores.

    Args:
        work: Called with slices that together cover every row once.
        chunk: Number of rows of a slice; the last may have fewer.
    """
    slices = [slice(start, start + chunk) for start in range(0, rows, chunk)]
    with one_torch_thread() as threads:
        share(work, slices, threads, _compute_alone)


class _TorchThread(threading.local):
    """Flag of a thread: True if torch uses only this thread."""

    is_alone = False


_thread = _TorchThread()


def _compute_alone() -> None:
    # Otherwise a new thread would get the number of torch's threads that was set last in any thread.
    torch.set_num_threads(1)
    _thread.is_alone = True


_lock = threading.Lock()
_inside = 0
_number = 1


@contextlib.contextmanager
def one_torch_thread() -> Iterator[int]:
    """Restrict torch to the calling thread, and yield the number of threads that it uses otherwise."""
    global _inside, _number
    if _thread.is_alone:
        yield _number
        return
    with _lock:
        # Only the first thread reads the number that the user set: torch gives new threads of Python the number that
        # was set last.
        if _inside == 0:
            _number = torch.get_num_threads()
        number = _number
        _inside += 1
        torch.set_num_threads(1)
    _thread.is_alone = True
    try:
        yield number
    finally:
        _thread.is_alone = False
        with _lock:
            _inside -= 1
            torch.set_num_threads(number)
