import importlib.metadata
import os

import numpy as np
import pytest

from crowdbench import catalog
from crowdbench.cli.options import assignments
from crowdbench.metrics.registry import METRICS
from crowdbench.metrics.user_metrics import load_metrics
from crowdbench.predict.predictors import load_predictor
from crowdbench.utils.errors import InputError

PLANNER = '''
"""Mine."""
import numpy as np
from crowdbench import Planner

class Mine(Planner):
    def __init__(self, speed):
        self.speed = speed
    def plan(self, obs):
        return np.zeros((len(obs), 2))

def planner(speed=0.5):
    return Mine(speed)

def other(**options):
    return Mine(options)
'''


@pytest.fixture
def mine(tmp_path):
    path = tmp_path / "mine.py"
    path.write_text(PLANNER)
    return str(path)


def test_a_planner_comes_from_a_file_by_its_factory(mine):
    assert catalog.load_planner(mine, {"speed": 0.7}).speed == 0.7
    assert catalog.load_planner(f"{mine}:other", {"anything": 1}).speed == {"anything": 1}


PARTS = '''
"""Mine."""
from __future__ import annotations
from dataclasses import dataclass
import numpy as np
from crowdbench import Planner

@dataclass(frozen=True)
class Fast:
    speed: float
    gain: float = 2.0

@dataclass(frozen=True)
class Slow:
    patience: float = 1.0
    def __post_init__(self):
        1.0 / self.patience

class Mine(Planner):
    def __init__(self, pace, n):
        self.pace, self.n = pace, n
    def plan(self, obs):
        return np.zeros((len(obs), 2))

def planner(pace: Fast | Slow = Fast(0.5), n: int | None = 3):
    return Mine(pace, n)
'''


def test_a_users_planner_may_have_parts_that_are_written_as_tables(tmp_path):
    path = tmp_path / "mine.py"
    path.write_text(PARTS)

    def made(**options):
        planner = catalog.load_planner(str(path), options)
        return {"kind": type(planner.pace).__name__, **vars(planner.pace), "n": planner.n}

    assert made() == made(pace={}) == {"kind": "Fast", "speed": 0.5, "gain": 2.0, "n": 3}
    assert made(pace={"gain": 1.0}, n=False) == {"kind": "Fast", "speed": 0.5, "gain": 1.0, "n": None}
    assert made(pace={"patience": 3.0}) == {"kind": "Slow", "patience": 3.0, "n": 3}
    with pytest.raises(
        InputError, match=r"pace is False, but must be a table with speed, gain or a table with patience$"
    ):
        made(pace=False)
    with pytest.raises(InputError, match=r"mine cannot be made with .*: ZeroDivisionError"):
        made(pace={"patience": 0.0})


def test_an_installed_package_can_bring_a_planner(mine, tmp_path, monkeypatch):
    entry = importlib.metadata.EntryPoint("theirs", "mine:planner", "crowdbench.planners")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: [entry] if group == entry.group else [])
    assert catalog.load_planner("theirs", {"speed": 0.3}).speed == 0.3
    assert ("theirs", "installed: mine:planner") in catalog.PLANNERS.names()


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("import nonsense_module", "cannot be loaded: ModuleNotFoundError"),
        ("x = 1", "defines no function planner()"),
        ("def planner(): return 3", "made a int, but must make a crowdbench.Planner"),
        ("def planner(): raise OSError('no weights')", "cannot be made with {}: OSError: no weights"),
    ],
)
def test_a_broken_file_gets_one_sentence(tmp_path, text, expected):
    path = tmp_path / "mine.py"
    path.write_text(text)
    with pytest.raises(InputError) as error:
        catalog.load_planner(str(path))
    assert expected in str(error.value)
    assert "mine" in str(error.value)


def test_unknown_names_and_options_are_told_with_the_known(mine):
    with pytest.raises(InputError, match=r"no planner is called 'orka' .did you mean orca.*; there are .*orca"):
        catalog.load_planner("orka")
    with pytest.raises(InputError, match="there is no file"):
        catalog.load_planner("./nowhere.py")
    message = r"^no scenario is called 'dor_10' .did you mean door_10 or shop_10..; see crowdbench list, or give a file"
    with pytest.raises(InputError, match=message):
        catalog.load_scenario("dor_10")
    with pytest.raises(InputError, match="no scenario is called 'xyzzy'; there are circle_crossing_10, "):
        catalog.load_scenario("xyzzy")
    with pytest.raises(InputError, match=r"mine has no option 'sped' .did you mean speed.*; its options are: speed"):
        catalog.load_planner(mine, {"sped": 1})


def test_assignments_are_toml_or_bare_text():
    texts = ["a=1", "b = 0.5", "c=true", "d=hello", 'e="1"', "f.g=[1, 2]", "h=a=b"]
    assert assignments(texts, "--set") == {
        "a": 1, "b": 0.5, "c": True, "d": "hello", "e": "1", "f.g": [1, 2], "h": "a=b",
    }  # fmt: skip
    with pytest.raises(InputError, match="write --set key=value"):
        assignments(["speed"], "--set")


def test_a_policy_of_ones_own_moves_the_crowd(tmp_path):
    path = tmp_path / "stroll.py"
    path.write_text(
        "import numpy as np\n"
        "from crowdbench import PedestrianPolicy\n"
        "class Stroll(PedestrianPolicy):\n"
        "    parameters = {'pace': 0.5}\n"
        "    def velocities(self, world, parameters):\n"
        "        pace = parameters['pace'][:, 1:, None]\n"
        "        return np.concatenate([pace, 0 * pace], axis=2)\n"
        "def policy():\n"
        "    return Stroll()\n"
    )
    from crowdbench.scenario.cases import Cases
    from crowdbench.sim.simulator import crowd_velocities

    place = catalog.load_scenario("circle_crossing_5", {"pedestrians.stroll.pace": 0.7}, str(path))
    velocity = crowd_velocities(place.worlds(Cases.parse("3")), place.policies)
    assert np.array_equal(velocity, np.tile([0.7, 0.0], (3, 5, 1)))


def test_a_metric_of_ones_own_has_its_files_name(tmp_path):
    path = tmp_path / "steps_taken.py"
    path.write_text("def metric(trace):\n    return trace.steps * 1.0\n")
    metrics = load_metrics([str(path)])
    assert list(metrics) == [*METRICS, "steps_taken"]
    path.rename(tmp_path / "jerk.py")
    with pytest.raises(InputError, match="jerk exists already"):
        load_metrics([str(tmp_path / "jerk.py")])


@pytest.mark.parametrize("folder", ["plain", "2026-01-01T10:00"])
def test_a_policy_is_found_from_where_one_stands_or_from_its_scenario(tmp_path, monkeypatch, folder):
    here = tmp_path / folder
    here.mkdir()
    (here / "crowd.py").write_text((catalog.PEDESTRIANS.folder / "orca.py").read_text())
    (here / "mine.toml").write_text("[pedestrians]\npolicy = './crowd.py'\n")
    assert list(catalog.load_scenario(str(here / "mine.toml")).policies) == ["crowd"]
    monkeypatch.chdir(here)
    assert list(catalog.load_scenario("circle_crossing_5", None, "./crowd.py").policies) == ["crowd"]
    changed = catalog.load_scenario("circle_crossing_5", {"pedestrians.policy": {"./crowd.py": 1, "social_force": 1}})
    assert set(changed.policies) == {"crowd", "social_force"}


def test_a_broken_installed_package_spoils_no_list(monkeypatch):
    entry = importlib.metadata.EntryPoint("theirs", "nowhere.at_all:planner", "crowdbench.planners")
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: [entry])
    assert ("theirs", "installed: nowhere.at_all:planner") in catalog.PLANNERS.names()
    with pytest.raises(InputError, match="installed planner theirs cannot be loaded: ModuleNotFoundError"):
        catalog.load_planner("theirs")


def test_a_built_in_planner_may_be_a_folder_with_a_file_of_its_name():
    assert list(catalog.planner_files("mpc", {})["planner"]) == ["mpc.py", "mpc_program.py"]
    names = [name for name, _ in catalog.PLANNERS.names()]
    assert names == sorted(names)
    assert "mpc" in names
    assert "mpc_program" not in names


UNANNOTATED = """
import functools
import numpy as np
from crowdbench import Planner

class Mine(Planner):
    def __init__(self, gain=1.0, n=3, on=False, name="a", points=(1.0, 2.0), table={}, free=None, *, last=0.5):
        self.given = locals()
    def plan(self, obs):
        return np.zeros((len(obs), 2))

def planner(gain=1.0, n=3, on=False, name="a", points=(1.0, 2.0), table={}, free=None, *, last=0.5, **others):
    return Mine(gain, n, on, name, points, table, free, last=last)

partial = functools.partial(Mine, gain=2.0, last=1.5)
"""

UNTYPED = pytest.mark.parametrize("function", ["planner", "Mine", "partial"])


def untyped(tmp_path, function, options):
    """What a planner receives whose options have defaults and no annotations."""
    path = tmp_path / "mine.py"
    path.write_text(UNANNOTATED)
    return catalog.load_planner(f"{path}:{function}", assignments(options, "--option")).given


@UNTYPED
@pytest.mark.parametrize(
    ("option", "expected"),
    [
        ("gain=2", 2.0),
        ("gain=2.5", 2.5),
        ("last=1", 1.0),
        ("n=4", 4),
        ("on=true", True),
        ("name=b", "b"),
        ("points=[3, 4]", (3, 4)),
        ("table={a=1}", {"a": 1}),
        ("free=b", "b"),
        ("free=1.5", 1.5),
    ],
)
def test_an_option_without_annotation_has_the_type_of_its_default(tmp_path, function, option, expected):
    given = untyped(tmp_path, function, [option])[option.partition("=")[0]]
    assert (type(given), given) == (type(expected), expected)


@UNTYPED
@pytest.mark.parametrize(
    ("option", "right"),
    [
        ("gain=abc", "gain is 'abc', but must be a number"),
        ("gain=true", "gain is true, but must be a number"),
        ("gain=nan", "gain is 'nan', but must be a number"),
        ("gain=inf", "gain is 'inf', but must be a number"),
        ("last=[1]", r"last is \[1\], but must be a number"),
        ("n=1.5", "n is 1.5, but must be a whole number"),
        ("n=true", "n is true, but must be a whole number"),
        ("on=1", "on is 1, but must be true or false"),
        ("name=3", "name is 3, but must be a text in quotes"),
        ("points=3", "points is 3, but must be a list"),
        ("table=3", "table is 3, but must be a table"),
    ],
)
def test_an_option_of_another_type_than_its_default_gets_one_sentence(tmp_path, function, option, right):
    with pytest.raises(InputError, match=f"^{right}$"):
        untyped(tmp_path, function, [option])


def test_an_annotation_that_cannot_be_read_leaves_the_type_of_the_default(tmp_path):
    path = tmp_path / "mine.py"
    path.write_text(
        f"from __future__ import annotations\n{UNANNOTATED}\ndef wrong(gain: Nothing = 1.0): return Mine(gain)"
    )
    with pytest.raises(InputError, match=r"^gain is 'abc', but must be a number$"):
        catalog.load_planner(f"{path}:wrong", {"gain": "abc"})


@pytest.mark.parametrize("value", [float("inf"), float("nan")])
def test_a_number_of_python_must_be_finite(tmp_path, value):
    path = tmp_path / "mine.py"
    path.write_text(UNANNOTATED)
    with pytest.raises(InputError, match=r"gain is (inf|nan), but must be a number"):
        catalog.load_planner(str(path), {"gain": value})


def test_the_parameters_of_a_part_are_checked(tmp_path):
    path = tmp_path / "mine.py"
    path.write_text(PARTS)
    with pytest.raises(InputError, match=r"^in pace, gain is 'abc', but must be a number$"):
        catalog.load_planner(str(path), {"pace": {"gain": "abc"}})


@pytest.mark.parametrize("name", ["mine.py", "mine.onnx", "mine.toml"])
def test_a_file_that_is_too_large_to_be_read_gets_one_sentence(tmp_path, name):
    path = tmp_path / name
    path.touch()
    os.truncate(path, 10**12)  # takes no room
    load = catalog.load_scenario if name.endswith(".toml") else catalog.load_planner
    with pytest.raises(InputError, match=r"mine\.\w+.* it has 1000\.0 GB, more than 0\.5 GB"):
        load(str(path))


@pytest.mark.parametrize("value", [1.5, {"mean": 1.5, "std": 0.0, "low": 1.5, "high": 1.5}])
def test_a_whole_number_of_a_policy_is_not_rounded(tmp_path, value):
    path = tmp_path / "mine.py"
    path.write_text(
        "import numpy as np\nfrom crowdbench import PedestrianPolicy\n"
        "class policy(PedestrianPolicy):\n    parameters = {'n': 3}\n"
        "    def velocities(self, world, parameters):\n        return 0.0 * world.velocity[:, 1:]\n"
    )
    scenario = catalog.load_scenario("circle_crossing_5", {"pedestrians.mine.n": 4}, pedestrians=str(path))
    assert scenario.crowd.parameters["mine"]["n"].mean == 4
    with pytest.raises(InputError, match=r"pedestrians\.mine\.n is .*1\.5.*, but must be a whole number"):
        catalog.load_scenario("circle_crossing_5", {"pedestrians.mine.n": value}, pedestrians=str(path))


@pytest.mark.parametrize("margin", [-1, float("nan"), float("inf")])
@pytest.mark.parametrize("planner", ["orca", "social_force"])
def test_a_margin_below_0_is_refused(planner, margin):
    with pytest.raises(InputError, match=r"safety_space is .*, but must be a number"):
        catalog.load_planner(planner, {"safety_space": margin})


@pytest.mark.parametrize("arguments", [(None,), (3,), ("linear", 3), ("linear", {3: 4})])
def test_a_predictor_that_is_no_text_or_options_that_are_no_table_are_refused(arguments):
    with pytest.raises(InputError, match=r"predictor is .*, but must be a name|options is .*, but must be a table"):
        load_predictor(*arguments)
