"""What a run records while it goes on: the commands of all cases, and episodes for the viewer."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from crowdbench.core.types import Outcome, Trace
from crowdbench.metrics import Metric, unit_of
from crowdbench.runs.results import RECORDING, Episodes
from crowdbench.scenario.cases import Cases
from crowdbench.utils.defaults import FIRST_RECORDED, MOST_FAILURES, RECORDED_CROWD, WITH_EPISODES

if TYPE_CHECKING:
    from crowdbench.record.write import Recorder


@dataclass
class RunRecorder:
    """Records the commands of all traces that are added, and the episodes of failures and of the first cases.

    Attributes:
        cases: The cases of the whole run.
        most_failures: How many failures are recorded at most; None for all episodes.
        write_commands: Writes the commands of a trace, if they are kept.
        recorder: Writes episodes, if any are recorded.
        failures: How many failures there were.
        number: How many episodes were recorded.
    """

    cases: Cases
    most_failures: int | None
    write_commands: Callable[[Trace], None] | None = None
    recorder: Recorder | None = None
    failures: int = 0
    number: int = 0

    def add(self, trace: Trace, episodes: Episodes) -> None:
        """Record a batch of episodes, as far as they are recorded."""
        if self.write_commands is not None:
            self.write_commands(trace)
        if self.recorder is None:
            return
        chosen = np.ones(len(trace), bool)
        if self.most_failures is not None:
            failed = trace.outcome != Outcome.SUCCESS
            chosen = failed & (self.failures + np.cumsum(failed) <= self.most_failures)
            chosen |= trace.case < self.cases.start + FIRST_RECORDED
            self.failures += int(failed.sum())
        self.recorder.add(trace, np.flatnonzero(chosen), episodes.columns)
        self.number += int(chosen.sum())


@contextlib.contextmanager
def open_recorder(
    record: str, folder: Path, cases: Cases, pedestrians: int, header: Mapping[str, Any]
) -> Iterator[RunRecorder]:
    """Record a run in a folder.

    Args:
        record: What is recorded, one of `defaults.RECORD`.
        folder: The folder.
        cases: The cases of the whole run.
        pedestrians: The largest number of pedestrians in a case.
        header: What the recording says of the run, as the parameters of `Recorder`.
    """
    with contextlib.ExitStack() as stack:
        recording = RunRecorder(cases, None if record == "all" else most_failures(pedestrians))
        if record in WITH_EPISODES:
            from crowdbench.record.write import Recorder

            recording.recorder = stack.enter_context(Recorder(folder / RECORDING, **header))
        if record != "none":
            from crowdbench.runs.commands import COMMANDS, open_writer

            recording.write_commands = stack.enter_context(open_writer(folder / COMMANDS))
        yield recording


def units_of(metrics: Mapping[str, Metric]) -> dict[str, str]:
    """The unit of each metric that has one."""
    return {name: unit for name, metric in metrics.items() if (unit := unit_of(metric))}


def most_failures(pedestrians: int) -> int:
    """How many failures are recorded: fewer in crowds so large that recording would take longer than driving."""
    return max(1, MOST_FAILURES * RECORDED_CROWD // max(pedestrians, RECORDED_CROWD))
