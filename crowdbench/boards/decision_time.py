"""How long a planner takes to decide in one world alone, on one core, and whether that is in time.

The time of a decision never changes a command. What a slower or faster machine would measure is estimated by a fixed
piece of work, the calibration kernel, that is timed on the same core.
"""

from __future__ import annotations

import dataclasses
import time

import numpy as np

from crowdbench.boards.entry import DecisionTime
from crowdbench.evaluate.decision_time import decision_seconds
from crowdbench.evaluate.replanning import Replanning
from crowdbench.planners.base import Planner
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario

KERNEL = "python-loop-and-sort-1"
"""The name of the calibration kernel. Another kernel or machine of reference gets another name."""

REFERENCE_MS = 25.0
"""What the kernel takes on the machine of reference, by definition: about one core of a rented server of 2026."""

CASES = Cases("val", 0, 11)
"""The cases that are timed, see `decision_seconds`; as many of them as there are where cars were recorded."""


def decision_time(planner: Planner, name: str, scenario: Scenario, replanning: Replanning) -> DecisionTime:
    """Time the decisions of a planner, one world at a time.

    Args:
        planner: The planner, on one core.
        name: What it is called in errors.
        scenario: The scenario.
        replanning: When it observes.

    Returns:
        What was measured.

    Raises:
        InputError: See `decision_seconds`.
    """
    most = scenario.tracks.most_cases(CASES.split) if scenario.tracks else None
    cases = CASES if most is None else dataclasses.replace(CASES, stop=min(CASES.stop, most))
    before = kernel_seconds()
    seconds = decision_seconds(planner, name, scenario, replanning, cases)
    kernel_ms = 1e3 * (before + kernel_seconds()) / 2.0
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

    tries = []
    for _ in range(5):
        start = time.perf_counter()
        work()
        tries.append(time.perf_counter() - start)
    return sorted(tries)[2]
