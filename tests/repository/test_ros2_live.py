"""Drives through topics of ROS 2 equal direct ones, and a program that ends leaves one sentence."""

import contextlib
import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import psutil
import pytest
from helpers import fixture

from crowdbench import Driver, InputError, OneWorldPlanner, Result, load_planner, load_scenario, rollout, run
from crowdbench.cli.app import app

pytest.importorskip("cyclonedds", reason="cyclonedds is not installed: pip install 'crowdbench[ros]'")
FOLDER = Path(__file__).parents[2] / "adapters" / "ros2"
SCENARIO = "circle_crossing_5"


@pytest.fixture(scope="module", autouse=True)
def _importable():
    sys.path.insert(0, str(FOLDER))
    yield
    sys.path.remove(str(FOLDER))


@pytest.fixture(autouse=True)
def _on_this_machine_alone(monkeypatch):
    """Every test has a domain of its own, as tests may run at the same time."""
    monkeypatch.setenv("CYCLONEDDS_URI", (FOLDER / "loopback.xml").as_uri())
    monkeypatch.setenv("ROS_DOMAIN_ID", str(1 + os.getpid() % 200))


class Ended(Exception):
    pass


@pytest.fixture
def start_node():
    """Run a planner as a node in a thread, until the test ends."""
    from node import serve
    from observer import READ, Observer, Robot
    from topics import Topics

    from crowdbench.core import Holonomic

    ended, threads = threading.Event(), []

    class UntilEnd(Topics):
        def wait(self, seconds):
            if ended.is_set():
                raise Ended
            super().wait(seconds)

    def start(planner, limit=5.0):
        topics, sent = UntilEnd(["cmd_vel"], READ), []
        observer = Observer(Robot(Holonomic(), 0.3, 1.0, 0.25))

        def send(twist):
            sent.append(twist)
            topics.write("cmd_vel", twist)

        def work():
            with contextlib.suppress(Ended):
                serve(Driver(planner, "node"), observer, topics, send, limit)

        threads.append(threading.Thread(target=work))
        threads[-1].start()
        return sent

    yield start
    ended.set()
    for thread in threads:
        thread.join()


@pytest.mark.parametrize(
    ("scenario", "cases"),
    [("circle_crossing_5", "2"), ("unicycle", "1"), (fixture("noise_late"), "1"), ("groups_12", "1")],
)
def test_a_drive_in_lockstep_equals_a_direct_one(start_node, scenario, cases):
    from simulate import WRITTEN, TopicPlanner
    from topics import Topics

    start_node(load_planner("orca"))
    planner = TopicPlanner(Topics(WRITTEN, ["cmd_vel"]), limit=10.0, real_time=False)
    for case in range(int(cases)):
        live = rollout(planner, scenario, f"{case}:{case + 1}")
        direct = rollout("orca", scenario, f"{case}:{case + 1}")
        assert live.outcome.tolist() == direct.outcome.tolist()
        assert live.steps.tolist() == direct.steps.tolist()
        np.testing.assert_allclose(live.position, direct.position, atol=1e-6)
        assert len(planner.latency) == live.steps[0]
        assert planner.lost == 0


def test_messages_are_sent_from_the_loopback_interface_alone():
    from topics import Topics

    def sockets():
        return {each.laddr for each in psutil.Process().net_connections("udp")}

    before = sockets()
    topics = Topics(["cmd_vel"], [])
    assert topics.writers
    # Sockets that only receive have the port of the domain and any address.
    sending = {address.ip for address in sockets() - before if address.ip != "0.0.0.0"}
    assert sending == {"127.0.0.1"}


def test_without_a_controller_the_simulation_ends_with_one_sentence():
    from simulate import WRITTEN, TopicPlanner
    from topics import Topics

    planner = TopicPlanner(Topics(WRITTEN, ["cmd_vel"]), limit=0.2, real_time=False)
    with pytest.raises(InputError, match=r"no command has arrived on /cmd_vel for 0.2 s"):
        rollout(planner, SCENARIO, "1")


@pytest.mark.slow
def test_in_real_time_a_case_takes_its_simulated_time_and_the_result_has_the_latency(start_node):
    from simulate import WRITTEN, TopicPlanner
    from topics import Topics

    start_node(load_planner("orca"))
    planner = TopicPlanner(Topics(WRITTEN, ["cmd_vel"]), limit=10.0, real_time=True)
    trace = rollout(planner, load_scenario(SCENARIO, {"time_limit": 2.0}), "1")
    assert time.perf_counter() - planner.begun >= 0.25 * (trace.steps[0] - 1)
    assert len(planner.latency) + planner.lost == trace.steps[0]
    assert 0.0 < planner.mean_latency(trace)[0] < 0.25


@pytest.fixture
def robot():
    """An observer of a robot that stands at (3, 0) in `map`, faces up, and has a person 2 m ahead of it."""
    from observation_messages import transform_message
    from observer import Observer, Robot
    from topics import message

    from crowdbench.core import Holonomic

    def header(frame, sec=1):
        return message("std_msgs/Header", frame_id=frame, stamp=message("builtin_interfaces/Time", sec=sec))

    def point(x, y):
        return message("geometry_msgs/Point", x=x, y=y)

    def fill(observer, sec=1, person=(0.0, 2.0)):
        up = message("geometry_msgs/Quaternion", w=1.0)
        place = message("geometry_msgs/Pose", position=point(0.0, 0.0), orientation=up)
        moving = message("geometry_msgs/Twist", linear=message("geometry_msgs/Vector3", x=0.5))
        observer.add("tf", transform_message(0, "map", "odom", np.array([3.0, 0.0]), np.pi / 2.0))
        odom = {"header": header("odom", sec), "pose": message("geometry_msgs/PoseWithCovariance", pose=place)}
        odom["twist"] = message("geometry_msgs/TwistWithCovariance", twist=moving)
        observer.add("odom", message("nav_msgs/Odometry", **odom))
        someone = message("people_msgs/Person", name="a", position=point(*person), velocity=point(0.0, 1.0))
        observer.add("people", message("people_msgs/People", header=header("/map", sec), people=[someone]))
        goal = message("geometry_msgs/Pose", position=point(3.0, 5.0))
        observer.add("goal_pose", message("geometry_msgs/PoseStamped", header=header("map"), pose=goal))

    observer = Observer(Robot(Holonomic(), 0.3, 1.0, 0.25))
    fill(observer, person=(3.0, 2.0))
    return observer, fill


def test_an_observation_of_a_robot_is_in_the_frame_of_the_goal(robot):
    obs = robot[0].observation()
    np.testing.assert_allclose(obs.vehicle.position, [[3.0, 0.0]])
    np.testing.assert_allclose(obs.vehicle.heading, [np.pi / 2.0])
    np.testing.assert_allclose(obs.vehicle.velocity, [[0.0, 0.5]], atol=1e-12)
    np.testing.assert_allclose(obs.pedestrians.position, [[[3.0, 2.0]]])
    np.testing.assert_allclose(obs.pedestrians.velocity, [[[0.0, 1.0]]])
    assert obs.pedestrians.observed.tolist() == [[1]]


def test_the_next_observation_comes_after_dt_and_has_the_positions_of_earlier_ones(robot):
    observer, fill = robot
    assert observer.observation().step.tolist() == [0]
    assert observer.observation() is None
    fill(observer, sec=2, person=(3.0, 2.5))
    obs = observer.observation()
    assert obs.step.tolist() == [1]
    assert obs.pedestrians.history[0, -2:, 0].tolist() == [[3.0, 2.0], [3.0, 2.5]]
    assert obs.pedestrians.observed.tolist() == [[2]]


def test_a_number_that_is_not_finite_and_a_frame_without_transform_are_errors(robot):
    observer, fill = robot
    fill(observer, sec=2, person=(np.nan, 2.5))
    with pytest.raises(InputError, match="a message of /people has a number that is not finite"):
        observer.observation()
    fill(observer, sec=3)
    observer.latest["people"].header.frame_id = "lidar"
    with pytest.raises(InputError, match="/tf has no transform from 'lidar' to 'map'"):
        observer.observation()


@pytest.mark.parametrize(("start", "step"), [(0.0, 1.0), (-2.0, 1.0), (2.0, -1.0)])
def test_a_scan_begins_along_the_heading_and_goes_on_counter_clockwise(robot, start, step):
    from topics import message

    angles = start + step * np.arange(4)
    scan = {"angle_min": start * np.pi / 2.0, "angle_increment": step * np.pi / 2.0, "range_max": 9.0}
    robot[0].add("scan", message("sensor_msgs/LaserScan", **scan, ranges=(1.0 + angles % 4.0).tolist()))
    obs = robot[0].observation()
    assert obs.lidar.tolist() == [[1.0, 2.0, 3.0, 4.0]]
    assert (obs.sensor.lidar.beams, obs.sensor.lidar.range) == (4, 9.0)


class StandingTopics:
    """Topics on which nothing arrives."""

    def __init__(self, waits):
        self.waits = waits

    def wait(self, seconds):
        self.waits -= 1
        if self.waits < 0:
            raise Ended
        time.sleep(seconds)

    def take(self, topic):
        return []


@pytest.mark.parametrize("error", [Ended, InputError("it fails")])
def test_a_robot_stops_when_messages_stop_and_when_the_node_ends(robot, error, capsys):
    from node import serve

    observer, sent = robot[0], []

    def plan(obs):
        if error is not Ended:
            raise error
        return np.array([0.0, 1.0])

    planner = OneWorldPlanner(plan)
    with pytest.raises(Ended if error is Ended else InputError):
        serve(Driver(planner, "node"), observer, StandingTopics(6), sent.append, limit=0.15)
    speeds = [round(twist.linear.x, 6) for twist in sent]
    # It moves forwards, stops because messages are old, and stops again because the node ends.
    assert speeds == ([1.0, 0.0, 0.0] if error is Ended else [0.0])
    assert ("no new message on /odom and /people" in capsys.readouterr().err) is (error is Ended)


@pytest.mark.slow
def test_the_example_drives_through_topics_and_is_in_a_table_with_a_planner(tmp_path, capsys):
    from simulate import simulate

    example = FOLDER.parents[1] / "examples" / "ros2_controller.py"
    with subprocess.Popen([sys.executable, example]) as controller:
        simulate("example", tmp_path / "example", "groups_12", "2")
        controller.kill()
    run("orca", "groups_12", 2, out=tmp_path / "orca")
    app(["table", str(tmp_path / "example"), str(tmp_path / "orca")], standalone_mode=False)
    printed = capsys.readouterr().out
    assert "| example |" in printed
    assert "| orca |" in printed
    result = Result.read(tmp_path / "example")
    assert result.metrics["commands_lost"].mean == 0.0
    assert 0.0 < result.metrics["command_latency"].mean < 1.0


@pytest.mark.nightly
def test_a_killed_node_and_a_killed_simulator_leave_a_sentence_and_no_run(tmp_path):
    def start(script, *options):
        line = [sys.executable, FOLDER / script, *options]
        return subprocess.Popen(line, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True, cwd=tmp_path)

    def simulate(*options):
        common = ("--name", "orca", "--scenario", SCENARIO, "--cases", "400", "--out", "run")
        return start("simulate.py", *common, "--limit", "3", *options)

    node, simulator = start("node.py", "--planner", "orca"), simulate()
    while not list(tmp_path.glob("run.parts-*/*")):
        time.sleep(0.1)
        assert simulator.poll() is None
    node.kill()
    node.communicate()
    assert "no command has arrived on /cmd_vel for 3 s" in simulator.communicate()[1].splitlines()[-1]
    assert simulator.returncode == 1
    assert not (tmp_path / "run").exists()
    node, simulator = start("node.py", "--planner", "orca"), simulate("--real-time")
    time.sleep(8.0)
    simulator.kill()
    simulator.communicate()
    time.sleep(2.0)
    node.terminate()
    text = node.communicate()[1]
    assert "stopped: no new message on /odom" in text
    assert "interrupted: the robot has stopped" in text
    assert not (tmp_path / "run").exists()
