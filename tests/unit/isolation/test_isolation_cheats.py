"""What a planner can try from its own process: each attack changes nothing, or ends in a sentence."""

import contextlib
import socket

import numpy as np
import pytest

from crowdbench.catalog import load_scenario
from crowdbench.isolation import sandbox
from crowdbench.isolation.isolated_planner import IsolatedPlanner
from crowdbench.metrics.registry import METRICS
from crowdbench.planners.driver import Driver
from crowdbench.results.episodes import Episodes
from crowdbench.runs.rollout import rollout
from crowdbench.scenario.cases import Cases
from crowdbench.utils.errors import InputError

pytestmark = pytest.mark.slow


HONEST = """
import numpy as np
import crowdbench

class Straight(crowdbench.Planner):
    def plan(self, obs):
        way = obs.vehicle.goal - obs.vehicle.position
        command = way * (obs.vehicle.preferred_speed / np.hypot(*way.T))[:, None]
        attack(obs)
        return command

def planner():
    return Straight()

def attack(obs):
    pass
"""

WORLDS = """
import gc, sys
def attack(obs):
    found = [one for one in gc.get_objects() if type(one).__name__ in ("World", "Scenario", "Trace", "Driver")]
    frame = sys._getframe()
    while frame is not None:
        found += [one for one in frame.f_locals.values() if type(one).__name__ in ("World", "Scenario", "Trace")]
        frame = frame.f_back
    for one in found:
        one.goal[:] = one.position
"""

JUDGE = """
import crowdbench.core.reward, crowdbench.sim.episode, crowdbench.sim.simulator
from crowdbench.metrics import registry as metrics
from crowdbench.results import episodes
from crowdbench.runs import rollout, run
from crowdbench.core.types import Outcome
def check_step(before, after):
    return crowdbench.sim.episode.StepCheck(np.full(len(after), Outcome.SUCCESS), *np.full((2, len(after)), 9.0))
def attack(obs):
    for module in (crowdbench.sim.episode, crowdbench.sim.simulator, rollout):
        module.check_step = check_step
    metrics.METRICS["success_rate"] = lambda trace: np.ones(len(trace), bool)
    crowdbench.sim.simulator._step = lambda *arguments: None
    episodes.Episodes.of = classmethod(lambda cls, trace, metrics: None)
    crowdbench.core.reward.reward = lambda *arguments: 1.0
"""

CHANGED_OBSERVATION = """
def attack(obs):
    obs.pedestrians.position[:] = 1e3
    obs.vehicle.preferred_speed[:] = 1e-3
    obs.row[:] = 0
"""

LATE_PRIVILEGE = """
def attack(obs):
    Straight.privileged = True
    obs.true_next()
"""

LISTENS = """
import threading
def attack(obs):
    if len(threading.enumerate()) < 3:
        threading.Thread(target=lambda: open(0, "rb", closefd=False).read(), daemon=True).start()
"""

HARMLESS = {"worlds": WORLDS, "judge": JUDGE, "observation": CHANGED_OBSERVATION, "standard input": LISTENS}
"""After these, everything is as if the planner had not tried."""

REFUSED = {
    "late privilege": (LATE_PRIVILEGE, r"true_next\(\) shows what no vehicle sees"),
    "early end": ("def attack(obs):\n    raise KeyboardInterrupt", "raised KeyboardInterrupt"),
    "exit": ("import os\ndef attack(obs):\n    os._exit(0)", r"ended its process \(status 0\)"),
    "later, from a thread": (
        "import os, threading\ndef attack(obs):\n    threading.Timer(0.0, os._exit, [0]).start()",
        r"ended its process \(status 0\)",
    ),
}
"""These end the run."""

IN_SANDBOX = {
    "other runs": "def attack(obs):\n    open(FOLDER + '/result.json').read()",
    "network": "import socket\ndef attack(obs):\n    socket.create_connection(('127.0.0.1', PORT), 1.0)",
    "parent's memory": (
        "import os\ndef attack(obs):\n"
        "    for name in os.listdir('/proc'):\n"
        "        if name.isdigit() and int(name) not in (1, os.getpid()):\n"
        "            raise SystemExit('another process is seen')\n"
        "    raise OSError('no other process is seen')"
    ),
}
"""These need bubblewrap to end the run."""


def drive(tmp_path, attack=""):
    """The trace of a vehicle that drives straight, and of whatever it tries on the way, under a seed of ours."""
    path = tmp_path / "mine.py"
    path.write_text(HONEST + attack)
    scenario = load_scenario("circle_crossing_5", {"seed": 12345, "crowdnav_cases": 0})
    with contextlib.closing(IsolatedPlanner(str(path), {})) as planner:
        return rollout(Driver(planner, planner.name), scenario, Cases("test", 0, 12))


@pytest.mark.parametrize("name", HARMLESS)
def test_an_attack_on_the_simulator_changes_nothing(name, tmp_path):
    honest, trace = drive(tmp_path), drive(tmp_path, HARMLESS[name])
    np.testing.assert_array_equal(trace.position, honest.position)
    rows, expected = Episodes.of(trace, METRICS), Episodes.of(honest, METRICS)
    assert not expected.columns["success_rate"].all()
    for metric in METRICS:
        np.testing.assert_array_equal(rows.columns[metric], expected.columns[metric])


@pytest.mark.parametrize("name", REFUSED)
def test_an_attack_that_needs_the_simulator_ends_in_a_sentence(name, tmp_path):
    attack, sentence = REFUSED[name]
    with pytest.raises(InputError, match=sentence):
        drive(tmp_path, attack)


@pytest.mark.skipif(sandbox.level() != sandbox.BUBBLEWRAP, reason="needs bubblewrap, and the right to use it")
@pytest.mark.parametrize("name", IN_SANDBOX)
def test_an_attack_on_the_machine_ends_in_a_sentence(name, tmp_path):
    result = tmp_path / "result.json"
    result.write_text("{}")
    with socket.create_server(("127.0.0.1", 0)) as server:
        places = f"FOLDER, PORT = {str(tmp_path)!r}, {server.getsockname()[1]}\n"
        with pytest.raises(InputError, match=r"raised (OSError|ConnectionRefusedError|FileNotFoundError)"):
            drive(tmp_path, places + IN_SANDBOX[name])
    assert result.read_text() == "{}"


def test_thinking_is_counted_with_the_clock_of_the_parent(tmp_path):
    thinks = "import time\nsleep = time.sleep\ntime.perf_counter = time.monotonic = lambda: 0.0\n"
    path = tmp_path / "mine.py"
    path.write_text(HONEST + thinks + "def attack(obs):\n    sleep(0.2)\nStraight.reset = lambda *_: sleep(0.3)")
    with contextlib.closing(IsolatedPlanner(str(path), {})) as planner:
        driver = Driver(planner, planner.name)
        rollout(driver, load_scenario("circle_crossing_5", {"time_limit": 1.25}), Cases("test", 0, 1))
    assert driver.seconds > 0.6
