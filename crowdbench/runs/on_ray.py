"""Parts of runs made by the workers of a Ray cluster, which may be one machine.

A worker gets a run's specification, makes a part in a folder of its own, and sends the files back, so that it needs no
folder in common with this process. A part whose worker is killed is made again by another one.
"""

from __future__ import annotations

import contextlib
import os
import platform
import signal
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from crowdbench.runs.load import open_run
from crowdbench.runs.shards import Parts
from crowdbench.runs.spec import RunSpec
from crowdbench.scenario.cases import Cases
from crowdbench.utils.errors import InputError, describe_error
from crowdbench.utils.files import new_directory


def make_parts(runs: Sequence[Parts], *, cpus: int = 1, progress: Callable[[float], None]) -> None:
    """Make parts of runs on a cluster: the one that `RAY_ADDRESS` names, or one that is started on this machine.

    Args:
        runs: What to make. Parts that are there are left out.
        cpus: CPUs that a part takes, and threads that its planner and simulator use.
        progress: Called with the number of cases of each part that is there.

    Raises:
        InputError: Ray is not installed or not reachable, a worker has other code or other files than this machine,
            or a planner, scenario or metric breaks its contract. Finished parts are kept.
        KeyboardInterrupt: Somebody interrupted it. Finished parts are kept.
    """
    environment = {"NUMBA_NUM_THREADS": str(cpus), "OMP_NUM_THREADS": str(cpus), "OMP_WAIT_POLICY": "passive"}
    with _connect() as ray, contextlib.ExitStack() as stack:
        machines = [int(node["Resources"].get("CPU", 0)) for node in ray.nodes() if node["Alive"]]
        if max(machines, default=0) < cpus:
            raise InputError(f"--threads {cpus} is more than any machine of the Ray cluster has")
        task = ray.remote(_make_part).options(num_cpus=cpus, runtime_env={"env_vars": environment})
        waiting: dict[Any, tuple[Parts, Cases]] = {}
        for parts in runs:
            stack.enter_context(parts.open())
            for part in parts.selected:
                if parts.is_finished(part):
                    progress(len(part))
                else:
                    waiting[task.remote(parts.spec, part, parts.request["run"], os.getcwd())] = parts, part
        while waiting:
            for future in ray.wait(list(waiting))[0]:
                parts, part = waiting.pop(future)
                files = _fetch_files(ray, future, part)
                with new_directory(parts.directory(part), overwrite=True) as partial:
                    for name, contents in files.items():
                        (partial / name).write_bytes(contents)
                parts.write_request()
                progress(len(part))


def _fetch_files(ray: Any, future: Any, part: Cases) -> dict[str, bytes]:
    """Return the files of a part. Raises InputError where a worker could not make it."""
    try:
        answer = ray.get(future)
    except ray.exceptions.RayError as error:
        raise InputError(f"the Ray cluster could not run the cases {part}: {describe_error(error)}") from error
    if isinstance(answer, str):
        raise InputError(answer)
    return dict(answer)


def _make_part(spec: RunSpec, part: Cases, expected: Mapping[str, Any], folder: str) -> dict[str, bytes] | str:
    """Make a part, on a worker.

    Args:
        spec: The run.
        part: The cases.
        expected: What the run is on the machine that sent it, see `RunId.parts`.
        folder: The folder that paths in the specification are relative to.

    Returns:
        Its files by name, or the sentence on what is wrong: an error of Ray's would carry a traceback in its message.
    """
    try:
        with contextlib.ExitStack() as stack:
            if Path(folder).is_dir():
                stack.enter_context(contextlib.chdir(folder))
            run = stack.enter_context(open_run(spec))
            differences = [key for key in ("code", *expected) if expected[key] != run.id.parts[key]]
            if differences:
                difference = "code of crowdbench" if differences[0] == "code" else differences[0]
                return (
                    f"the Ray worker on {platform.node()} has another {difference} than the machine that asks it: "
                    "install the same crowdbench there, and the same files"
                )
            directory = Path(stack.enter_context(tempfile.TemporaryDirectory())) / "part"
            run.drive(part, directory)
            return {path.name: path.read_bytes() for path in directory.iterdir()}
    except InputError as error:
        return str(error)


@contextlib.contextmanager
def _connect() -> Iterator[Any]:
    """Connect to a Ray cluster. Raises InputError where it is not installed, or the cluster is not reached."""
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
