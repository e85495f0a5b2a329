"""Work on many rows in chunks, which threads share."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import torch


def in_chunks(work: Callable[[slice], None], rows: int, chunk: int) -> None:
    """Work on all rows, in as many threads as torch uses.

    Each chunk is worked on by a single thread, so its bits do not depend on the number of threads. The threads also
    wait for each other only once, and not after every operation of a network, which is slow on a busy machine.

    Args:
        work: Called with slices that together cover every row once.
        rows: Number of rows.
        chunk: Number of rows of a slice; the last may have fewer.
    """
    slices = [slice(start, start + chunk) for start in range(0, rows, chunk)]
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        if min(len(slices), threads) <= 1:
            for each in slices:
                work(each)
        else:
            with ThreadPoolExecutor(threads) as pool:
                # The results are read, because an exception is raised only when its result is read.
                list(pool.map(work, slices))
    finally:
        torch.set_num_threads(threads)
