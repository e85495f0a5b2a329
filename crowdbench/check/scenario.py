"""Checks what can be seen of a scenario before it is used: whether its cases start, end, and are the same again."""

from __future__ import annotations

from collections import Counter

import numpy as np

from crowdbench.check.layout import check_layout
from crowdbench.check.result import CheckResult
from crowdbench.core.types import Outcome, Trace
from crowdbench.planners.driver import Driver
from crowdbench.planners.reactive import ORCAPlanner
from crowdbench.runs.rollout import rollout
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario
from crowdbench.utils.errors import InputError


def check_scenario(scenario: Scenario, cases: Cases) -> list[CheckResult]:
    """Start and drive some cases of a scenario; where it has a layout, its contract is examined first.

    Args:
        scenario: The scenario.
        cases: The cases.
    """
    results = [] if scenario.layout is None else check_layout(scenario.layout, scenario.name, scenario, cases)
    try:
        together = _drive(scenario, cases)
        alone = [_drive(scenario, Cases(cases.split, case, case + 1)) for case in range(cases.start, cases.stop)]
    except InputError as error:
        return [*results, CheckResult("episodes", False, str(error))]
    ends = Counter(Outcome(outcome).label for outcome in together.outcome.tolist())
    seen = ", ".join(f"{count} {label}" for label, count in ends.most_common())
    steps = np.array([trace.steps[0] for trace in alone])
    differing = int((steps != together.steps).sum())
    return [
        *results,
        CheckResult("episodes", True, f"driven by ORCA: {seen}"),
        CheckResult("batch", not differing, f"{differing} of {len(cases)} episodes differ when a case runs alone"),
    ]


def _drive(scenario: Scenario, cases: Cases) -> Trace:
    return rollout(Driver(ORCAPlanner(), "orca"), scenario, cases, undisturbed=False)
