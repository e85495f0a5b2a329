"""The simulator against CrowdNav's own episodes."""

import numpy as np
import pytest
from helpers import drive

from crowdbench.core.types import Outcome


@pytest.mark.parametrize(
    ("recorded", "scenario"),
    [
        ("crowdnav_circle5_orca_invisible", "circle_crossing_5"),
        ("crowdnav_circle5_orca_visible", "circle_crossing_5_visible"),
        ("crowdnav_square5_orca_invisible", "square_crossing_5"),
    ],
)
def test_episodes_are_crowdnavs(reference, recorded, scenario):
    data = reference(recorded)
    worlds = len(data["case"])
    trace = drive("orca", str(worlds), scenario, collision="crowdnav")
    last = data["info"][np.arange(worlds), data["length"] - 1]
    assert (trace.outcome == last).mean() >= 0.995
    assert np.array_equal(trace.goal[:, 0], data["goal"])
    both = min(trace.position.shape[1], data["position"].shape[1])
    error = np.abs(trace.position[:, :both] - data["position"][:, :both])
    assert np.nanmedian(error) < 1e-4


def test_rewards_and_gaps_are_crowdnavs(reference):
    from crowdbench.core.reward import reward

    data = reference("crowdnav_circle5_orca_invisible")
    trace = drive("orca", "100", collision="crowdnav")
    same_length = trace.steps == data["length"]
    assert same_length.mean() >= 0.97
    steps = np.arange(trace.gap.shape[1])
    outcome = np.where(steps == trace.steps[:, None] - 1, trace.outcome[:, None], Outcome.RUNNING)
    ours, theirs = reward(outcome, trace.gap, 0.25), data["reward"]
    both = min(ours.shape[1], theirs.shape[1])
    running = (steps < trace.steps[:, None])[same_length, :both]
    error = np.abs(ours[same_length, :both] - theirs[same_length, :both])[running]
    assert np.quantile(error, 0.99) < 1e-4
    close = (data["info"] == 4)[same_length, :both] & running
    gap_error = np.abs(trace.gap[same_length, :both] - data["danger_distance"][same_length, :both])[close]
    assert close.sum() > 500
    assert np.quantile(gap_error, 0.95) < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scenario", "collision", "success", "time"),
    [
        ("circle_crossing_5", "crowdnav", 0.426, 10.86),
        ("circle_crossing_5", "swept", 0.424, 10.86),
        ("circle_crossing_10", "crowdnav", 0.21, 12.5),
        ("circle_crossing_5_visible", "swept", 1.0, 10.0),
    ],
)
def test_500_cases_give_the_known_figures(scenario, collision, success, time):
    trace = drive("orca", "500", scenario, collision=collision)
    solved = trace.outcome == Outcome.SUCCESS
    assert solved.mean() == pytest.approx(success, abs=0.001)
    assert trace.steps[solved].mean() * 0.25 == pytest.approx(time, abs=0.05)
