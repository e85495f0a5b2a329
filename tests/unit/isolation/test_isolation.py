"""A planner in a process of its own drives as it does in crowdbench's, and whatever goes wrong ends in one sentence."""

import contextlib
import dataclasses
import json
import re
import shutil
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import psutil
import pytest
import safetensors.numpy

from crowdbench.catalog import PLANNERS, load_planner, load_scenario
from crowdbench.core.dynamics import Bicycle, Holonomic, chain
from crowdbench.core.types import Detector, Lidar, Noise, Rules, Sensor
from crowdbench.isolation import protocol, sandbox
from crowdbench.isolation.isolated_planner import IsolatedPlanner, ResourceLimits
from crowdbench.planners.driver import Driver
from crowdbench.plugins.kind import plugin_name
from crowdbench.runs.rollout import rollout
from crowdbench.runs.spec import EVERY_STEP, Replanning
from crowdbench.scenario.cases import Cases
from crowdbench.sim.sensor import observe
from crowdbench.sim.sight import look
from crowdbench.utils.errors import InputError, MachineFault

pytestmark = pytest.mark.slow


SCENARIO = "circle_crossing_5"

HEADER = """\
import numpy as np
import crowdbench

class Mine(crowdbench.Planner):
    privileged = False
    facts = {"by": "hand"}

    def toward(self, obs):
        return 0.5 * (obs.vehicle.goal - obs.vehicle.position) / np.hypot(*obs.vehicle.goal.T)[:, None]

    def plan(self, obs):
        return 0.1 * self.toward(obs)

    def plan_ahead(self, obs, steps):
        return np.repeat(self.plan(obs)[:, None], steps, axis=1)

def planner(speed=0.1):
    return Mine()

"""


@pytest.fixture
def mine(tmp_path):
    """Writes the file of a planner: one that drives slowly, and what else is in it."""

    def write(text):
        path = tmp_path / "mine.py"
        path.write_text(HEADER + text)
        return str(path)

    return write


@contextlib.contextmanager
def driven(spec, options=None, limits=ResourceLimits()):  # noqa: B008 (immutable)
    """A driver of an isolated planner."""
    with contextlib.closing(IsolatedPlanner(spec, options or {}, limits)) as planner:
        yield Driver(planner, planner.name, limits.decision)


def drive(driver, cases="test:2", replanning=EVERY_STEP, scenario=SCENARIO):
    return rollout(driver, load_scenario(scenario), Cases.parse(cases), replanning=replanning)


MEMORY = """
class Counts(Mine):
    def reset(self, rows):
        self.count = np.zeros(len(rows))

    def plan(self, obs):
        self.count[obs.row] += 1.0
        noise = obs.noise("mine", (2,))
        return 0.3 * self.toward(obs) * np.sin(self.count[obs.row])[:, None] + 0.01 * np.clip(noise, -3.0, 3.0)

def planner(speed=0.1):
    return Counts()
"""


TOOLS = """
import multiprocessing, subprocess
from concurrent.futures import ThreadPoolExecutor
import numba
import torch

@numba.njit(parallel=True)
def halved(way):
    out = np.empty_like(way)
    for row in numba.prange(len(way)):
        out[row] = 0.5 * way[row]
    return out

class Tools(Mine):
    def plan(self, obs):
        torch.set_num_threads(2)
        torch.manual_seed(0)
        weights = torch.randn(300, 300)
        factor = float(torch.tanh(weights @ weights)[0, 0])
        factor += float(subprocess.run(["echo", "0.5"], capture_output=True, text=True).stdout)
        with ThreadPoolExecutor(2) as threads, multiprocessing.get_context("fork").Pool(1) as processes:
            factor += list(threads.map(abs, [-0.25]))[0] + processes.map(abs, [-0.25])[0]
        return 0.1 * factor * halved(self.toward(obs))

def planner(speed=0.1):
    return Tools()
"""


@pytest.mark.parametrize("name", ["orca", "social_force", MEMORY])
def test_a_planner_gives_the_same_commands_in_its_own_process(name, mine):
    spec = mine(name) if name == MEMORY else name
    here = drive(Driver(load_planner(spec), "here"), "val:6")
    with driven(spec) as driver:
        apart = drive(driver, "val:6")
    np.testing.assert_array_equal(apart.command, here.command)
    np.testing.assert_array_equal(apart.position, here.position)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["cadrl", "ppo_lidar", pytest.param(TOOLS, marks=pytest.mark.nightly)])
def test_networks_threads_and_processes_give_the_same_commands_in_a_process_of_their_own(name, mine):
    spec = mine(name) if name == TOOLS else name
    place, cases = load_scenario(SCENARIO, {"time_limit": 1.5}), Cases("val", 0, 2)
    here = rollout(Driver(load_planner(spec), "here"), place, cases)
    with driven(spec) as driver:
        apart = rollout(driver, place, cases)
    np.testing.assert_array_equal(apart.command, here.command)


NATIVE = """
class Native(Mine):
    native = True

    def plan(self, obs):
        vehicle = obs.vehicle
        asked = vehicle.state, vehicle.preferred_speed, obs.dt
        commands = vehicle.dynamics.commands(*asked)
        ends = vehicle.dynamics.velocities(vehicle.state, commands, *asked[1:])
        gained = np.einsum("wad,wd->wa", ends, vehicle.local_goal - vehicle.position)
        return commands[np.arange(len(obs)), np.argmax(gained, axis=1)]

def planner():
    return Native()
"""


@pytest.mark.parametrize("name", ["orca", NATIVE])
def test_a_planner_in_its_own_process_drives_every_vehicle_in_every_world_as_in_this_one(name, mine):
    spec = mine(name) if name == NATIVE else name
    here = Driver(load_planner(spec), "here")
    with driven(spec) as apart:
        for scenario in ("unicycle", "car_28", "door_10"):
            one, two = (drive(driver, "val:2", scenario=scenario) for driver in (here, apart))
            for array in ("command", "position", "heading", "outcome", "steps"):
                np.testing.assert_array_equal(getattr(one, array), getattr(two, array), scenario)


BEYOND = """
class Beyond(Mine):
    native = "unicycle"
    commands = [(0.5, 2.5), (-0.5, 0.0), (np.nan, 0.0)]

    def reset(self, rows):
        self.command = self.commands.pop()

    def plan(self, obs):
        return np.tile(self.command, (len(obs), 1))

def planner():
    return Beyond()
"""


def test_native_commands_beyond_the_limits_get_the_same_sentences_as_in_this_process(mine):
    def sentences(driver):
        found = []
        for _ in range(3):
            with pytest.raises(InputError) as error:
                drive(driver, scenario="unicycle")
            found.append(str(error.value))
        with pytest.raises(InputError, match="has native = 'unicycle', but the vehicle of the scenario is holonomic"):
            drive(driver)
        return found

    spec = mine(BEYOND.replace("commands = [", "commands = [(0.0, 0.0), "))
    with driven(spec) as apart:
        found = sentences(apart)
    assert found == sentences(Driver(load_planner(spec), "mine"))
    assert [sentence.split(",")[0] for sentence in found] == [
        "planner mine returned [nan",
        "planner mine asked for -0.5 m/s",
        "planner mine asked for 2.5 rad/s",
    ]


def test_several_commands_at_once_come_through(mine):
    replanning = Replanning(4, look_first=2)
    spec = mine("")
    here = drive(Driver(load_planner(spec), "here"), replanning=replanning)
    with driven(spec) as driver:
        np.testing.assert_array_equal(drive(driver, replanning=replanning).command, here.command)


def test_a_privileged_planner_says_so_and_sees_the_future(mine):
    spec = mine("Mine.privileged = True\nMine.plan = lambda self, obs: 0.1 * obs.true_next()[:, 0]")
    with driven(spec) as driver:
        assert driver.privileged
        assert driver.facts == {"by": "hand"}
        assert drive(driver).command[0, 0].any()


def test_a_planner_with_its_own_tracker_says_so(mine):
    with driven(mine("Mine.raw = True")) as driver:
        assert driver.raw
    with driven(mine("")) as driver:
        assert not driver.raw


def test_every_array_of_an_observation_arrives():
    world = load_scenario(SCENARIO, {"pedestrians.number": [1, 3]}).worlds(Cases("val", 0, 5))
    generator = np.random.default_rng(0)
    world = world.replace(
        obstacles=generator.normal(size=(5, 2, 4, 2)),
        route=generator.normal(size=(5, 4, 3, 2)),
        velocity=generator.normal(size=(5, 4, 2)),
    )
    car = Rules(dynamics=Bicycle(2.5, 0.5, 1.5), goal_tolerance=1.0, body=chain(4.5, 0.9, 1.25))
    slow = Rules(dynamics=Holonomic(0.5))
    limited = {"range": 2.0, "field_of_view": 90.0, "occlusion": True, "missed": 0.3, "delay": 1.0, "remember": 1.0}
    noise, lidar = Noise(position=0.1, velocity=0.2), Lidar(beams=7, range=3.0)
    blind = Rules(sensor=Sensor(**limited, noise=noise, lidar=lidar, nearest=3))
    for future, rules in ((None, Rules()), (generator.normal(size=(5, 3, 2)), car), (None, slow), (None, blind)):
        world = look(world.replace(rules=rules))
        sent = observe(world, np.arange(5)[::-1], future)
        received, steps = protocol.read_observation(bytearray(b"".join(protocol.observation_parts(sent, 3))))
        assert steps == 3
        for one, two in ((sent, received), (sent.vehicle, received.vehicle), (sent.pedestrians, received.pedestrians)):
            for field in dataclasses.fields(one):
                value, other = getattr(one, field.name), getattr(two, field.name)
                assert (value is None) == (other is None)
                if isinstance(value, np.ndarray):
                    assert value.dtype == other.dtype
                    np.testing.assert_array_equal(value, other)
                    assert other.flags.writeable
                    assert other.flags.aligned
        for constant in ("dynamics", "goal_tolerance", "body"):
            assert getattr(received.vehicle, constant) == getattr(sent.vehicle, constant)
        assert (received.dt, received.sensor) == (sent.dt, rules.sensor)


LOOP = """\
while True:
    try:
        signal.signal(signal.SIGALRM, signal.SIG_IGN)
    except BaseException:
        pass"""


def body(statement, method="plan"):
    """The text of a planner whose method is a statement."""
    arguments = {"plan": "self, obs", "reset": "self, rows"}[method]
    indented = statement.replace("\n", "\n    ")
    return f"import os, signal, sys, time\ndef {method}({arguments}):\n    {indented}\nMine.{method} = {method}\n"


SCRIBBLE = """\
for fd in range(3, 9):
    try:
        os.write(fd, b'x' * 99)
    except OSError:
        pass
time.sleep(9)"""

FAULTS = {
    "raise ValueError('no way')": r"raised ValueError: no way, in line \d+ of mine\.py \(step 0, one of 2 cases\)$",
    "raise KeyboardInterrupt": r"raised KeyboardInterrupt, in line \d+ of mine\.py \(step 0, one of 2 cases\)$",
    "sys.exit(0)": r"raised SystemExit: 0, in line \d+ of mine\.py \(step 0, one of 2 cases\)$",
    "os._exit(0)": r"ended its process \(status 0\) \(step 0, one of 2 cases\)$",
    "os.kill(os.getpid(), 9)": r"ended its process \((signal SIGKILL|status 137)\) \(step 0, one of 2 cases\)$",
    "return [[0.0, 0.0]]": r"returned a list instead of a float array of shape \[world, 2\] \(case 0, step 0\)$",
    "return np.zeros(2)": r"returned shape \[2\] instead of \[2, 2\], a command per world \(case 0, step 0\)$",
    "return np.full((2, 2), np.nan)": r"returned \[nan, nan\], but a command must be finite \(case 0, step 0\)$",
    "return np.full((2, 2), 9.0)": r"asked for 12\.7279 m/s, but the vehicle's maximum is 1 m/s \(case 0, step 0\)$",
    "raise ValueError('a\\n\\x1b[31mb' + 9999 * 'c')": r"raised ValueError: a \\x1b\[31mbc{200,250} \.\.\. c+, in line",
    SCRIBBLE: r"sent a message of kind \d+ and \d+ bytes, which is none of the format \(step 0, one of 2 cases\)$",
}


@pytest.mark.parametrize("statement", FAULTS)
def test_whatever_goes_wrong_gets_one_sentence(statement, mine):
    with driven(mine(body(statement))) as driver, pytest.raises(InputError, match="^planner mine " + FAULTS[statement]):
        drive(driver)


def test_a_planner_that_cannot_be_made_is_refused(mine):
    with pytest.raises(
        InputError, match=r"mine\.py cannot be loaded: ZeroDivisionError: division by zero, in line \d+"
    ):
        IsolatedPlanner(mine("1 / 0"), {})
    with pytest.raises(InputError, match=r"^mine has no option 'pace'; its options are: speed$"):
        IsolatedPlanner(mine(""), {"pace": 1.0})
    with pytest.raises(InputError, match=r"^no planner is called 'nobody'; there are "):
        IsolatedPlanner("nobody", {})
    broken = mine(body("raise ValueError('no')", "reset"))
    with (
        driven(broken) as driver,
        pytest.raises(InputError, match=r"^planner mine raised ValueError in reset\(\): no, in line "),
    ):
        drive(driver)


READY = protocol.to_json({"version": protocol.VERSION, "privileged": False, "native": False, "facts": {}})


def test_a_program_that_speaks_another_version_is_refused(tmp_path):
    program = tmp_path / "other"
    answer = protocol.to_json({"version": 7, "privileged": False})
    program.write_text(
        f"#!{sys.executable}\nimport os, struct\n_, size = struct.unpack('<IQ', os.read(0, 12))\nos.read(0, size)\n"
        f"os.write(1, struct.pack('<IQ', 11, {len(answer)}) + {answer!r})\n"
    )
    program.chmod(0o755)
    with pytest.raises(InputError) as error:
        IsolatedPlanner(str(program), {})
    assert str(error.value) == (
        "planner other uses version 7 of the messages, but must use version 1, which docs/isolation.md describes"
    )


@pytest.mark.parametrize(
    ("answers", "sentence"),
    [
        ([(11, b"{")], r"^planner odd sent no valid JSON \(.*\) in its construction$"),
        ([(13, b'{"what": "fails", "why": 1}')], r"^planner odd fails in its construction$"),
        ([(11, READY), (11, b""), (12, bytes(8))], r"^planner odd sent 8 bytes for commands, but 32 were asked for \("),
    ],
)
def test_a_program_that_answers_something_else_gets_one_sentence(answers, sentence, tmp_path):
    program = tmp_path / "odd"
    program.write_text(
        f"#!{sys.executable}\nimport os, struct, sys\nread = sys.stdin.buffer.read\nfor kind, content in {answers!r}:\n"
        "    _, size = struct.unpack('<IQ', read(12))\n    read(size)\n"
        "    os.write(1, struct.pack('<IQ', kind, len(content)) + content)\n"
    )
    program.chmod(0o755)
    with pytest.raises(InputError, match=sentence), driven(str(program)) as driver:
        drive(driver)


def test_another_version_of_crowdbench_in_its_process_is_no_fault_of_the_planner(monkeypatch):
    monkeypatch.setattr("crowdbench.isolation.isolated_planner.VERSION", 99)
    with pytest.raises(MachineFault, match=r"^crowdbench has changed since this command started.*; start the command"):
        IsolatedPlanner("straight", {})


def test_a_planner_that_hangs_is_killed(mine):
    short = ResourceLimits(decision=0.5)
    too_long = r"^planner mine took longer than "
    late = pytest.raises(InputError, match=too_long + r"the limit of 0\.5 s \(step 0")
    with driven(mine(body(LOOP)), limits=short) as driver, late:
        drive(driver)
    # The limit of the process and that of the driver are equal: either may notice first.
    either = r"^planner mine (took longer than 0\.5 s in reset\(\)|raised TimeLimit in reset\(\): it took longer.*)$"
    late = pytest.raises(InputError, match=either)
    with driven(mine(body("time.sleep(99)", "reset")), limits=short) as driver, late:
        drive(driver)
    with pytest.raises(InputError, match=r"^planner mine took longer than 2 s in its construction$"):
        IsolatedPlanner(mine("import time; time.sleep(99)"), {}, ResourceLimits(construction=2.0))


def test_a_planner_that_takes_long_again_and_again_is_killed(mine):
    slow = mine(body("time.sleep(0.3); return np.zeros((len(obs.row), 2))"))
    sentence = r"^planner mine took longer than 2 s for all its answers together \(step \d+"
    with (
        driven(slow, limits=ResourceLimits(decision=0.9, total=2.0)) as driver,
        pytest.raises(InputError, match=sentence),
    ):
        drive(driver)


def test_a_planner_that_takes_too_much_memory_is_killed(mine):
    hoards = "self.hoard = [np.ones(10_000_000) for _ in range(50)]\ntime.sleep(99)"
    with driven(mine(body(hoards)), limits=ResourceLimits(memory=1e9)) as driver:
        with pytest.raises(InputError, match=r"^planner mine took \d\.\d GB of memory, more than 1 GB, \(step 0"):
            drive(driver)
        assert driver.planner.process.usage.memory > 1e9


def test_nothing_that_a_planner_has_started_outlives_it(mine):
    forks = "import subprocess, sys\nsubprocess.Popen([sys.executable, '-c', 'import time; time.sleep(600)'])"
    with driven(mine(forks)) as driver:
        own = psutil.Process(driver.planner.process._process.pid)
        everybody = [own, *own.children(recursive=True)]
        assert len(everybody) > 1
        drive(driver)
    psutil.wait_procs(everybody, timeout=5.0)
    assert not [process for process in everybody if process.is_running() and process.status() != "zombie"]


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux ends a process with its parent")
def test_a_planner_ends_with_its_parent(mine):
    spec = mine("while True:\n    pass")
    code = f"from crowdbench.isolation.isolated_planner import IsolatedPlanner; IsolatedPlanner({spec!r}, {{}})"
    parent = subprocess.Popen([sys.executable, "-c", code])
    deadline = time.monotonic() + 60.0
    started = []
    while not any(process.cpu_times().user > 1.5 for process in started):  # it has been made, and loops
        assert time.monotonic() < deadline
        time.sleep(0.1)
        started = psutil.Process(parent.pid).children(recursive=True)
    parent.kill()
    parent.wait()
    assert not psutil.wait_procs(started, timeout=10.0)[1]


def test_what_a_planner_prints_goes_to_the_standard_error(mine, capfd):
    with driven(mine(body("print('hello')\nreturn 0.1 * self.toward(obs)"))) as driver:
        drive(driver, "test:1")
    printed = capfd.readouterr()
    assert printed.out == ""
    assert "hello" in printed.err


def test_names_are_those_of_planners_that_are_loaded(mine, tmp_path):
    (tmp_path / "straight").write_text("")
    (tmp_path / "straight").chmod(0o755)
    spec = mine("")
    names = [spec, f"{spec}:other", "orca", str(tmp_path / "straight")]
    assert [plugin_name(name) for name in names] == [
        PLANNERS.load(spec, {})[0],
        "other",
        "orca",
        "straight",
    ]


@pytest.mark.skipif(sandbox.level() != sandbox.BUBBLEWRAP, reason="needs bubblewrap, and the right to use it")
def test_in_a_sandbox_there_is_no_network_no_other_process_and_no_file_to_write(mine):
    looks = """
import glob, os, socket
def tried(action):
    try:
        action()
    except OSError:
        return "no"
    return "yes"
Mine.facts = {
    "network": tried(lambda: socket.create_connection(("127.0.0.1", PORT), 1.0)),
    "write": tried(lambda: open(PATH, "w")),
    "temporary": tried(lambda: __import__("tempfile").TemporaryFile()),
    "processes": str(len(glob.glob("/proc/[0-9]*")) < 4),
}
"""
    with socket.create_server(("127.0.0.1", 0)) as server:
        text = looks.replace("PORT", str(server.getsockname()[1])).replace("PATH", repr("/new"))
        with driven(mine(text)) as driver:
            assert driver.facts == {"network": "no", "write": "no", "temporary": "yes", "processes": "True"}


def test_no_case_number_seed_or_result_is_on_its_way_to_the_planner(mine):
    """What is sent are the arrays of an observation: neither the case nor the key of the case is one of them."""
    world = load_scenario(SCENARIO, {"seed": 987654321, "crowdnav_cases": 0}).worlds(Cases("test", 77_000, 77_003))
    content = b"".join(protocol.observation_parts(observe(world), 1))
    for secret in (*world.case, *world.key, np.int64(987654321)):
        assert np.asarray(secret).tobytes() not in content


ISOLATION = (Path(__file__).parents[3] / "docs" / "isolation.md").read_text()


def test_the_page_names_the_arrays_and_the_metadata_that_are_sent():
    world = load_scenario(SCENARIO).worlds(Cases("val", 0, 2))
    world = world.replace(rules=Rules(sensor=Sensor(detector=Detector(), lidar=Lidar(beams=7, range=3.0))))
    obs = dataclasses.replace(observe(look(world)), future=np.zeros((2, 5, 2)))
    # Tracks cannot be of vehicles, so that no observation has all arrays.
    marked = dataclasses.replace(obs.pedestrians, is_vehicle=np.zeros((2, 5), bool))
    content = b"".join(protocol.observation_parts(dataclasses.replace(obs, pedestrians=marked), 1))
    header = json.loads(content[8 : 8 + int.from_bytes(content[:8], "little")])
    metadata = header.pop("__metadata__")
    names = {"float64": "F64", "int64": "I64", "uint64": "U64", "bool": "BOOL"}
    rows = re.findall(r"^\| `([\w.]+)` \| (\w+) \| `\[(.*)\]`", ISOLATION, re.MULTILINE)
    assert {(name, names[dtype], len(shape.split(", "))) for name, dtype, shape in rows} == {
        (name, entry["dtype"], len(entry["shape"])) for name, entry in header.items()
    }
    table = ISOLATION[ISOLATION.index("| metadata |") :]
    assert re.findall(r"^\| `(\w+)`", table, re.MULTILINE) == list(metadata)
    assert re.findall(r"^\| (\d+) \| (\w+) ", ISOLATION, re.MULTILINE) == [
        (str(kind.value), kind.name.lower()) for kind in protocol.MessageKind
    ]


def test_safetensors_reads_an_observation():
    obs = observe(load_scenario(SCENARIO).worlds(Cases("val", 0, 2)))
    arrays = safetensors.numpy.load(b"".join(protocol.observation_parts(obs, 1)))
    np.testing.assert_array_equal(arrays["pedestrians.history"], obs.pedestrians.history)
    np.testing.assert_array_equal(arrays["pedestrians.seen"], obs.pedestrians.seen)


STRAIGHT = """
class Straight(Mine):
    def plan_ahead(self, obs, steps):
        way = obs.vehicle.goal - obs.vehicle.position
        distance = np.hypot(*way.T)
        pace = np.minimum(obs.vehicle.preferred_speed, distance / (steps * obs.dt))
        return np.repeat((way * (pace / distance)[:, None])[:, None], steps, axis=1)

    def plan(self, obs):
        return self.plan_ahead(obs, 1)[:, 0]

def planner():
    return Straight()
"""


@pytest.mark.skipif(shutil.which("c++") is None, reason="needs a compiler of C++")
@pytest.mark.parametrize("replanning", [EVERY_STEP, Replanning(3, look_first=1)])
def test_the_client_in_cpp_of_the_page_drives_as_the_same_planner_in_python(replanning, mine, tmp_path):
    [text] = re.findall(r"```cpp\n(.*?)```", ISOLATION, re.DOTALL)
    (tmp_path / "straight.cpp").write_text(text)
    program = tmp_path / "straight"
    subprocess.run(["c++", "-std=c++17", "-O1", "-Wall", "-Werror", "-o", program, f"{program}.cpp"], check=True)
    with driven(str(program)) as driver:
        assert (driver.name, driver.facts) == ("straight", {"language": "C++"})
        trace = drive(driver, "test:5", replanning)
    same = drive(Driver(load_planner(mine(STRAIGHT)), "same"), "test:5", replanning)
    np.testing.assert_allclose(trace.command, same.command, rtol=0.0, atol=1e-12)
    np.testing.assert_array_equal(trace.outcome, same.outcome)
