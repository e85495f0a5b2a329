"""Threads that share the work of networks, in each of which torch computes alone."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator

import torch

from crowdbench.utils.threads import share

CHUNK = 4096
"""Rows that a network is given at once: few enough for its layers to stay in a core's cache, and enough work to be
worth a thread."""


def in_chunks(work: Callable[[slice], None], rows: int, chunk: int) -> None:
    """Work on all rows, in as many threads as torch uses; in the calling thread alone where there is one chunk.

    Each chunk is worked on by a single thread, so its bits do not depend on the number of threads. The threads also
    wait for each other only once, asleep. Torch's own threads wait after every operation of a network, and wait busily,
    which takes many times as long where another program wants the cores.

    Args:
        work: Called with slices that together cover every row once.
        rows: Number of rows.
        chunk: Number of rows of a slice; the last may have fewer.
    """
    slices = [slice(start, start + chunk) for start in range(0, rows, chunk)]
    with one_torch_thread() as threads:
        share(work, slices, threads, _compute_alone)


class _Here(threading.local):
    """True if torch computes in this thread alone."""

    is_alone = False


_here = _Here()


def _compute_alone() -> None:
    # Or else a new thread would get the number of torch's threads that was set last, by anybody.
    torch.set_num_threads(1)
    _here.is_alone = True


_lock = threading.Lock()
_inside = 0
_number = 1


@contextlib.contextmanager
def one_torch_thread() -> Iterator[int]:
    """Let torch compute in the calling thread alone, and yield the number of threads that it has otherwise."""
    global _inside, _number
    if _here.is_alone:
        yield _number
        return
    with _lock:
        # Only the first one inside finds the number that the user set: torch gives new threads of Python what was set
        # last.
        if _inside == 0:
            _number = torch.get_num_threads()
        number = _number
        _inside += 1
        torch.set_num_threads(1)
    _here.is_alone = True
    try:
        yield number
    finally:
        _here.is_alone = False
        with _lock:
            _inside -= 1
            torch.set_num_threads(number)
