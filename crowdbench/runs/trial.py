"""A trial before a run: one case with a standing vehicle, so that a faulty plug-in is named before the long work."""

from __future__ import annotations

import numpy as np

from crowdbench.core.types import Trace
from crowdbench.planners.driver import Driver
from crowdbench.runs.replay import Playback
from crowdbench.runs.rollout import rollout
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario


def trial_trace(scenario: Scenario, cases: Cases) -> Trace:
    """Return the trace of the first case with a vehicle that stands still, on which plug-ins can be tried.

    Args:
        scenario: The scenario.
        cases: The cases of the run.

    Raises:
        InputError: A layout or a pedestrian policy fails. The message names the case.
    """
    first = next(cases.batches(1))
    stand = Playback(np.zeros((1, scenario.rules.max_steps, 2)))
    return rollout(Driver(stand, "of the trial"), scenario, first)


def try_scenario(scenario: Scenario, cases: Cases) -> None:
    """Simulate the trial if a layout or a pedestrian policy of the scenario is in a file of the user.

    Raises InputError as `trial_trace` does.
    """
    if scenario.table["pedestrians"]["policy_files"] or scenario.table.get("layout", {}).get("generator_file"):
        trial_trace(scenario, cases)
