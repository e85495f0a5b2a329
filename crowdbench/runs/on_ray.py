"""Parts of runs made by the workers of a Ray cluster, which may be one machine.

A worker gets a run's specification, makes a part in a folder of its own, and sends the files back, so that it needs no
folder in common with this process. A part whose worker is killed is made again by another one.
"""

from __future__ import annotations

import contextlib
import json
import os
import platform
import signal
import sys
import tempfile
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from filelock import Timeout

from crowdbench.runs.load import open_run
from crowdbench.runs.run import Run
from crowdbench.runs.shards import Parts, Shard
from crowdbench.runs.spec import RunSpec
from crowdbench.scenario.cases import Cases
from crowdbench.utils.errors import InputError, describe_error
from crowdbench.utils.files import check_free, new_directory

MOST_UNDER_WAY = 500
"""Parts that are with the cluster at a time, at most: each keeps a lock, and processes may open about 1000 files."""


def make_run_on_ray(
    run: Run, out: Path, shard: Shard, overwrite: bool, *, cpus: int, progress: Callable[[float], None]
) -> None:
    """Make the parts of one run, or of a shard of it; arguments and errors are those of `make_parts` and `make_run`."""
    check_free(out, overwrite)
    parts = Parts.of(run, out, shard)
    with parts.report_finished():
        make_parts([parts], cpus=cpus, progress=progress)


def make_parts(
    runs: Sequence[Parts],
    *,
    cpus: int = 1,
    finished: Callable[[int], None] = lambda number: None,
    progress: Callable[[float], None],
) -> None:
    """Make parts of runs on a cluster: the one that `RAY_ADDRESS` names, or one that is started on this machine.

    Args:
        runs: What to make. Parts that are there, and those that other processes are making, are left out.
        cpus: CPUs that a part takes, and threads that its planner and simulator use.
        finished: Called with the number of a run when none of its parts is left to make.
        progress: Called with the number of cases of each part that is there.

    Raises:
        InputError: Ray is not installed or not reachable, a worker has other code or other files than this machine,
            or a planner, scenario or metric breaks its contract. Finished parts are kept.
        KeyboardInterrupt: Somebody interrupted it. Finished parts are kept.
    """
    with _connect() as ray, contextlib.ExitStack() as stack:
        for parts in runs:
            stack.enter_context(parts.open())
        left = [len(parts.selected) for parts in runs]
        for number, cases in _finish_parts(ray, runs, cpus):
            progress(cases)
            left[number] -= 1
            if not left[number]:
                finished(number)


def _finish_parts(ray: Any, runs: Sequence[Parts], cpus: int) -> Iterator[tuple[int, int]]:
    """Have all parts made, and yield for each the number of its run and how many cases have come by it."""
    environment = {"NUMBA_NUM_THREADS": str(cpus), "OMP_NUM_THREADS": str(cpus), "OMP_WAIT_POLICY": "passive"}
    task = ray.remote(_make_part).options(num_cpus=cpus, runtime_env={"env_vars": environment})
    most = min(MOST_UNDER_WAY, 2 * _count_places(ray, cpus))
    waiting = deque((number, part) for number, parts in enumerate(runs) for part in parts.selected)
    under_way: dict[Any, tuple[int, Cases, contextlib.ExitStack]] = {}
    with contextlib.ExitStack() as all_locks:
        while waiting or under_way:
            while waiting and len(under_way) < most:
                number, part = waiting.popleft()
                parts, lock = runs[number], all_locks.enter_context(contextlib.ExitStack())
                try:
                    is_missing = lock.enter_context(parts.claim(part))
                except Timeout:
                    yield number, 0
                    continue
                if is_missing:
                    future = task.remote(parts.spec, part, parts.request, os.getcwd())
                    under_way[future] = number, part, lock
                else:
                    lock.close()
                    yield number, len(part)
            for done in ray.wait(list(under_way))[0] if under_way else []:
                number, part, lock = under_way.pop(done)
                files = _fetch_files(ray, done, part)
                with new_directory(runs[number].directory(part), overwrite=True) as partial:
                    for name, contents in files.items():
                        (partial / name).write_bytes(contents)
                lock.close()
                yield number, len(part)


def _count_places(ray: Any, cpus: int) -> int:
    """How many parts the cluster makes at once. Raises InputError where no machine has as many CPUs."""
    machines = [int(node["Resources"].get("CPU", 0)) for node in ray.nodes() if node["Alive"]]
    if max(machines, default=0) < cpus:
        raise InputError(f"--threads {cpus} is more than any machine of the Ray cluster has")
    return sum(machine // cpus for machine in machines)


def _fetch_files(ray: Any, done: Any, part: Cases) -> dict[str, bytes]:
    """The files of a part. Raises InputError where a worker could not make it."""
    try:
        answer = ray.get(done)
    except ray.exceptions.RayError as error:
        raise InputError(f"the Ray cluster could not run the cases {part}: {describe_error(error)}") from error
    if isinstance(answer, str):
        raise InputError(answer)
    return dict(answer)


def _make_part(spec: RunSpec, part: Cases, request: str, folder: str) -> dict[str, bytes] | str:
    """Make a part, on a worker.

    Args:
        spec: The run.
        part: The cases.
        request: What the part's folder says that its figures depend on.
        folder: The folder that paths in the specification are relative to.

    Returns:
        Its files by name, or the sentence on what is wrong: an error of Ray's would carry a traceback in its message.
    """
    try:
        with contextlib.ExitStack() as stack:
            if Path(folder).is_dir():
                stack.enter_context(contextlib.chdir(folder))
            run = stack.enter_context(open_run(spec))
            _check_same(run, request)
            directory = Path(stack.enter_context(tempfile.TemporaryDirectory())) / "part"
            run.drive(part, directory)
            return {path.name: path.read_bytes() for path in directory.iterdir()}
    except InputError as error:
        return str(error)


def _check_same(run: Run, request: str) -> None:
    """Raise InputError where this machine would make another run."""
    expected, own = (json.loads(text)["run"] for text in (request, Parts.of(run, Path("run")).request))
    differ = [key for key in ("code", *expected) if expected.get(key) != own.get(key)]
    if differ:
        what = "code of crowdbench" if differ[0] == "code" else differ[0]
        raise InputError(
            f"the Ray worker on {platform.node()} has another {what} than the machine that asks it: install the same "
            "crowdbench there, and the same files"
        )


@contextlib.contextmanager
def _connect() -> Iterator[Any]:
    """Ray, connected to a cluster. Raises InputError where it is not installed, or the cluster is not reached."""
    try:
        import ray
    except ImportError:
        raise InputError("--on ray needs Ray: pip install 'crowdbench[ray]'") from None
    if ray.is_initialized():
        yield ray
        return
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    handler = signal.getsignal(signal.SIGTERM)
    # Ray prints what happens to its workers on standard output, where only results belong.
    with contextlib.redirect_stdout(sys.stderr):
        try:
            # By itself, Ray would try a cluster that has run on this machine before, and wait for it in vain.
            address = os.environ.get("RAY_ADDRESS") or "local"
            ray.init(address, include_dashboard=False, log_to_driver=False, configure_logging=False)
        except (OSError, RuntimeError, ValueError) as error:
            raise InputError(f"no Ray cluster can be reached or started: {describe_error(error)}") from error
        finally:
            signal.signal(signal.SIGTERM, handler)  # Ray replaces it
        try:
            yield ray
        finally:
            ray.shutdown()
