"""Make runs: part by part in this process, or with all parts handed to workers."""

from __future__ import annotations

import contextlib
import functools
import json
import math
import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from crowdbench.results.result_file import check_result, read_result
from crowdbench.runs.parts import Drive, Parts
from crowdbench.runs.rollout import Progress
from crowdbench.runs.run import Run
from crowdbench.runs.shards import WHOLE, Shard
from crowdbench.runs.trial import try_plugins
from crowdbench.runs.worker import INTERVAL, PartReport, PartTask, make_part
from crowdbench.scenario.cases import Cases
from crowdbench.utils.commands import command
from crowdbench.utils.errors import InputError, MachineFault, NotWritten, describe_error
from crowdbench.utils.executors import Executor
from crowdbench.utils.files import check_free


def make_run(
    run: Run,
    out: Path,
    *,
    shard: Shard = WHOLE,
    overwrite: bool = False,
    drive: Drive | None = None,
    progress: Progress | None = None,
) -> bool:
    """Make a run, or a shard of it, and continue with existing parts. The run is merged once all cases are finished.

    Args:
        run: The run.
        out: Its directory. If it has the finished run already, nothing is done.
        shard: The share of the cases to drive.
        overwrite: True if an earlier run in its directory is replaced.
        drive: Function that makes a part; None for `Run.drive`.
        progress: Called after each step with its progress, summed over the episodes, in fractions of an episode.

    Returns:
        True if the run is complete in its directory; False if other processes must make, or are making, parts of it.

    Raises:
        InputError: The directory is not free, or as in `Run.drive`.
        KeyboardInterrupt: The user interrupted the run. Finished parts are stored.
    """
    share = shard.share(run.spec.cases)
    report = progress or (lambda done: None)
    if is_made(run, out, overwrite):
        report(len(share))
        return True
    parts = Parts.of(run, out)
    drive = drive or functools.partial(run.drive, progress=progress)
    with parts.open():
        # Again, because another process may have merged all parts before this one made their folder again.
        missing = [] if is_made(run, out, overwrite) else parts.missing(share)
        if missing:
            try_plugins(run.scenario, share, run.metrics)
        report(len(share) - sum(map(len, missing)))
        for gap in missing:
            for part in gap.batches(run.spec.batch):
                if not parts.make(part, drive):
                    report(len(part))
        return parts.merge(overwrite)


def is_made(run: Run, out: Path, overwrite: bool = False) -> bool:
    """Return whether a directory has the finished run, unless that is to be replaced.

    Raises NotWritten if the directory has something else, with a note on planner files that were edited since.
    """
    try:
        check_free(out, overwrite)
    except NotWritten as error:
        with contextlib.suppress(InputError):
            result = read_result(out)
            if result["id"] == run.id.digest and result["stated"]["record"] == run.spec.record:
                check_result(out)
                _remove_parts(Parts.of(run, out))
                return True
            for note in _describe_other(run, out, result):
                error.add_note(note)
        raise
    return False


def _describe_other(run: Run, out: Path, result: Mapping[str, Any]) -> Iterator[str]:
    """Yield the known differences between a run and the one that is in its directory."""
    if result["id"] == run.id.digest:
        yield f"it is this run, made with --record {result['stated']['record']}"
    elif result["run"] | {"metrics": {}} == json.loads(json.dumps(run.id.parts)) | {"metrics": {}}:
        lacking = [name for name in run.id.metrics if name not in result["run"]["metrics"]]
        given = [word for file in run.spec.metrics for word in ("--metric", file)]
        score = command("score", out, *given, "--out", f"{out}-scored")
        which = f"without metric {lacking[0]}" if lacking else "with other metrics"
        yield f"it is this run {which}: `{score}` computes it without driving again"
    if result["run"]["cases"] != str(run.spec.cases):
        yield f"it has the cases {result['run']['cases']}, not {run.spec.cases}"
    before = result["run"]["planner"]["files"].get("planner", {})
    for name, digest in run.planner.files.get("planner", {}).items():
        if before.get(name, digest) != digest:
            yield f"{name} was edited since that run"


def _remove_parts(parts: Parts) -> None:
    """Remove what a process has left that was killed after it had merged all parts."""
    for folder in [parts.folder, *parts.folder.parent.glob(f".{parts.folder.name}.merged-*")]:
        shutil.rmtree(folder, ignore_errors=True)


@dataclass
class WorkersRun:
    """A run that workers make.

    Attributes:
        parts: The parts of the run.
        tasks: Its tasks by their futures, until they are finished.
        is_complete: True if the run is complete in its directory.
        error: The error that stopped it.
    """

    parts: Parts
    tasks: dict[Future[PartReport], PartTask] = field(default_factory=dict)
    is_complete: bool = False
    error: InputError | None = None

    def stop(self, error: InputError | None = None) -> None:
        """Drop the tasks that no worker has started."""
        self.error = error
        for future in self.tasks:
            future.cancel()


def make_with(
    executor: Executor,
    runs: Sequence[tuple[Run, Path]],
    *,
    shard: Shard = WHOLE,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> list[WorkersRun]:
    """Make runs with workers, and continue with existing parts. A run is merged as soon as all its parts are finished.

    All workers must see the folders of the runs, and the files that the runs name.

    Args:
        executor: The workers.
        runs: The runs, loaded by `load_run` from their specification alone, and their directories.
        shard: The share of the cases of each run to drive.
        overwrite: True if earlier runs in the directories are replaced.
        progress: As in `make_run`.

    Returns:
        The runs with their errors. An error stops its run only.

    Raises:
        MachineFault: A directory is not free or cannot be written, or a worker fails.
        KeyboardInterrupt: The user interrupted it. Finished parts are stored.
    """
    report = progress or (lambda done: None)
    made = [WorkersRun(Parts.of(run, out.absolute())) for run, out in runs]
    with contextlib.ExitStack() as stack:
        missing = []
        for each in made:
            run, gaps = each.parts.run, []
            share = shard.share(run.spec.cases)
            each.is_complete = is_made(run, each.parts.out, overwrite)
            if not each.is_complete:
                stack.enter_context(each.parts.open())
                gaps = [] if is_made(run, each.parts.out, overwrite) else each.parts.missing(share)
            if gaps:
                try_plugins(run.scenario, share, run.metrics)
            missing.append(gaps)
            report(len(share) - sum(map(len, gaps)))
        of_a_worker = math.ceil(sum(len(gap) for gaps in missing for gap in gaps) / executor.workers)
        try:
            for each, gaps in zip(made, missing, strict=True):
                run = each.parts.run
                size = max(1, min(run.spec.batch, of_a_worker)) if run.is_divisible else run.spec.batch
                for part in (part for gap in gaps for part in gap.batches(size)):
                    task = _task(each.parts, part)
                    each.tasks[executor.submit(make_part, task)] = task
                _merge(each, overwrite)
            _wait(made, overwrite, report)
        finally:
            for each in made:
                each.stop(each.error)
    return made


def _task(parts: Parts, part: Cases) -> PartTask:
    return PartTask(parts.run.spec, parts.run.id.digest, os.getcwd(), parts.out, part)


def _merge(run: WorkersRun, overwrite: bool) -> None:
    """Merge a run whose tasks are finished."""
    if not run.tasks and run.error is None and not run.is_complete:
        run.is_complete = run.parts.merge(overwrite)


def _wait(runs: Sequence[WorkersRun], overwrite: bool, report: Progress) -> None:
    """Wait for all tasks, and report their progress."""
    running = {future: run for run in runs for future in run.tasks}
    finished = reported = 0.0
    while running:
        done, _ = wait(running, INTERVAL, FIRST_COMPLETED)
        for future in done:
            run = running.pop(future)
            task = run.tasks.pop(future)
            finished += len(task.cases)
            if not future.cancelled():
                _take(run, task, future)
            _merge(run, overwrite)
        progress = finished + sum(task.read_progress() for run in runs for task in run.tasks.values())
        report(max(0.0, progress - reported))
        reported = max(progress, reported)


def _take(run: WorkersRun, task: PartTask, future: Future[PartReport]) -> None:
    """Note the report of a worker. Raises MachineFault if the worker, or its machine, has failed."""
    try:
        report = future.result()
    except InputError:
        raise
    except Exception as error:
        raise MachineFault(f"a worker failed: {describe_error(error)}") from error
    run.parts.run.failed.update(report.failed)
    run.parts.run.lost.extend(report.lost)
    if isinstance(report.error, MachineFault):
        raise report.error
    if report.error is not None:
        run.stop(report.error)
    elif report.is_made and task.is_lost():
        raise MachineFault(
            f"the worker on {report.machine} has made {task.cases}, but {task.folder} does not have it here: give "
            "--out a folder that all workers share"
        )
