"""One run: a planner drives the cases of a scenario, and what was measured is written to a directory."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from crowdbench.errors import Interrupted
from crowdbench.evaluate import parts
from crowdbench.evaluate.driver import Driver
from crowdbench.evaluate.metrics import Metric
from crowdbench.evaluate.parts import Parts
from crowdbench.evaluate.replanning import EVERY_STEP, Replanning
from crowdbench.evaluate.results import RESULT
from crowdbench.evaluate.seal import code
from crowdbench.evaluate.shard import WHOLE, Shard
from crowdbench.evaluate.wanted import Wanted
from crowdbench.files import read_json
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario
from crowdbench.settings import BATCH, RECORD


@dataclass(frozen=True)
class Finished:
    """What a run has written.

    Attributes:
        result: The contents of `result.json`; None where parts are missing that other processes make.
        cases: How many of its cases are there.
        folder: Where its parts are until all are there.
    """

    result: dict[str, Any] | None
    cases: int
    folder: Path


def run(
    driver: Driver,
    scenario: Scenario,
    cases: Cases,
    out: Path,
    *,
    metrics: Mapping[str, Metric],
    about: Mapping[str, Any],
    asked: Mapping[str, Any] | None = None,
    replanning: Replanning = EVERY_STEP,
    record: str = RECORD[0],
    batch: int = BATCH,
    shard: Shard = WHOLE,
    overwrite: bool = False,
    progress: Callable[[float], None] | None = None,
) -> Finished:
    """Drive a planner through cases, measure, and write `result.json`, `episodes.csv` and what is recorded.

    What is recorded are the commands of all cases in `commands.parquet`, and episodes in `run.rrd`. At the end,
    `manifest.json` gets the sha256 of all these files: see `crowdbench.evaluate.seal`.

    A run is made part by part, a batch each: see `crowdbench.evaluate.parts`. After an interrupt, the same call goes
    on with what is missing.

    Args:
        driver: Asks the planner for commands.
        scenario: The scenario of the cases.
        cases: The cases.
        out: The directory to write.
        metrics: What is measured, by name.
        about: More that `result.json` says of the run.
        asked: More that `manifest.json` says of what was asked for, such as the scenario's file.
        replanning: When the planner observes, as in `rollout`.
        record: What is recorded, one of `settings.RECORD`.
        batch: Cases that run in lock-step, fewer where their traces would take too much memory.
        shard: Which share of the batches is run.
        overwrite: Whether an earlier run in `out` is replaced.
        progress: Called after each step with what it added to the episodes, in parts of an episode.

    Returns:
        What is there.

    Raises:
        InputError: Planner, scenario or a metric break their contract, or `out` cannot be written. Nothing is kept
            of the batch in which it happens.
        KeyboardInterrupt: Interrupted. The batches that are finished are kept.
    """
    wanted = Wanted(driver, scenario, cases, metrics, about, asked or {}, replanning, record, batch)
    return make(wanted, out, shard=shard, overwrite=overwrite, progress=progress)


def make(
    wanted: Wanted,
    out: Path,
    *,
    shard: Shard = WHOLE,
    overwrite: bool = False,
    wait: bool = True,
    progress: Callable[[float], None] | None = None,
) -> Finished:
    """Make a run, as `run` does.

    Args:
        wanted: What was asked for.
        out: The directory to write.
        shard: Which share of the batches is run.
        overwrite: Whether an earlier run in `out` is replaced.
        wait: Whether to wait for batches that other processes are making.
        progress: As `run` calls it.

    Returns:
        What is there.

    Raises:
        InputError: As `run` raises it.
        KeyboardInterrupt: As `run` raises it.
    """
    code()  # before somebody changes it

    def drive(part: Cases, directory: Path) -> None:
        interrupted = wanted.drive(part, directory, progress)
        if interrupted and part != wanted.cases:  # it came while the part was written, and others are left
            raise Interrupted

    made = parts.make(drive, parts_of(wanted, out), shard, overwrite=overwrite, wait=wait, progress=progress)
    return Finished(read_json(out / RESULT) if made.is_whole else None, made.cases, made.folder)


def parts_of(wanted: Wanted, out: Path) -> Parts:
    """The parts of a run.

    Args:
        wanted: The run.
        out: Its directory.
    """
    return Parts.of(wanted.cases, out, wanted.depends, wanted.batch)


def directory_name(planner: str, scenario: str, cases: Cases, changes: Mapping[str, Any]) -> str:
    """The name of a run's directory, such as `orca-circle_crossing_5-500`.

    Args:
        planner: The planner's name.
        scenario: The scenario's name.
        cases: The cases.
        changes: Options and overrides; other ones give another name.
    """
    count = f"{cases.stop}" if cases.start == 0 else f"{cases.start}-{cases.stop}"
    parts = [planner, scenario, count if cases.split == "test" else f"{cases.split}-{count}"]
    parts += [f"{key}={value}" for key, value in changes.items()]
    # File systems allow 255 bytes, and the directory has a longer name while it is written.
    return re.sub(r"[^A-Za-z0-9_.=-]+", "_", "-".join(parts))[:200]
