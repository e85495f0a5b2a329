"""A limit of time counts work and sleep, but not the wait for a processor."""

import multiprocessing
import os
import sys
import time

import pytest

from crowdbench.utils.resources import FairLimit

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="only Linux says how long a thread waited")


def own():
    return (os.getpid(),)


def busy(core, seconds):
    os.sched_setaffinity(0, {core})
    end = time.perf_counter() + seconds
    while time.perf_counter() < end:
        pass


def worked_until_over(limit):
    """Processor time that this thread had until the limit was over."""
    start = time.thread_time()
    while not limit.over():
        pass
    return time.thread_time() - start


def test_sleep_counts():
    limit = FairLimit(0.2, own)
    time.sleep(0.11)
    assert not limit.over()
    time.sleep(0.11)
    assert limit.over()


def test_the_first_look_may_come_after_the_end():
    limit = FairLimit(0.1, own)
    time.sleep(0.12)
    assert limit.over()


@pytest.mark.slow
def test_the_wait_for_a_processor_does_not_count():
    cores = os.sched_getaffinity(0)
    core = min(cores)
    context = multiprocessing.get_context("spawn")
    others = [context.Process(target=busy, args=(core, 30.0)) for _ in range(3)]
    for other in others:
        other.start()
    try:
        os.sched_setaffinity(0, {core})
        time.sleep(1.0)  # until the others are busy
        start = time.perf_counter()
        worked = worked_until_over(FairLimit(1.0, own))
        passed = time.perf_counter() - start
    finally:
        os.sched_setaffinity(0, cores)
        for other in others:
            other.kill()
            other.join()
    # Of four, each has a quarter of the core: 0.125 s of work in the first half of the limit, 0.5 s in the second.
    assert passed > 1.5
    assert worked > 0.4


def test_nobody_waits_for_ever():
    limit = FairLimit(0.02, own)
    limit._start -= 0.21  # as if it had waited for all this time
    assert limit.over()
