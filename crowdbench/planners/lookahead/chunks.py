"""Work on many rows, cut into chunks that threads share."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import torch


def in_chunks(work: Callable[[slice], None], rows: int, chunk: int) -> None:
    """Call `work` with slices that cover so many rows, in as many threads as torch has.

    Each chunk is one thread's alone. So its bits do not depend on how many there are, and threads wait for each other
    once, not after every operation of a network, which takes ages on a machine that is busy with other things.
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
                # Fetched, since a result that nobody asks for hides what was raised.
                list(pool.map(work, slices))
    finally:
        torch.set_num_threads(threads)
