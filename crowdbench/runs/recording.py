"""Recording during a run: the commands of all cases, and episodes for the viewer.

The commands are stored in `commands.parquet`. With the scenario, they are sufficient to simulate each case again.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
from jaxtyping import Bool

from crowdbench.core.types import Outcome, Trace
from crowdbench.metrics.registry import Metric, info_of
from crowdbench.results.episodes import RECORDING, Episodes
from crowdbench.results.stored_commands import commands_table
from crowdbench.scenario.cases import Cases
from crowdbench.utils.defaults import FIRST_RECORDED, MOST_FAILURES, RECORDED_CROWD, WITH_EPISODES
from crowdbench.utils.errors import NotWritten

if TYPE_CHECKING:
    from crowdbench.record.write import Recorder


@dataclass
class RunRecorder:
    """Recorder of the commands of all traces that are added, and of the episodes of failures and of the first cases.

    Attributes:
        cases: The cases of the whole run.
        most_failures: Largest number of failures that are recorded; None to record all episodes.
        commands: The commands so far, a table for each batch; None if they are not recorded.
        recorder: Writer of the episodes, if any are recorded.
        failures: Number of failures so far.
        number: Number of recorded episodes so far.
        lost: The reason why the episodes could not be written; empty if they were.
    """

    cases: Cases
    most_failures: int | None
    commands: list[pa.Table] | None = None
    recorder: Recorder | None = None
    failures: int = 0
    number: int = 0
    lost: str = ""

    def add(self, trace: Trace, episodes: Episodes, first_only: bool = False) -> None:
        """Record the commands of a batch of episodes, and the episodes that are chosen for recording.

        Args:
            trace: The episodes.
            episodes: Their metrics.
            first_only: True to choose only among the episodes of first vehicles.
        """
        if self.commands is not None:
            self.commands.append(commands_table(trace))
        if self.recorder is None:
            return
        chosen = np.asarray(trace.vehicle == 0) if first_only else shown_rows(trace)
        if self.most_failures is not None:
            failed = np.asarray(chosen & (trace.outcome != Outcome.SUCCESS))
            is_first = trace.case < self.cases.start + FIRST_RECORDED
            chosen &= is_first | (failed & (self.failures + np.cumsum(failed) <= self.most_failures))
            self.failures += int(failed.sum())
        try:
            self.recorder.add(trace, np.flatnonzero(chosen), episodes.columns)
            self.number += int(chosen.sum())
        except NotWritten as error:
            self.recorder.__exit__(NotWritten, error, None)
            self.drop(str(error))

    def drop(self, reason: str) -> None:
        """Go on without recorded episodes: a full disk must not cost the results."""
        self.recorder, self.number, self.lost = None, 0, reason

    def close(self, kind: type[BaseException] | None, *error: Any) -> None:
        """Write the recorded episodes, unless an exception was raised."""
        if self.recorder is not None:
            try:
                self.recorder.__exit__(kind, *error)
            except NotWritten as fault:
                self.drop(str(fault))


def shown_rows(trace: Trace) -> Bool[np.ndarray, "world"]:
    """Return the episode that shows each case: of several vehicles, the first failure, or else the last arrival."""
    if trace.vehicle is None:
        return np.ones(len(trace), bool)
    steps, vehicles = trace.steps.reshape(-1, trace.rules.vehicles), np.arange(trace.rules.vehicles)
    failed = trace.outcome.reshape(steps.shape) != Outcome.SUCCESS
    rank = np.where(failed, 2 * trace.rules.max_steps - steps, steps)
    return np.asarray(rank.argmax(axis=1)[:, None] == vehicles).ravel()


@contextlib.contextmanager
def open_recorder(
    record: str, folder: Path, cases: Cases, pedestrians: int, header: Mapping[str, Any]
) -> Iterator[RunRecorder]:
    """Record a run. The recording of episodes is written to a folder at the end.

    Args:
        record: Extent of the recording, one of `defaults.RECORD`.
        folder: The folder.
        cases: The cases of the whole run.
        pedestrians: The largest number of pedestrians in a case.
        header: Properties of the run, the parameters of `Recorder`.
    """
    recording = RunRecorder(cases, None if record == "all" else most_failures(pedestrians))
    if record != "none":
        recording.commands = []
    with contextlib.ExitStack() as stack:
        if record in WITH_EPISODES:
            from crowdbench.record.write import Recorder

            recording.recorder = Recorder(folder / RECORDING, **header).__enter__()
            stack.push(recording.close)
        yield recording


def units_of(metrics: Mapping[str, Metric]) -> dict[str, str]:
    """Return the unit of each metric that has one."""
    return {name: unit for name, metric in metrics.items() if (unit := info_of(name, metric=metric).unit)}


def most_failures(pedestrians: int) -> int:
    """Return the largest number of failures to record. It is smaller for crowds so large that recording would take
    longer than driving."""
    return max(1, MOST_FAILURES * RECORDED_CROWD // max(pedestrians, RECORDED_CROWD))
