"""Robots' bags: a bag of a simulated run scores as the run does, and what is missing or wrong in a bag is said."""

import json
import os
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from crowdbench import load_planner, load_scenario
from crowdbench.core.types import Outcome
from crowdbench.metrics.user_metrics import load_metrics
from crowdbench.planners.driver import Driver
from crowdbench.results.episodes import Episodes
from crowdbench.results.stored_tracks import read_tracks
from crowdbench.runs.rollout import rollout
from crowdbench.scenario.cases import Cases
from crowdbench.utils.errors import InputError

rosbag2 = pytest.importorskip("rosbags.rosbag2")

from ros_bags import (  # noqa: E402
    FOLDER,
    VEHICLE,
    bag_of,
    drive_file,
    goal_pose,
    grid,
    odometry,
    people,
    pose,
    straight,
    trace_of,
    transform,
)

from crowdbench.export.rosbag import write_bag  # noqa: E402


@pytest.mark.parametrize("scenario", ["corner_5", pytest.param("unicycle", marks=pytest.mark.slow)])
def test_a_bag_of_a_simulated_run_scores_as_the_run_does(tmp_path, scenario):
    trace = rollout(Driver(load_planner("orca"), "orca"), load_scenario(scenario), Cases("val", 0, 4))
    for row in range(4):
        write_bag(trace, row, tmp_path / f"bag{row}")
    goals = trace.goal[:, 0, 0]
    for row in range(4):
        table = f'[vehicle]\nodometry = "/odom"\ngoal = {goals[row].tolist()}\nradius = {trace.radius[row, 0, 0]}\n'
        found, notes = trace_of(drive_file(tmp_path, [f"bag{row}"], table))
        assert not notes
        assert found.outcome[0] == trace.outcome[row]
        steps = int(found.steps[0])
        np.testing.assert_allclose(found.position[0, : steps + 1, 0], trace.position[row, : steps + 1, 0], atol=1e-6)
        there = trace.present[row, : steps + 1, 1:].any(axis=0)
        # Chords instead of arcs; a pedestrian who arrives is gone in the bag before the step is over.
        gaps = found.gap[0, :steps], trace.gap[row, :steps]
        both = np.isfinite(gaps[0]) & np.isfinite(gaps[1])
        assert both.mean() > 0.5
        assert (gaps[0] >= gaps[1] - 0.01).all()
        limit = 1e-6 if scenario == "corner_5" else 0.01
        assert np.median(np.abs(gaps[0][both] - gaps[1][both])) < limit
        assert found.position.shape[2] - 1 == there.sum()


def test_frames_are_chained_and_both_storages_are_read(tmp_path):
    messages = [("/tf_static", 0.0, transform(100.0, "map", "hall", 10.0, 0.0, np.pi / 2))]
    for t in np.arange(0.0, 4.05, 0.1).tolist():
        messages.append(("/tf", t, transform(100.0 + t, "hall", "odom", 0.0, 0.0, 0.0)))
        messages.append(("/odom", t, odometry(100.0 + t, t, 0.0, "odom")))
        messages.append(("/people", t, people(100.0 + t, ("a", 2.0, 2.0), frame="odom")))
    for storage in ("SQLITE3", "MCAP"):
        bag_of(tmp_path / storage, messages, storage)
    found, _ = trace_of(drive_file(tmp_path, ["SQLITE3", "MCAP"], VEHICLE.replace("[4.0, 0.0]", "[10.0, 4.0]")))
    np.testing.assert_allclose(found.position[0], found.position[1])
    np.testing.assert_allclose(found.position[0, 4, 0], [10.0, 1.0], atol=1e-6)
    np.testing.assert_allclose(found.position[0, 4, 1], [8.0, 2.0], atol=1e-6)
    assert found.outcome.tolist() == [Outcome.SUCCESS] * 2


@pytest.mark.parametrize(
    ("messages", "sentence"),
    [
        (straight(times=np.array([0.0, 0.1, 2.0, 2.1])), "there is no message of /people for 1.90 s around 0.25 s"),
        (straight(late=7.0), "the clock of /people is 7.00 s behind that of /odom: correct it with offset = 7.00"),
        (straight(frame="odom"), "/tf has no transform from 'odom' to 'map'"),
        (
            [message for message in straight() if message[0] == "/odom"],
            "there is no topic /people; the topics are /odom",
        ),
        (straight(seconds=0.1), "observed together for less than one step of 0.25 s"),
    ],
)
def test_what_is_missing_or_wrong_is_said(tmp_path, messages, sentence):
    bag_of(tmp_path / "a", messages)
    with pytest.raises(InputError, match=sentence.replace("(", r"\(")):
        trace_of(drive_file(tmp_path, ["a"], VEHICLE))


FROM_TOPICS = 'map_topic = "/map"\n[vehicle]\nodometry = "/odom"\ngoal_topic = "/goal_pose"\n'


def test_goal_and_map_are_read_from_their_topics(tmp_path):
    # Unknown cells, half occupied ones and free ones; the lowest row first.
    cells = np.array([[-1, 100, 50, 0], [0, 100, 0, 0], [0, 0, 0, 100]])
    for name, x in (("a", 3.0), ("b", 4.0)):
        more = [("/goal_pose", 0.0, goal_pose(0.0, x, 0.0)), ("/map", 0.0, grid(cells, 0.5, pose(10.0, -4.0)))]
        bag_of(tmp_path / name, more + straight())
    found, _ = trace_of(drive_file(tmp_path, ["a", "b"], FROM_TOPICS))
    np.testing.assert_allclose(found.goal[:, 0, 0], [[3.0, 0.0], [4.0, 0.0]])
    assert found.steps.tolist() == [11, 15]
    bounds = sorted([*np.nanmin(each, axis=0), *np.nanmax(each, axis=0)] for each in found.obstacles[0])
    np.testing.assert_allclose(bounds, [[10.5, -4.0, 11.0, -3.0], [11.5, -3.0, 12.0, -2.5]], atol=0.0626)
    np.testing.assert_allclose(found.wall_gap[0, 10], np.hypot(10.5 - 2.75, 3.0) - 0.3, atol=0.0626)


def test_goals_that_are_missing_or_change_are_said(tmp_path):
    table = '[vehicle]\nodometry = "/odom"\ngoal_topic = "/goal_pose"\n'
    bag_of(tmp_path / "a", straight() + [("/goal_pose", t, goal_pose(t, 4.0 + t, 0.0)) for t in (0.0, 2.0)])
    with pytest.raises(InputError, match=r"the goal changes at 2.00 s: cut the bag there"):
        trace_of(drive_file(tmp_path, ["a"], table))
    bag_of(tmp_path / "b", straight())
    with pytest.raises(InputError, match="there is no topic /goal_pose"):
        trace_of(drive_file(tmp_path, ["b"], table))
    for wrong in ("", "goal = [1.0]\n", 'goal = [1.0, 2.0]\ngoal_topic = "/goal_pose"\n'):
        with pytest.raises(InputError, match=r"needs either goal, as in \[8.0, 0.0\], or goal_topic"):
            drive_file(tmp_path, ["b"], "[vehicle]\n" + wrong)
    with pytest.raises(InputError, match="has map and map_topic"):
        drive_file(tmp_path, ["b"], 'map = "map.yaml"\n' + FROM_TOPICS)


def test_a_clock_is_corrected_by_its_offset(tmp_path):
    bag_of(tmp_path / "a", straight(late=7.0))
    found, _ = trace_of(drive_file(tmp_path, ["a"], VEHICLE + "[people]\noffset = 7.0\n"))
    assert found.outcome.tolist() == [Outcome.SUCCESS]


def test_an_identity_that_comes_again_or_jumps_is_another_pedestrian(tmp_path):
    messages = []
    for t in np.arange(0.0, 4.05, 0.1).tolist():
        messages.append(("/odom", t, odometry(100.0 + t, t, 0.0)))
        here = [("a", 2.0, 2.0)] if t < 1.0 or t > 2.5 else []
        messages.append(("/people", t, people(100.0 + t, *here, ("b", 0.0, 5.0 if t < 2.0 else -5.0))))
    bag_of(tmp_path / "a", messages)
    found, notes = trace_of(drive_file(tmp_path, ["a"], VEHICLE))
    assert [note.split(": ")[1] for note in notes] == [
        "pedestrian a is not seen for 1.70 s at 0.90 s, and counts as somebody else afterwards",
        "pedestrian b jumps by 10.00 m at 1.90 s, and counts as somebody else afterwards",
    ]
    assert found.position.shape[2] == 1 + 4


def test_metrics_are_of_the_drive(tmp_path):
    bag_of(tmp_path / "a", straight())
    found, _ = trace_of(drive_file(tmp_path, ["a"], VEHICLE))
    columns = Episodes.of(found, load_metrics([])).columns
    assert columns["navigation_time"][0] == 3.75  # within 0.3 m of its goal
    np.testing.assert_allclose(columns["minimum_gap"], 2.0 - 0.6)
    assert np.isnan(columns["imposed_delay"][0])


def test_the_readmes_node_calls_a_planner():
    text = (FOLDER / "README.md").read_text()
    names = {}
    exec(text.split("```python\n")[1].split("```")[0], names)
    people = np.array([[2.0, 0.1], [4.0, 3.0]]), np.zeros((2, 2))
    command = names["command"](0, 0.1, np.zeros(3), np.zeros(2), np.array([8.0, 0.0]), *people)
    assert command.shape == (2,)
    assert 0.1 < np.hypot(*command) <= 1.0 + 1e-9


@pytest.mark.slow
def test_a_run_is_exported_as_bags_that_score_as_the_run(tmp_path, call):
    call("run", "--planner", "orca", "--cases", "val:2", "--out", str(tmp_path / "run"))
    call("export", str(tmp_path / "run"), "--out", str(tmp_path / "out"), "--format", "rosbag2")
    bags = [f"out/tracks/val-{case}" for case in range(2)]
    file = drive_file(tmp_path, bags, '[vehicle]\nodometry = "/odom"\ngoal = [0.0, 4.0]\n')
    found, _ = trace_of(file)
    assert found.outcome.tolist() == Episodes.read(tmp_path / "run" / "episodes.csv").outcome.tolist()


@pytest.fixture(scope="module")
def drives(tmp_path_factory):
    """A folder with the run of two drives of a robot, and its drive file."""
    from score_bags import convert

    folder = tmp_path_factory.mktemp("drives")
    for name, seconds in (("a", 4.0), ("b", 2.0)):
        bag_of(folder / name, straight(seconds))
    drive_file(folder, ["a", "b"], VEHICLE)
    convert(folder / "drive.toml", folder / "run")
    return folder


@pytest.mark.slow
def test_drives_are_exported_as_bags_that_are_the_same_drives(drives, tmp_path, call):
    call("export", str(drives / "run"), "--out", str(tmp_path / "out"), "--format", "rosbag2")
    vehicle = '[vehicle]\nodometry = "/odom"\ngoal_topic = "/goal"\n'
    found, _ = trace_of(drive_file(tmp_path, ["out/tracks/test-0", "out/tracks/test-1"], vehicle))
    trace = read_tracks(drives / "run" / "tracks.parquet")
    assert found.outcome.tolist() == trace.outcome.tolist() == [Outcome.SUCCESS, Outcome.TIMEOUT]
    np.testing.assert_allclose(found.position, trace.position, atol=1e-6)


def test_drives_are_exported_as_tracks_and_steps(drives, tmp_path, call):
    run = str(drives / "run")
    call("export", run, "--out", str(tmp_path / "txt"))
    call("export", run, "--out", str(tmp_path / "socnav"), "--format", "socnav")
    trace = read_tracks(drives / "run" / "tracks.parquet")
    rows = np.loadtxt(tmp_path / "txt" / "tracks" / "test-1.txt")
    np.testing.assert_allclose(rows[rows[:, 1] == 0, 2:], trace.position[1, : trace.steps[1] + 1, 0], atol=1e-6)
    written = json.loads((tmp_path / "socnav" / "tracks" / "test-0.json").read_text())
    assert "recorded, not rated by people" in written["metadata"]
    assert len(written["sequence"]) == trace.steps[0] + 1
    steps = pq.read_table(tmp_path / "txt" / "steps.parquet")
    assert steps.column_names == ["case", "step", "action", "reward", "terminated", "truncated"]
    assert len(steps) == trace.steps.sum()
    np.testing.assert_allclose(steps["action"].to_pylist(), [(1.0, 0.0)] * len(steps), atol=1e-6)


def test_drives_are_played_in_a_browser(drives, tmp_path, call):
    said = call("export", str(drives / "run"), "--out", str(tmp_path / "page"), "--format", "replay")
    assert "2 cases in" in said.stdout
    index = (tmp_path / "page" / "data" / "index.js").read_text()
    scenarios = json.loads(index.partition(",")[2].removesuffix(")\n"))["scenarios"]
    assert scenarios["drive"]["runs"]["robot"]["outcomes"] == "st"
    assert len(scenarios["drive"]["outline"]) > 3
    assert (tmp_path / "page" / "data" / "drive" / "test-1.js").is_file()


def test_tracks_of_two_bags_do_not_replace_each_other(tmp_path):
    from score_bags import convert

    for folder in ("monday", "tuesday"):
        bag_of(tmp_path / folder / "a", straight())
    drive_file(tmp_path, ["monday/a", "tuesday/a"], VEHICLE)
    with pytest.raises(InputError, match="the bags have the names a, a, but for --tracks all must be different"):
        convert(tmp_path / "drive.toml", tmp_path / "run", tmp_path / "tracks")


@pytest.mark.slow
def test_the_commands_after_a_conversion_run_as_printed(tmp_path, capfd):
    from score_bags import convert

    messages = []
    for t in np.arange(0.0, 12.0, 0.1).tolist():
        messages.append(("/odom", t, odometry(t + 100.0, 0.1 * t, -3.0)))
        walkers = [(f"{y}", 10.0 - t if y % 2 else t, float(y)) for y in range(6)]
        messages.append(("/people", t, people(t + 100.0, *walkers)))
    bag_of(tmp_path / "monday 1", messages)
    drive_file(tmp_path, ["monday 1"], VEHICLE)
    convert(tmp_path / "drive.toml", tmp_path / "a drive", tmp_path / "my tracks")
    commands = [line.strip() for line in capfd.readouterr().err.splitlines() if line.startswith("  crowdbench ")]
    assert [shlex.split(one)[1] for one in commands] == ["score", "view", "run"]
    path = {**os.environ, "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    for one in commands[::2]:
        done = subprocess.run(one, shell=True, cwd=tmp_path, env=path, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
