"""The study of tracks: counts of CLEAR MOT, and its page."""

import numpy as np
import pytest
from typer.testing import CliRunner

from crowdbench.cli.app import build_script
from studies.tracking.clear_mot import Counts, estimate
from studies.tracking.run import RADIUS, tracking


def counted(*steps):
    """The counts of steps, each the positions on a line of two people, and of tracks by their identity."""
    counts = Counts(dt=0.5)
    for people, tracks in steps:
        truth = np.array([[x, 0.0, 1.0, 0.0] for x in people])
        found = np.array([[x, 0.0, 0.0, 0.0] for x in tracks.values()]).reshape(-1, 4)
        counts.add(np.arange(2), truth, np.array([True, True]), np.array(list(tracks)), found)
    return counts


def test_misses_false_tracks_and_errors_are_counted():
    counts = counted(([0.0, 5.0], {7: 0.1, 8: 5.6}), ([0.0, 5.0], {7: 0.3, 8: 5.0, 9: 9.0}))
    assert (counts.steps, counts.people, counts.seen, counts.false, counts.switches) == (2, 4, 3, 2, 0)
    assert (counts.distance, counts.speed) == pytest.approx((0.4, 3.0))
    assert estimate("MOTA", [counts, counts]) == "0.25 (0.25 to 0.25)"
    assert estimate("missed [%]", [counts, counts]) == "25.0 (25.0 to 25.0)"
    assert estimate("false tracks", [counts, counts]) == "1.00 (1.00 to 1.00)"


def test_a_switch_is_another_identity_and_a_person_keeps_a_near_track():
    kept = counted(([0.0, 0.3], {1: 0.0, 2: 0.3}), ([0.0, 0.3], {1: 0.25, 2: 0.05}))
    assert kept.switches == 0
    swapped = counted(([0.0, 2.0], {1: 0.0, 2: 2.0}), ([0.0, 2.0], {1: 2.0, 2: 0.0}))
    assert swapped.switches == 2
    lost = counted(([0.0, 2.0], {1: 0.0, 2: 2.0}), ([0.0, 2.0], {2: 2.0}), ([0.0, 2.0], {3: 0.0, 2: 2.0}))
    assert lost.switches == 1
    assert estimate("switches [1/min]", [lost, lost]) == "20.0 (20.0 to 20.0)"


def test_people_beyond_the_range_are_neither_seen_nor_missed_and_their_tracks_are_not_false():
    counts = Counts(dt=0.25)
    truth = np.array([[0.0, 0.0, 0.0, 0.0], [9.0, 0.0, 0.0, 0.0]])
    counts.add(np.arange(2), truth, np.array([True, False]), np.array([4]), truth[1:])
    assert (counts.people, counts.seen, counts.false) == (1, 0, 0)


@pytest.mark.slow
def test_the_page_has_a_table_for_each_scenario():
    result = CliRunner().invoke(build_script(tracking), ["--cases", "val:3"])
    assert result.exit_code == 0, result.output
    for name in RADIUS:
        assert f"## `{name}`" in result.stdout
    rows = [line for line in result.stdout.splitlines() if line.startswith("| no errors")]
    assert len(rows) == 3
    assert all(row.count(" to ") == 6 for row in rows)
