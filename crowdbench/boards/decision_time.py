"""How long an entry's planner takes for its decisions, in one world alone and on one core.

The time of a decision never changes a command. It is that of decisions which count: the planner is shown again, one
world at a time, what it saw in ranked cases, and must decide the same. What a slower or faster machine would measure is
estimated by a fixed piece of work, the calibration kernel, that is timed on the same core while the planner is stopped.
"""

from __future__ import annotations

import statistics
import timeit

import numpy as np

from crowdbench.boards.verdict import DecisionTime
from crowdbench.isolation.planner import IsolatedPlanner
from crowdbench.runs.decision_time import SAME, decide_alone
from crowdbench.runs.recording import Commands
from crowdbench.runs.spec import Replanning
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario

KERNEL = "python-loop-and-sort-1"
"""The name of the calibration kernel. Another kernel or machine of reference gets another name."""

REFERENCE_MS = 25.0
"""What the kernel takes on the machine of reference, by definition: about one core of a rented server of 2026."""

TIMED = 11
"""How many cases are timed; the first one warms up and does not count."""

LEAST_SAME = 0.99
"""The share of decisions that must be as in the ranked cases."""

MOST_CORES = 1.1
"""A planner that takes more seconds of processors than this, for each second that it is waited for, is not timed."""


def time_decisions(
    planner: IsolatedPlanner, scenario: Scenario, replanning: Replanning, cases: Cases, ranked: Commands
) -> DecisionTime | str:
    """Time the decisions of a planner, one world at a time.

    Args:
        planner: The planner.
        scenario: The scenario.
        replanning: When it observes.
        cases: The cases that rank, of which the first `TIMED` are timed.
        ranked: Their commands.

    Returns:
        The time, or why there is none, in a sentence.

    Raises:
        InputError: See `decide_alone`.
    """
    process = planner.process
    core = process.pin()
    timed = Cases(cases.split, cases.start, min(cases.stop, cases.start + TIMED))
    with process.stopped(core):
        before = kernel_seconds()
    processor, waited = process.processor_seconds(), process.seconds
    seconds, is_same = decide_alone(planner, planner.name, scenario, replanning, timed, ranked)
    processor, waited = process.processor_seconds() - processor, process.seconds - waited
    with process.stopped(core):
        kernel_ms = 1e3 * (before + kernel_seconds()) / 2.0
    if not len(is_same) or np.mean(is_same) < LEAST_SAME:
        share = 100 * float(np.mean(is_same)) if len(is_same) else 0.0
        where = f"{share:.1f} % of its decisions are within {SAME:g} m/s of those in the ranked cases"
        return f"not timed: in one world alone, {where}, but {100 * LEAST_SAME:g} % must be"
    if processor > MOST_CORES * waited + 1.0:
        return f"not timed: it took {processor:.1f} s of processors in {waited:.1f} s, but one core is allowed"
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
    """The median time in seconds, of five tries, of the calibration kernel: a loop of Python, and sorting in NumPy."""

    def work() -> None:
        total = 0
        for number in range(300_000):
            total += number * number & 255
        values = np.random.Generator(np.random.Philox(1)).random(300_000)
        np.sort(values)

    return statistics.median(timeit.repeat(work, number=1, repeat=5))
