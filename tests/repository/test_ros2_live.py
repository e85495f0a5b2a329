"""Drives through topics of ROS 2 equal direct ones, and a program that ends leaves one sentence."""

import contextlib
import os
import sys
import threading
import time
from pathlib import Path

import numpy as np
import psutil
import pytest

from crowdbench import Driver, InputError, load_planner, load_scenario, rollout

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
    ("scenario", "cases"), [("circle_crossing_5", "2"), ("unicycle_10", "1"), ("noisy_10", "1"), ("groups_12", "1")]
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


def test_in_real_time_a_case_takes_its_simulated_time_and_the_result_has_the_latency(start_node):
    from simulate import WRITTEN, TopicPlanner
    from topics import Topics

    start_node(load_planner("orca"))
    planner = TopicPlanner(Topics(WRITTEN, ["cmd_vel"]), limit=10.0, real_time=True)
    trace = rollout(planner, load_scenario(SCENARIO, {"time_limit": 2.0}), "1")
    assert time.perf_counter() - planner.begun >= 0.25 * (trace.steps[0] - 1)
    assert len(planner.latency) + planner.lost == trace.steps[0]
    assert 0.0 < planner.mean_latency(trace)[0] < 0.25
