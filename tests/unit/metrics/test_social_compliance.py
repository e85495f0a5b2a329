"""Check that cutting an episode off never improves a measure of social compliance."""

import dataclasses

import numpy as np
import pytest
from helpers import drive

from crowdbench.core.types import Outcome
from crowdbench.metrics.registry import METRICS, SUBJECTS, info_of

AS_PUBLISHED = {"discomfort_frequency", "intrusion_time_ratio", "social_distance"}
"""Over all episodes, as in the published tables they are compared with: their docstrings say what an early end does."""

SOCIAL = [
    name
    for subject in ("gap", "zone", "intrusion", "encounter", "passing", "cost to pedestrians")
    for name in (metric.__name__ for metric in SUBJECTS[subject])
    if name not in AS_PUBLISHED | {"clearing_distance"} and info_of(name).better
]


@pytest.fixture(scope="module", params=["circle_crossing_5_visible", "groups_12"])
def episodes(request):
    trace = drive("orca", "val:6", request.param)
    assert (trace.outcome == Outcome.SUCCESS).any()
    return trace


def cut(trace, share, outcome):
    """The episodes without what is after a share of their steps, ended by an outcome."""
    steps = np.maximum((share * trace.steps).astype(int), 1)
    changes = {"steps": steps, "outcome": np.full(len(trace), outcome)}
    for name in ("position", "velocity", "heading", "command", "gap", "wall_gap", "undisturbed"):
        values = getattr(trace, name).copy()
        is_step = name in ("command", "gap", "wall_gap")
        values[np.arange(values.shape[1]) > (steps - is_step)[:, None]] = np.nan
        changes[name] = values
    return dataclasses.replace(trace, **changes)


def count_improved(name, whole, part):
    """The number of episodes in which the metric is defined in both, and better in the second one."""
    sign = info_of(name).sign
    assert sign != 0
    return int((sign * (METRICS[name](part) - METRICS[name](whole)) > 1e-12).sum())


@pytest.mark.parametrize("name", SOCIAL)
def test_cutting_an_episode_off_never_improves_a_measure_of_social_compliance(name, episodes):
    for share in (0.1, 0.25, 0.5, 0.75, 0.9):
        for outcome in (Outcome.COLLISION, Outcome.TIMEOUT):
            assert count_improved(name, episodes, cut(episodes, share, outcome)) == 0


def test_an_early_end_improves_measures_over_all_episodes(episodes):
    # This shows that the check above can fail, and why it leaves out the published definitions.
    early = cut(episodes, 0.1, Outcome.COLLISION)
    assert all(count_improved(name, episodes, early) > 0 for name in AS_PUBLISHED - {"social_distance"})
    as_success = dataclasses.replace(early, outcome=episodes.outcome)
    assert all(
        count_improved(name, episodes, as_success) > 0 for name in ("minimum_gap", "personal_zone", "deflection")
    )
