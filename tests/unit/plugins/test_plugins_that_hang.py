"""A plug-in that hangs ends with one sentence, wherever it hangs."""

import re
import signal
import subprocess
import sys

import numpy as np
import pytest
from helpers import drive

from crowdbench import catalog
from crowdbench.check.checks import check_plugin
from crowdbench.check.kinds import find_kind, load_subject
from crowdbench.core.types import Trace
from crowdbench.envs.parallel import parallel_env
from crowdbench.metrics.user_metrics import load_metrics, measure
from crowdbench.planners.driver import Driver
from crowdbench.planners.planner import Planner
from crowdbench.predict import predictors
from crowdbench.runs.loading import hold_out
from crowdbench.scenario.cases import Cases
from crowdbench.utils import interrupts, resources
from crowdbench.utils.errors import InputError

HANGS = "while True: pass"

pytestmark = pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="needs timers")


@pytest.fixture(autouse=True)
def short_limits():
    token = resources._start_limit.set(0.2)
    yield
    resources._start_limit.reset(token)


@pytest.fixture
def interrupts_handled():
    before = {number: signal.getsignal(number) for number in interrupts.SIGNALS}
    interrupts.handle()
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture
def mine(tmp_path):
    def write(text):
        (tmp_path / "mine.py").write_text(text)
        return str(tmp_path / "mine.py")

    return write


LOADERS = {
    "planner": catalog.load_planner,
    "pedestrian policy": lambda file: catalog.load_scenario("circle_crossing_5", pedestrians=file),
    "layout": lambda file: catalog.load_scenario("circle_crossing_5", {"layout": {"generator": file}}),
    "metric": lambda file: load_metrics([file]),
    "reward": lambda file: parallel_env(reward=file),
    "predictor": predictors.load_predictor,
}


@pytest.mark.parametrize("kind", LOADERS)
def test_a_file_that_hangs_in_its_import_gets_one_sentence(mine, kind):
    with pytest.raises(InputError, match=r"mine\.py cannot be loaded: .*it took longer than 0\.2 s, in line 1 of mine"):
        LOADERS[kind](mine(HANGS))


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        ("planner", f"def planner():\n  {HANGS}"),
        ("planner", f"class planner:\n  def __init__(self):\n    {HANGS}"),
        ("planner", "import time\ndef planner():\n  time.sleep(1e6)"),
        ("pedestrian policy", f"def policy():\n  {HANGS}"),
        ("predictor", f"def predictor():\n  {HANGS}"),
    ],
)
def test_a_factory_that_hangs_gets_one_sentence(mine, kind, text):
    with pytest.raises(InputError, match=r"cannot be made with \{\}: .*it took longer than 0\.2 s, in line . of mine"):
        LOADERS[kind](mine(text))


@pytest.mark.parametrize("text", ["raise KeyboardInterrupt", "import sys; sys.exit(0)", "raise SystemExit"])
def test_a_file_that_ends_python_in_its_import_gets_one_sentence(mine, text, interrupts_handled):
    with pytest.raises(InputError, match=r"mine\.py cannot be loaded: (KeyboardInterrupt|SystemExit)"):
        catalog.load_planner(mine(text))


class Hanging(Planner):
    """Hangs in one method or property."""

    def __init__(self, where):
        self.where = where

    def plan(self, obs):
        return np.zeros((len(obs), 2))

    def __getattribute__(self, name):
        while name == object.__getattribute__(self, "__dict__").get("where"):
            pass
        return object.__getattribute__(self, name)


@pytest.mark.parametrize("where", ["privileged", "native", "facts", "reset"])
def test_a_planner_that_hangs_outside_of_decisions_gets_one_sentence(where):
    with pytest.raises(InputError, match=r"it took longer than 0\.2 s, in line"):
        Driver(Hanging(where), "mine", 0.2).reset(np.arange(2))


def test_a_planner_that_hangs_for_a_held_out_scene_gets_one_sentence(shared):
    scenario = catalog.load_scenario("eth_recorded", data=shared / "data" / "eth_ucy")
    with pytest.raises(InputError, match=r"in for_held_out_scene\(\): it took longer than 0\.2 s"):
        hold_out(Hanging("for_held_out_scene"), "mine", scenario)


def test_a_policy_that_hangs_in_a_step_gets_one_sentence(mine):
    file = mine(
        "import numpy as np\n"
        "from crowdbench import PedestrianPolicy\n"
        "class policy(PedestrianPolicy):\n"
        "    def velocities(self, world, parameters):\n"
        "        while world.step[0] == 3: pass\n"
        "        return np.zeros((len(world), world.position.shape[1] - 1, 2))\n"
    )
    with pytest.raises(InputError, match=r"policy mine raised TimeLimit \(case 0, step 3\): it took longer than"):
        drive("straight", "1", pedestrians__policy=file)


def test_a_layout_that_hangs_gets_one_sentence(mine):
    file = mine(f"def layout(rng, radius, preferred_speed):\n  {HANGS}")
    scenario = catalog.load_scenario("circle_crossing_5", {"layout": {"generator": file}})
    with pytest.raises(InputError, match=r"in case test/0, the layout raised TimeLimit: it took longer than 0\.2 s"):
        scenario.worlds(Cases.parse("1"))


def test_a_metric_that_hangs_gets_one_sentence(monkeypatch):
    def hangs(trace: Trace):
        while True:
            pass

    monkeypatch.setattr("crowdbench.metrics.user_metrics.START_LIMIT", 0.2)
    with pytest.raises(InputError, match=r"metric mine raised TimeLimit: it took longer than 0\.2 s"):
        measure("mine", hangs, drive("straight", "1"))


COMMAND = """
import signal
from crowdbench.utils import defaults, watchdog
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # nohup ignores it
defaults.START_LIMIT = watchdog.GRACE = watchdog.TICK = 0.2
watchdog.HANG = 2.0
from crowdbench.cli import main
main()
"""
COMPILED = "import numba\n@numba.njit(nogil=True)\ndef hang():\n  while True: pass\n"
IN_DECISION = """
from crowdbench import Planner
class planner(Planner):
    def plan(self, obs):
        hang()
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (
            "import itertools\nmax(itertools.repeat(0))",
            "a plug-in hangs in compiled code: no Python code has run for 2 s",
        ),
        (
            f"{COMPILED}{IN_DECISION}",
            "(a plug-in took longer than 0.2 s and cannot be interrupted, in line 9|planner mine took longer)",
        ),
        (
            "while True:\n  try:\n    while True: pass\n  except BaseException: pass",
            r"cannot be loaded|cannot be interrupt",
        ),
        (HANGS, "cannot be loaded: TimeLimit"),
    ],
)
def test_a_command_ends_with_one_sentence_if_a_plug_in_hangs(mine, tmp_path, text, sentence):
    arguments = ["run", "--planner", mine(text), "--cases", "1", "--decision-limit", "0.2", "--out", tmp_path / "run"]
    command = [sys.executable, "-c", COMMAND, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    last = done.stderr.splitlines()[-1]
    assert done.returncode == 1
    assert re.search(f"^crowdbench: .*{sentence}", last)
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    "text",
    [
        "import numpy as np\nfrom crowdbench import PedestrianPolicy\n"
        "class policy(PedestrianPolicy):\n    def velocities(self, world, parameters):\n        while True: pass\n",
        f"def metric(trace):\n    {HANGS}",
        f"def reward(step):\n    {HANGS}",
    ],
)
def test_the_check_of_a_plug_in_that_hangs_ends(mine, text):
    file = mine(text)
    subject = load_subject(find_kind(file), file, {}, None, 0.2, None)
    results = check_plugin(subject, Cases.parse("val:2"), lambda share: None)
    assert any("took longer than the limit of 0.2 s" in str(result) for result in results)
