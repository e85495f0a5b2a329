"""Recompute metrics in NumPy from the tracks that `crowdbench export` writes."""

import numpy as np
import pytest
from helpers import make

from crowdbench.catalog import load_scenario
from crowdbench.runs.export import export
from crowdbench.runs.results import Episodes
from crowdbench.runs.store import RunResult

DT, RADIUS, SPEED = 0.25, 0.3, 1.0
"""Of the scenario: seconds, metres, and m/s of everybody."""


def tracks(folder, **visible):
    """The table of episodes of a run, and the positions `[frame, agent, 2]` of its successes by case."""
    scenario = load_scenario("circle_crossing_5", visible)
    make(folder / "run", "orca", scenario, "val:30")
    (folder / "export").mkdir()
    export(RunResult.read(folder / "run"), scenario, folder / "export")
    episodes = Episodes.read(folder / "run" / "episodes.csv")
    found = {}
    for row, case in enumerate(episodes.case.tolist()):
        frame, agent, x, y = np.loadtxt(folder / "export" / "tracks" / f"val-{case}.txt").T
        positions = np.full((int(frame.max()) + 1, 6, 2), np.nan)
        positions[frame.astype(int), agent.astype(int)] = np.stack([x, y], axis=1)
        if episodes.columns["success_rate"][row]:
            found[row] = positions
    return episodes.columns, found


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    return tracks(tmp_path_factory.mktemp("seen"), **{"vehicle.visible": True})


@pytest.fixture(scope="module")
def unseen(tmp_path_factory):
    return tracks(tmp_path_factory.mktemp("unseen"))


def gaps(p):
    """The smallest gap `[step, pedestrian]` while all move straight in a step, in metres."""
    offset = p[:, 1:] - p[:, :1]
    share = np.linspace(0, 1, 2001)[:, None, None, None]
    return np.linalg.norm((1 - share) * offset[:-1] + share * offset[1:], axis=3).min(axis=0) - 2 * RADIUS


def times(p):
    """The time to collision `[step, pedestrian]` at the velocity of the step, on a grid of 1 ms up to 1.5 s."""
    offset, velocity = (p[:, 1:] - p[:, :1])[:-1], np.diff(p[:, 1:] - p[:, :1], axis=0) / DT
    grid = np.arange(0.0, 1.5, 1e-3)
    touches = np.linalg.norm(offset[..., None, :] + grid[:, None] * velocity[..., None, :], axis=3) < 2 * RADIUS
    return np.where(touches.any(axis=2), grid[touches.argmax(axis=2)], np.inf)


def test_the_smallest_gap_is_that_of_the_tracks(seen):
    columns, successes = seen
    assert len(successes) > 20
    for row, p in successes.items():
        assert columns["minimum_gap"][row] == pytest.approx(gaps(p).min(), abs=1e-4)
    failures = np.setdiff1d(np.arange(30), list(successes))
    assert np.isnan(columns["minimum_gap"][failures]).all()


def test_near_misses_are_those_of_the_tracks(seen):
    columns, successes = seen
    rates = []
    for row, p in successes.items():
        encounters = near = 0
        gap, time = gaps(p), times(p)
        for i in range(5):
            breaks = np.flatnonzero(np.diff(np.concatenate([[0], gap[:, i] < 3.6, [0]])))
            for begin, end in breaks.reshape(-1, 2):
                encounters += 1
                near += bool((gap[begin:end, i] < 0.2).any() or (time[begin:end, i] < 1.0).any())
        assert columns["near_misses"][row] == pytest.approx(near / encounters, abs=1e-4)
        assert columns["near_misses_per_hour"][row] == pytest.approx(near * 3600 / (5 * (len(p) - 1) * DT), rel=1e-4)
        rates.append(near / encounters)
    assert 0.0 < np.mean(rates) < 1.0


def test_the_post_encroachment_time_is_that_of_the_tracks(seen):
    columns, successes = seen
    for row, p in successes.items():
        at = np.arange(0, len(p) - 1 + 1e-9, 0.05)  # in steps
        early = np.minimum(at.astype(int), len(p) - 2)
        between = p[early] + (at - early)[:, None, None] * (p[early + 1] - p[early])
        overlap = np.linalg.norm(between[:, None, :1] - between[None, :, 1:], axis=3) < 2 * RADIUS
        s, t, _ = np.nonzero(overlap)
        assert columns["paths_apart"][row] == (len(s) == 0)
        expected = np.abs(s - t).min() * 0.05 * DT if len(s) else np.nan
        assert columns["post_encroachment_time"][row] == pytest.approx(expected, abs=0.05 * DT + 1e-4, nan_ok=True)


def test_the_speed_near_pedestrians_is_that_of_the_tracks(seen):
    columns, successes = seen
    for row, p in successes.items():
        near = gaps(p).min(axis=1) < 1.2
        speed = np.linalg.norm(np.diff(p[:, 0], axis=0), axis=1)[near] / DT
        assert columns["speed_near_pedestrians"][row] == pytest.approx(speed.mean(), abs=1e-4)


def test_path_irregularity_is_that_of_the_tracks(seen):
    columns, successes = seen
    for row, p in successes.items():
        step = np.diff(p[:, 0], axis=0)
        step = step[np.linalg.norm(step, axis=1) > 1e-5]
        heading = np.concatenate([[np.pi / 2], np.arctan2(step[:, 1], step[:, 0])])  # the goal is ahead along y
        turns = np.abs((np.diff(heading) + np.pi) % (2 * np.pi) - np.pi)
        expected = turns.sum() / np.linalg.norm(step, axis=1).sum()
        assert columns["path_irregularity"][row] == pytest.approx(expected, abs=2e-3)


def test_imposed_delays_are_those_of_the_tracks_of_two_runs(seen, unseen):
    # Where the vehicle is not seen, the crowd walks as it does alone.
    (columns, successes), (_, alone) = seen, unseen
    compared = [row for row in successes if row in alone and len(alone[row]) >= len(successes[row])]
    assert len(compared) > 3
    for row in compared:
        both = np.stack([successes[row], alone[row][: len(successes[row])]])[:, :, 1:]
        distance = np.linalg.norm(both + both[0, 0], axis=3) - RADIUS  # goals are opposite on the circle
        lost, matched = np.zeros(5), np.zeros(5)
        for i in range(5):
            arrived = np.flatnonzero((distance[:, :, i] < 0.0).any(axis=0))
            end = arrived[0] if len(arrived) else distance.shape[1] - 1
            lost[i] = np.subtract(*np.maximum(distance[:, end, i], 0.0)) / SPEED
            matched[i] = end * DT
        assert columns["imposed_delay"][row] == pytest.approx(lost.sum() / matched.sum(), abs=1e-4)
        expected = np.maximum(lost, 0.0).sum() / matched.sum()
        assert columns["imposed_delay_positive"][row] == pytest.approx(expected, abs=1e-4)
