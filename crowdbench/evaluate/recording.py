"""What a run records while it goes on: the commands of all cases, and episodes for the viewer."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from crowdbench.evaluate.metrics import Metric, unit_of
from crowdbench.evaluate.results import Episodes
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario
from crowdbench.settings import FIRST_RECORDED, MOST_FAILURES, RECORDED_CROWD, WITH_EPISODES
from crowdbench.types import Outcome, Trace

Keep = Callable[[Trace, Episodes], int]


@contextlib.contextmanager
def recorder(
    record: str,
    path: Path,
    planner: str,
    scenario: Scenario,
    cases: Cases,
    metrics: Mapping[str, Metric],
    *,
    options: Mapping[str, Any],
    identity: str,
) -> Iterator[Keep]:
    """The recorder of a run: a function that records the wanted episodes of a batch and returns their number.

    Args:
        record: Which episodes are wanted, one of `settings.RECORD`.
        path: The recording.
        planner: The planner's name with its options.
        scenario: The scenario.
        cases: The cases of the whole run.
        metrics: The metrics that are measured.
        options: The planner's options.
        identity: What tells the run from others.
    """
    if record not in WITH_EPISODES:
        yield lambda trace, episodes: 0
        return
    from crowdbench.record.write import Recorder

    with Recorder(
        path,
        planner=planner,
        scenario=scenario.name,
        scenario_digest=scenario.digest,
        cases=len(cases),
        options=options,
        units=units_of(metrics),
        identity=identity,
        all_decisions=record == "all",
    ) as writer:
        failures, most = 0, fewer_of_many(MOST_FAILURES, scenario.number[1])

        def keep(trace: Trace, episodes: Episodes) -> int:
            nonlocal failures
            failed = trace.outcome != Outcome.SUCCESS
            wanted = failed & (failures + np.cumsum(failed) <= most) | (record == "all")
            wanted |= trace.case < cases.start + FIRST_RECORDED
            failures += int(failed.sum())
            writer.add(trace, np.flatnonzero(wanted), episodes.columns)
            return int(wanted.sum())

        yield keep


def units_of(metrics: Mapping[str, Metric]) -> dict[str, str]:
    """The unit of each metric that has one."""
    return {name: unit for name, metric in metrics.items() if (unit := unit_of(metric))}


def fewer_of_many(failures: int, pedestrians: int) -> int:
    """How many failures are recorded.

    Args:
        failures: How many it is where pedestrians are not many.
        pedestrians: The largest number of pedestrians in the scenario.
    """
    return max(1, failures * RECORDED_CROWD // max(pedestrians, RECORDED_CROWD))


@contextlib.contextmanager
def command_writer(record: str, directory: Path) -> Iterator[Callable[[Trace], None]]:
    """A function that keeps the commands of a batch.

    Args:
        record: What is recorded: `none` keeps no commands either.
        directory: Where they are kept.
    """
    if record == "none":
        yield lambda trace: None
        return
    from crowdbench.evaluate.commands import COMMANDS, writing

    with writing(directory / COMMANDS) as write:
        yield write
