"""Memory of this process: what it keeps, and a limit for what it does with files of others."""

from __future__ import annotations

import contextlib
import ctypes
import sys
from collections.abc import Iterator

import psutil

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3  # of malloc.h
_KEPT = 32 * 2**20


def keep_freed_memory() -> None:
    """Have this process keep the memory that arrays of some megabytes leave, for the next ones.

    The layers of a network would otherwise give pages back to the system and get them again, zeroed, which takes as
    long as their products. Only glibc can be told so.
    """
    with contextlib.suppress(OSError, AttributeError):
        libc = ctypes.CDLL(None)
        libc.mallopt(_M_MMAP_THRESHOLD, _KEPT)
        libc.mallopt(_M_TRIM_THRESHOLD, 8 * _KEPT)


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
