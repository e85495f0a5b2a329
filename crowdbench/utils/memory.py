"""A limit of memory for what this process does with files of others."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator

import psutil


@contextlib.contextmanager
def limit_memory(more: float) -> Iterator[None]:
    """Have this process take so many bytes more at most: where it asks for more, MemoryError is raised.

    Only Linux keeps to it: elsewhere there is no limit.
    """
    if sys.platform != "linux":
        yield
        return
    import resource

    before = resource.getrlimit(resource.RLIMIT_AS)
    most = psutil.Process().memory_info().vms + int(more)
    soft = most if before[0] == resource.RLIM_INFINITY else min(most, before[0])
    resource.setrlimit(resource.RLIMIT_AS, (soft, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)
