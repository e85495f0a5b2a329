"""The study of how people move: accelerations, reversals, overlaps, speeds, and what scenarios must keep."""

import numpy as np
import pytest

from crowdbench.catalog import load_scenario
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.tracks.recorded_tracks import RecordedTracks
from studies.validity.motion import ETH_UCY_DT, HEADER, Walks, default_scenarios, measure, motion, recorded, simulate

MAPS = {"office_8", "shop_10"}
SUITE = [name for name in default_scenarios() if name not in MAPS]


def walks(*paths, radius=0.2, dt=ETH_UCY_DT):
    """Walks of people who are there at the same time, from their positions."""
    person = np.concatenate([np.full(len(path), number) for number, path in enumerate(paths)])
    moment = np.concatenate([np.arange(len(path)) for path in paths])
    return Walks(person, moment * dt, moment, np.concatenate(paths).astype(float), np.full(len(person), radius))


def path(velocity, dt=ETH_UCY_DT, start=(0.0, 0.0)):
    """Positions from velocities."""
    return np.cumsum(np.concatenate([[start], np.array(velocity, float) * dt]), axis=0)


def test_accelerations_are_changes_of_velocity_over_a_step():
    found = measure(walks(path([[1, 0]] * 5 + [[1, 0.4]] * 5)))
    assert found[0] == 0.0
    assert found[3] == pytest.approx(1.0)
    fine = measure(walks(path([[1, 0]] * 50 + [[1, 0.4]] * 50, dt=0.04), dt=0.04))
    assert fine[3] == pytest.approx(1.0), "in steps of 0.4 s, however short the steps of a scenario are"


def test_a_reversal_is_a_turn_by_more_than_a_right_angle_at_speed():
    minutes = 10 * ETH_UCY_DT / 60
    for velocity, reversals in (([-1, 0.1], 1), ([0.1, 1], 0), ([-0.2, 0], 0)):
        assert measure(walks(path([[1, 0]] * 5 + [velocity] * 5)))[4] == pytest.approx(reversals / minutes)


def test_overlaps_count_from_brushing_on():
    for apart, share in ((0.36, 0.0), (0.3, 2 / 3), (0.5, 0.0)):
        found = measure(walks(path([[1, 0]] * 10, start=(0, 9)), np.zeros((11, 2)), np.full((11, 2), [apart, 0])))
        assert found[5:7] == pytest.approx([max(0.4 - apart, 0.0), share])


def test_speeds_are_told_by_how_many_are_near():
    crowd = [path([[0.5, 0]] * 10, start=(0, 0.5 * k)) for k in range(4)]
    found = measure(walks(path([[1, 0]] * 10, start=(0, 50)), *crowd))
    assert found[7:9] == pytest.approx([1.0, 0.5])
    assert np.isnan(found[9])


def test_recorded_people_are_read_as_walks():
    frame = np.array([0, 10, 20, 10, 20])
    tracks = RecordedTracks("mine", frame, np.array([1, 1, 1, 2, 2]), np.arange(10.0).reshape(5, 2))
    found = recorded(tracks)
    assert found.time.tolist() == pytest.approx([0.0, 0.4, 0.8, 0.4, 0.8])
    assert measure(found)[7] == pytest.approx(2.0 * np.sqrt(2.0) / ETH_UCY_DT)


def test_a_straight_drive_meets_a_crowd_that_crosses_in_the_centre():
    changes = {"pedestrians.clear_space": None}
    walked, (arrived, approach, near) = simulate(load_scenario("circle_20_blind", changes), Cases("val", 0, 3))
    assert len(np.unique(walked.person)) == 60
    assert (np.diff(walked.time) > 0)[np.diff(walked.person) == 0].all()
    assert (arrived, approach < 1.0, near > 5.0) == (1.0, True, True)


QUICK = "door_10", "mixed_20"


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[] if name in QUICK else pytest.mark.nightly) for name in SUITE]
)
def test_people_of_the_suite_move_like_people(name):
    walked, _ = simulate(load_scenario(name), Cases("val", 0, 10))
    _, _, most, largest, reversals, _, overlapping, *_ = measure(walked)
    assert most <= (3.0 if name == "mixed_20" else 2.5)
    assert largest <= 3.0
    assert reversals <= 1.0
    assert overlapping <= 0.004, "0.2 % in many cases"


def test_the_page_has_the_suite_and_the_maps():
    assert set(default_scenarios()) == {*SUITE, *MAPS}
    assert {"circle_20", "circle_20_blind", "power_law_16"} <= set(SUITE)
    assert all(load_scenario(name) for name in default_scenarios())


def test_the_command_prints_the_page(capsys):
    motion(["unicycle"], cases=2)
    printed = capsys.readouterr().out
    assert "python studies/validity/motion.py unicycle --cases 2`" in printed
    assert [line.count("|") - 2 for line in printed.splitlines() if line.startswith("| ")] == [HEADER.count("|")] * 3
