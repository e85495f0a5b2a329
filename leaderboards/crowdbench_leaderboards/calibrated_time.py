"""Measures the time per decision of an entry's planner, in a single world and on one core.

The time of a decision never changes a command. The planner drives ranked cases again, one world at a time, and its
commands must be the same. It does not receive its earlier commands. Its process and all child processes run on one
core, and their processor time is measured. The time on other machines is estimated with a fixed workload, the
calibration kernel. It is timed on the same core while the planner does not run.
"""

from __future__ import annotations

import os
import random
import statistics
import timeit
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from crowdbench import Cases
from crowdbench.isolation import usable_cores
from crowdbench.results import COMMANDS, read_commands
from crowdbench_leaderboards.board_runs import CaseSet, EntryPlanner, driven_scenarios
from crowdbench_leaderboards.decision_time import SAME_COMMANDS, time_single_world
from crowdbench_leaderboards.verdict import DecisionTime

KERNEL = "python-loop-and-sort-1"
"""The name of the calibration kernel. Another kernel or reference machine gets another name."""

REFERENCE_MS = 25.0
"""Milliseconds of the kernel on the reference machine, by definition: about one core of a rented server of 2026."""

TIMED = 11
"""Number of timed cases; the first one is a warm-up and does not count."""

MIN_SAME = 0.99
"""Smallest share of decisions that must be the same as in the ranked cases."""


class NotTimed(Exception):
    """Raised if the decisions of a planner cannot be timed. The message states the reason."""


def time_decisions(planner: EntryPlanner, case_set: CaseSet, runs: Path) -> DecisionTime:
    """Time the decisions of a planner in the first scenario of a board that it drives, one world at a time.

    Args:
        planner: The planner.
        case_set: The ranked cases, of which the first `TIMED` are timed.
        runs: The folder of the planner's runs of these cases.

    Raises:
        NotTimed: The planner's decisions differ from those in the runs.
        InputError: See `time_single_world`.
    """
    board, cases = case_set.board, case_set.cases
    name = driven_scenarios(board, runs)[0]
    scenario = next(scenario for scenario in case_set.scenarios if scenario.name == name)
    recorded = read_commands(runs / name / COMMANDS)
    timed = Cases(cases.split, cases.start, min(cases.stop, cases.start + TIMED))
    core = random.sample(usable_cores(), k=min(1, len(usable_cores())))
    before = kernel_seconds(core)
    with planner.start(scenario, core) as isolated:
        asked = isolated, isolated.name, scenario, board.replanning, timed, recorded
        seconds, is_same = time_single_world(*asked, processor=isolated.process.usage.seconds)
    kernel_ms = 1e3 * (before + kernel_seconds(core)) / 2.0
    same = float(np.mean(is_same)) if len(is_same) else 0.0
    if same < MIN_SAME:
        raise NotTimed(
            f"not timed: in one world alone, {100 * same:.1f} % of its decisions are within {SAME_COMMANDS:g} m/s of "
            f"those in the ranked cases, but {100 * MIN_SAME:g} % must be"
        )
    p99 = 1e3 * float(np.percentile(seconds, 99))
    calibrated = p99 * REFERENCE_MS / kernel_ms
    return DecisionTime(
        p99_ms=p99,
        kernel=KERNEL,
        kernel_ms=kernel_ms,
        calibrated_p99_ms=calibrated,
        is_real_time=calibrated <= 1e3 * scenario.rules.dt,
    )


def kernel_seconds(core: Sequence[int] = ()) -> float:
    """Return the median time of five runs of the calibration kernel: a loop of Python, and sorting in NumPy.

    Args:
        core: The core to run on; any if it is empty.
    """

    def work() -> None:
        total = 0
        for number in range(300_000):
            total += number * number & 255
        values = np.random.Generator(np.random.Philox(1)).random(300_000)
        np.sort(values)

    cores = usable_cores()
    if core:
        os.sched_setaffinity(0, core)
    try:
        return statistics.median(timeit.repeat(work, number=1, repeat=5))
    finally:
        if core:
            os.sched_setaffinity(0, cores)
