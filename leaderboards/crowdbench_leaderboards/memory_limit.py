"""Limits the memory of this process while it reads and simulates the runs of an entry."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator

import psutil


@contextlib.contextmanager
def limit_memory(extra: float) -> Iterator[None]:
    """Limit the additional memory of this process to `extra` bytes: a larger allocation raises MemoryError.

    Only Linux enforces the limit: on other systems there is none.
    """
    if sys.platform != "linux":
        yield
        return
    import resource

    before = resource.getrlimit(resource.RLIMIT_AS)
    limit = psutil.Process().memory_info().vms + int(extra)
    soft = limit if before[0] == resource.RLIM_INFINITY else min(limit, before[0])
    resource.setrlimit(resource.RLIMIT_AS, (soft, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)
