"""One run: a planner through the cases of a scenario, measured and written to a directory."""

from __future__ import annotations

import contextlib
import importlib.metadata
import json
import platform
import re
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from crowdbench.evaluate.directory import new_directory
from crowdbench.evaluate.driver import Driver
from crowdbench.evaluate.metrics import Metric
from crowdbench.evaluate.results import EPISODES, RECORDING, RESULT, Episodes, planner_label, to_json
from crowdbench.evaluate.rollout import rollout
from crowdbench.interrupts import Interrupts
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario
from crowdbench.settings import BATCH, FIRST_RECORDED, MOST_FAILURES
from crowdbench.types import Outcome, Trace

MEMORY = 256e6
"""Bytes that the traces of a batch may take: long or crowded episodes run in smaller batches."""


@dataclass(frozen=True)
class Finished:
    """What a run left: its result, as in `result.json`, and whether it was interrupted before its last case."""

    result: dict[str, Any]
    interrupted: bool


def run(
    driver: Driver,
    scenario: Scenario,
    cases: Cases,
    out: Path,
    *,
    metrics: Mapping[str, Metric],
    about: Mapping[str, Any],
    replan_every: int = 1,
    record: str = "failures",
    batch: int = BATCH,
    overwrite: bool = False,
    progress: Callable[[int], None] | None = None,
) -> Finished:
    """Drive, measure and write `result.json`, `episodes.csv` and, unless `record` is "none", `run.rrd`.

    `about` goes into the result as it is; `replan_every` is `rollout`'s. An interrupt (Ctrl-C) keeps the batches that
    are finished, if any, or else raises KeyboardInterrupt: they are the first cases, so their rates are not biased
    towards short episodes. Raises InputError, leaving nothing behind, where anything breaks its contract or `out`
    cannot be written.
    """
    start = time.perf_counter()
    label = planner_label(driver.name, about.get("options", {}), replan_every)
    with Interrupts() as interrupts, new_directory(out, overwrite) as directory:
        with _recorder(record, directory / RECORDING, label, scenario, len(cases)) as keep:
            parts: list[Episodes] = []
            recorded = 0
            for part in cases.batches(_fitting(batch, scenario)):
                try:
                    with interrupts.let_through():
                        trace = rollout(
                            driver,
                            scenario,
                            part,
                            replan_every=replan_every,
                            keep_logs=record != "none",
                            progress=progress,
                        )
                except KeyboardInterrupt:
                    if not parts:
                        raise
                    break
                parts.append(Episodes.of(trace, metrics))
                recorded += keep(trace, parts[-1], part.start - cases.start)
        episodes = Episodes.joined(parts)
        result = {
            "planner": driver.name,
            "privileged": driver.planner.privileged,
            "planner_facts": dict(driver.planner.facts),
            "replan_every": replan_every,
            **about,
            "scenario": {"name": scenario.name, "digest": scenario.digest, **scenario.table},
            "cases": str(Cases(cases.split, cases.start, cases.start + len(episodes))),
            "recorded": recorded,
            "outcomes": {outcome.label: int((episodes.outcome == outcome).sum()) for outcome in list(Outcome)[1:]},
            "metrics": to_json(episodes.summary()),
            "timing": {
                "decision_ms_per_step": 1e3 * driver.seconds / int(episodes.steps.sum()),
                "seconds": time.perf_counter() - start,
            },
            "versions": _versions(),
        }
        episodes.write(directory / EPISODES)
        (directory / RESULT).write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    return Finished(result, interrupted=len(episodes) < len(cases))


def _versions() -> dict[str, str]:
    packages = {name: importlib.metadata.version(name) for name in ("crowdbench", "numpy", "numba")}
    return {"python": platform.python_version(), **packages}


def directory_name(planner: str, scenario: str, cases: Cases, changes: Mapping[str, Any]) -> str:
    """The name of a run's directory, other for other cases, options and overrides: `orca-circle_crossing_5-500`."""
    count = f"{cases.stop}" if cases.start == 0 else f"{cases.start}-{cases.stop}"
    parts = [planner, scenario, count if cases.split == "test" else f"{cases.split}-{count}"]
    parts += [f"{key}={value}" for key, value in changes.items()]
    # File systems allow 255 bytes, and the directory has a longer name while it is written.
    return re.sub(r"[^A-Za-z0-9_.=-]+", "_", "-".join(parts))[:200]


def _fitting(batch: int, scenario: Scenario) -> int:
    # Positions and velocities of every state, and as much again for what metrics make of them.
    each = 8 * 2 * 4 * (scenario.rules.max_steps + 1) * scenario.max_agents
    return max(1, min(batch, int(MEMORY / each)))


Keep = Callable[[Trace, Episodes, int], int]


@contextlib.contextmanager
def _recorder(record: str, path: Path, planner: str, scenario: Scenario, cases: int) -> Iterator[Keep]:
    """Gives a function that records the wanted episodes of a batch, whose first case is number `offset` of the run,
    and tells how many there were.
    """
    if record == "none":
        yield lambda trace, episodes, offset: 0
        return
    from crowdbench.record.write import Recorder

    with Recorder(
        path, planner=planner, scenario=scenario.name, scenario_digest=scenario.digest, cases=cases
    ) as recorder:
        failures = 0

        def keep(trace: Trace, episodes: Episodes, offset: int) -> int:
            nonlocal failures
            failed = trace.outcome != Outcome.SUCCESS
            wanted = failed & (failures + np.cumsum(failed) <= MOST_FAILURES) | (record == "all")
            wanted[: max(0, FIRST_RECORDED - offset)] = True
            failures += int(failed.sum())
            recorder.add(trace, np.flatnonzero(wanted), episodes.columns)
            return int(wanted.sum())

        yield keep
