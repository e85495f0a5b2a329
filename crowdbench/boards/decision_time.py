"""The time that an entry's planner takes for a decision, in one world alone and on one core.

The time of a decision never changes a command. The planner is shown again, one world at a time, what it saw in ranked
cases, and must decide the same. The time on other machines is estimated by a fixed piece of work, the calibration
kernel, which is timed on the same core while the planner is stopped.
"""

from __future__ import annotations

import statistics
import timeit
from pathlib import Path

import numpy as np

from crowdbench.boards.board_runs import CaseSet, EntryPlanner, driven_scenarios
from crowdbench.boards.verdict import DecisionTime
from crowdbench.runs.decision_time import SAME, decide_alone
from crowdbench.runs.recording import COMMANDS, read_commands
from crowdbench.scenario.cases import Cases

KERNEL = "python-loop-and-sort-1"
"""The name of the calibration kernel. Another kernel or machine of reference gets another name."""

REFERENCE_MS = 25.0
"""Milliseconds of the kernel on the machine of reference, by definition: about one core of a rented server of 2026."""

TIMED = 11
"""How many cases are timed; the first one warms up and does not count."""

MIN_SAME = 0.99
"""The share of decisions that must be as in the ranked cases."""

MAX_CORES = 1.1
"""Seconds of processors for each second of waiting, at most; a planner that takes more is not timed."""


class NotTimed(Exception):
    """The decisions of a planner cannot be timed. The message says why."""


def time_decisions(planner: EntryPlanner, case_set: CaseSet, runs: Path) -> DecisionTime:
    """Time the decisions of a planner in the first scenario of a board that it drives, one world at a time.

    Args:
        planner: The planner.
        case_set: The cases that rank, of which the first `TIMED` are timed.
        runs: The folder of the planner's runs of these cases.

    Raises:
        NotTimed: The planner decides otherwise than in the runs, or takes more than one core.
        InputError: See `decide_alone`.
    """
    board, cases = case_set.board, case_set.cases
    name = driven_scenarios(board, runs)[0]
    scenario = next(scenario for scenario in case_set.scenarios if scenario.name == name)
    recorded = read_commands(runs / name / COMMANDS)
    timed = Cases(cases.split, cases.start, min(cases.stop, cases.start + TIMED))
    with planner.start(scenario) as isolated:
        process = isolated.process
        core = process.pin()
        with process.stopped(core):
            before = kernel_seconds()
        processor, waited = process.processor_seconds(), process.seconds
        seconds, is_same = decide_alone(isolated, isolated.name, scenario, board.replanning, timed, recorded)
        processor, waited = process.processor_seconds() - processor, process.seconds - waited
        with process.stopped(core):
            kernel_ms = 1e3 * (before + kernel_seconds()) / 2.0
    same = float(np.mean(is_same)) if len(is_same) else 0.0
    if same < MIN_SAME:
        raise NotTimed(
            f"not timed: in one world alone, {100 * same:.1f} % of its decisions are within {SAME:g} m/s of those in "
            f"the ranked cases, but {100 * MIN_SAME:g} % must be"
        )
    if processor > MAX_CORES * waited + 1.0:
        raise NotTimed(f"not timed: it took {processor:.1f} s of processors in {waited:.1f} s, but one core is allowed")
    p99 = 1e3 * float(np.percentile(seconds, 99))
    calibrated = p99 * REFERENCE_MS / kernel_ms
    return DecisionTime(
        p99_ms=p99,
        kernel=KERNEL,
        kernel_ms=kernel_ms,
        calibrated_p99_ms=calibrated,
        is_real_time=calibrated <= 1e3 * scenario.rules.dt,
    )


def kernel_seconds() -> float:
    """Return the median time of five runs of the calibration kernel: a loop of Python, and sorting in NumPy."""

    def work() -> None:
        total = 0
        for number in range(300_000):
            total += number * number & 255
        values = np.random.Generator(np.random.Philox(1)).random(300_000)
        np.sort(values)

    return statistics.median(timeit.repeat(work, number=1, repeat=5))
