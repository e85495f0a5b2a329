"""Workers for independent tasks: processes of this machine, or the workers of a Ray or a Dask cluster.

All three run tasks through the futures of `concurrent.futures`, and start a task again whose worker was killed. joblib
offers them behind one call, but its processes all end when one of them is killed, its backend for Ray ends with the
worker, and neither reports tasks one by one.
"""

from __future__ import annotations

import contextlib
import logging
import multiprocessing
import os
import signal
import socket
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from typing import Any

from crowdbench.utils.errors import InputError, MachineFault, require_count

ENGINES = ("ray", "dask")
"""Engines of clusters."""

THREADS = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS")
"""Variables with the number of threads of the simulator and of the networks."""

RETRIES = 3
"""Number of times that a task is started again after its worker was killed."""

CONNECTING = 8.0
"""Longest time in seconds to connect to a cluster."""

Submit = Callable[..., "Future[Any]"]
"""Starts a function with arguments on a worker, and returns its future. The function must be importable there."""


@dataclass(frozen=True)
class Executor:
    """Workers for tasks.

    Attributes:
        submit: Starts a task.
        workers: Number of workers.
    """

    submit: Submit
    workers: int


@contextlib.contextmanager
def open_executor(engine: str | None, workers: int | None, threads: int | None) -> Iterator[Executor | None]:
    """Start or connect to workers, and leave them afterwards. Tasks that are not finished then are dropped.

    Args:
        engine: One of `ENGINES`. Ray connects to `RAY_ADDRESS`, and Dask to `DASK_SCHEDULER_ADDRESS`; without the
            address they start workers on this machine. None for processes of this machine.
        workers: Number of workers, or None for all workers of the cluster; without an engine, None for no workers.
        threads: Number of threads of each worker; None to share the cores of this machine among its processes.

    Yields:
        The workers; None if neither an engine nor a number of workers is given.

    Raises:
        InputError: The engine is unknown or not installed.
        MachineFault: The cluster cannot be reached.
    """
    if workers is not None:
        require_count("--workers", workers)
    if engine is None and workers is None:
        yield None
        return
    if engine is not None and engine not in ENGINES:
        raise InputError(f"no engine is called {engine!r}; there are {' and '.join(ENGINES)}")
    with contextlib.ExitStack() as stack:
        try:
            if engine == "ray":
                executor = stack.enter_context(_open_ray(workers, threads or 1))
            elif engine == "dask":
                executor = stack.enter_context(_open_dask(workers, threads or 1))
            else:
                executor = stack.enter_context(_open_processes(workers or 1, threads))
        except ModuleNotFoundError as error:
            raise InputError(f"--engine {engine} needs pip install 'crowdbench[{engine}]': {error}") from None
        except (OSError, RuntimeError, ValueError) as error:
            raise MachineFault(f"the {engine or 'local'} workers cannot be reached: {error}") from None
        yield executor


@contextlib.contextmanager
def _set_threads(threads: int) -> Iterator[None]:
    """Set the number of threads of the processes that are started meanwhile."""
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ |= dict.fromkeys(THREADS, str(threads))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


@contextlib.contextmanager
def _open_processes(workers: int, threads: int | None) -> Iterator[Executor]:
    """Start processes of this machine: each has a pool of its own, so that a kill ends no other one."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    own, ended = threading.local(), threading.Event()
    context = multiprocessing.get_context("spawn")

    def run_task(function: Callable[..., Any], *arguments: Any) -> Any:
        for _ in range(RETRIES + 1):
            if ended.is_set():
                break
            if not hasattr(own, "pool"):
                own.pool = ProcessPoolExecutor(1, context, _start_process)
            try:
                return own.pool.submit(function, *arguments).result()
            except BrokenProcessPool:
                del own.pool
        raise MachineFault(f"{RETRIES + 1} workers were killed with the same task: is there enough memory?")

    with _set_threads(threads or max(1, cores // workers)):
        pool = ThreadPoolExecutor(workers)
        try:
            yield Executor(lambda function, *arguments: pool.submit(run_task, function, *arguments), workers)
        finally:
            ended.set()
            pool.shutdown(wait=False, cancel_futures=True)
            for process in multiprocessing.active_children():
                process.terminate()
            pool.shutdown()


def _start_process() -> None:
    """Prepare a process: it leaves Ctrl-C to its parent, and ends if its parent is killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()

    def follow() -> None:
        parent.join()  # type: ignore[union-attr]
        os._exit(1)

    threading.Thread(target=follow, daemon=True).start()


@contextlib.contextmanager
def _open_ray(workers: int | None, threads: int) -> Iterator[Executor]:
    """Connect to a Ray cluster. A worker has as many of its cores as threads."""
    import ray

    address = os.environ.get("RAY_ADDRESS")
    host, colon, port = (address or "").rpartition(":")
    if colon and "//" not in host:
        socket.create_connection((host, int(port)), CONNECTING).close()  # Ray would try for more than a minute
    local = {} if address else {"num_cpus": workers and workers * threads, "include_dashboard": False}
    variables = dict.fromkeys(("NUMBA_NUM_THREADS", "OMP_NUM_THREADS"), str(threads))
    ray.init(
        address or "local", runtime_env={"env_vars": variables}, log_to_driver=False, logging_level="error", **local
    )
    try:
        cores = int(ray.cluster_resources().get("CPU", 1))
        options = {"num_cpus": threads, "max_retries": RETRIES}

        def submit(function: Callable[..., Any], *arguments: Any) -> Future[Any]:
            remote = ray.remote(**options)(function)
            return remote.remote(*arguments).future()

        yield Executor(submit, workers or max(1, cores // threads))
    finally:
        ray.shutdown()


@contextlib.contextmanager
def _open_dask(workers: int | None, threads: int) -> Iterator[Executor]:
    """Connect to a Dask cluster, or start one on this machine."""
    from distributed import Client

    address = os.environ.get("DASK_SCHEDULER_ADDRESS")
    quiet = {"dashboard_address": None, "silence_logs": logging.CRITICAL}
    local = {} if address else {"n_workers": workers, "threads_per_worker": 1, **quiet}
    with _set_threads(threads), _without_interrupts():
        client = Client(address, timeout=CONNECTING, **local)
    with client:
        client.wait_for_workers(1, timeout=60.0)
        executor = client.get_executor(pure=False, retries=RETRIES)
        yield Executor(executor.submit, workers or max(1, sum(client.nthreads().values())))
        executor.shutdown(wait=False)


@contextlib.contextmanager
def _without_interrupts() -> Iterator[None]:
    """Ignore Ctrl-C, also in the processes that are started meanwhile, which their parent ends."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
