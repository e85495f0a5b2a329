"""A trial before a run: one case with a standing vehicle, so that a faulty plug-in is named before the long work."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from crowdbench.core.types import Trace
from crowdbench.envs.rewards import CheckedReward
from crowdbench.envs.stepping import drive
from crowdbench.metrics.registry import METRICS, OF_FLEETS, Metric
from crowdbench.metrics.user_metrics import measure
from crowdbench.planners.driver import Driver
from crowdbench.runs.replay import Playback
from crowdbench.runs.rollout import rollout
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario
from crowdbench.sim.fleet import in_whole_worlds
from crowdbench.views.view import View


def trial_trace(scenario: Scenario, cases: Cases) -> Trace:
    """Return the trace of the first case with a vehicle that stands still, on which plug-ins can be tried.

    Args:
        scenario: The scenario.
        cases: The cases of the run.

    Raises:
        InputError: A layout or a pedestrian policy fails. The message names the case.
    """
    first = next(cases.batches(1))
    stand = Playback(np.zeros((scenario.rules.vehicles, scenario.rules.max_steps, 2)))
    return rollout(Driver(stand, "of the trial"), scenario, first)


def try_reward(reward: CheckedReward, scenario: Scenario) -> None:
    """Simulate a training case with a vehicle that stands still, and compute the reward of each step.

    Raises InputError if the reward, the layout or a pedestrian policy fails.
    """
    world, view = scenario.draw("train", np.zeros(1, np.int64)), View(scenario, action="velocity")
    while len(world):
        step = drive(view, world, np.zeros((len(world), 2)))
        reward(step)
        world = step.after.take(in_whole_worlds(~step.ended, scenario.rules.vehicles))


def try_plugins(scenario: Scenario, cases: Cases, metrics: Mapping[str, Metric]) -> None:
    """Simulate the trial if a layout or a pedestrian policy is in a file of the user, and measure the user's metrics.

    Args:
        scenario: The scenario.
        cases: The cases of the run.
        metrics: All metrics by name.

    Raises:
        InputError: A layout, a policy or a metric fails.
    """
    of_user = {name: metric for name, metric in metrics.items() if name not in METRICS | OF_FLEETS}
    if scenario.has_files or of_user:
        trace = trial_trace(scenario, cases)
        for name, metric in of_user.items():
            measure(name, metric, trace)
