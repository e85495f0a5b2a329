"""What makes two runs the same: F14 and F16 of the reviews, and edits that count or do not."""

import dataclasses
import linecache
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from helpers import Still

import crowdbench
from crowdbench.results.result_file import read_result
from crowdbench.runs import identity
from crowdbench.runs.loading import load_run
from crowdbench.runs.spec import Replanning, RunSpec
from crowdbench.scenario.cases import Cases
from crowdbench.utils.errors import Interrupted

FILE = """
import numpy as np
from crowdbench import Planner
import helper

class Mine(Planner):
    def __init__(self, pace): self.pace = pace
    def plan(self, obs):
        return np.zeros((len(obs), 2)) + helper.ZERO

def planner(pace: float = 1.0): return Mine(pace)
"""


class Mine(Still):
    """Drives to the goal at its own pace; interrupts its run in the second batch, if it is to."""

    def __init__(self, pace, stops=False):
        self.pace, self.batches = pace, 1 if stops else 99

    def reset(self, rows):
        self.batches -= 1
        if self.batches < 0:
            raise Interrupted

    def plan(self, obs):
        way = obs.vehicle.goal - obs.vehicle.position
        return self.pace * way / np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1.0)


def interrupted(out, planner, **settings):
    with pytest.raises(KeyboardInterrupt) as stop:
        crowdbench.run(planner, cases=502, out=out, record="none", **settings)
    return "\n".join(stop.value.__notes__)


@pytest.mark.slow
@pytest.mark.parametrize("key", [pytest.param(None, marks=pytest.mark.slow), "mine 1"])
def test_a_planner_object_is_resumed_by_its_key_alone(tmp_path, key):
    notes = interrupted(tmp_path / "a", Mine(1.0, stops=True), key=key)
    assert ("the same command goes on" in notes) == (key is not None)
    assert ("run(..., key=...)" in notes) == (key is None)
    told = []
    other = crowdbench.run(
        Mine(0.5), cases=502, out=tmp_path / "a", record="none", key=key and "mine 2", progress=told.append
    )
    assert sum(told) == pytest.approx(502.0)
    pace = other.episodes.columns["path_length"] / (0.25 * other.episodes.steps)
    assert pace == pytest.approx(0.5, rel=0.1)
    [kept] = tmp_path.glob("a.parts-*")
    if key:
        steps = []
        result = crowdbench.run(
            Mine(1.0), cases=502, out=tmp_path / "a", record="none", key=key, overwrite=True, progress=steps.append
        )
        assert len(steps) < 100  # the first 500 cases come at once
        assert len(result.episodes) == 502
        assert not kept.exists()


@pytest.mark.slow
def test_a_finished_run_leaves_the_kept_parts_of_others(tmp_path):
    interrupted(tmp_path / "a", Mine(1.0, stops=True), key="mine")
    crowdbench.run("orca", cases=501, out=tmp_path / "a", record="none")
    [kept] = tmp_path.glob("a.parts-*")
    assert read_result(kept / "test-0-500")["run"]["planner"]["key"] == "mine"


FROM_STDIN = """
import numpy as np
import crowdbench

class Still(crowdbench.Planner):
    def plan(self, obs):
        return np.zeros((len(obs), 2))

print(crowdbench.run(Still(), cases=1).cases)
"""


@pytest.mark.slow
def test_a_class_without_a_file_is_driven():
    done = subprocess.run([sys.executable, "-"], input=FROM_STDIN, capture_output=True, text=True)
    assert done.stdout == "test:0:1\n", done.stderr


def test_a_key_without_an_object_is_refused():
    with pytest.raises(crowdbench.InputError, match=r"^key is for what was made in Python"):
        crowdbench.run("orca", cases=1, key="mine")


def test_metrics_that_are_functions_are_not_resumed_without_a_key_either(tmp_path):
    def near(limit):
        return {"near": lambda trace: trace.gap.min(axis=1) < limit}

    def id_of(out, **settings):
        crowdbench.run("orca", cases=2, out=tmp_path / out, record="none", **settings)
        return read_result(tmp_path / out)["id"]

    # The values of a closure have no source: two limits look alike.
    assert id_of("a", metrics=near(0.1)) != id_of("b", metrics=near(0.2))
    assert id_of("c", metrics=near(0.1), key="0.1") == id_of("d", metrics=near(0.1), key="0.1")
    assert id_of("e", metrics=near(0.2), key="0.2") != id_of("f", metrics=near(0.1), key="0.1")
    assert id_of("g") == id_of("h")


@pytest.fixture
def mine(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text(FILE)
    (tmp_path / "helper.py").write_text("ZERO = 0.0\n")
    (tmp_path / "near.py").write_text("def metric(trace):\n    return trace.gap.min(axis=1)\n")
    return RunSpec("./mine.py", "circle_crossing_5", Cases.parse("8"), metrics=("./near.py",))


CHANGES = {
    "an option": {"options": {"pace": 0.5}},
    "a radius": {"overrides": {"vehicle.radius": 0.2}},
    "the rule of collisions": {"overrides": {"collision": "crowdnav"}},
    "cases": {"cases": Cases.parse("9")},
    "replanning": {"replanning": Replanning(8)},
    "the batch of a planner of one's own": {"batch": 4},
    "the decision limit": {"decision_limit": 30.0},
    "another metric": {"metrics": ()},
    "pedestrians": {"pedestrians": "social_force"},
}


@pytest.mark.parametrize("change", CHANGES)
def test_what_changes_a_figure_makes_another_run(mine, change):
    assert load_run(dataclasses.replace(mine, **CHANGES[change])).id.digest != load_run(mine).id.digest


@pytest.mark.parametrize("change", [{"record": "none"}, {"overrides": {"vehicle.radius": 0.3}}, {"isolated": True}])
def test_what_changes_no_figure_makes_no_other_run(mine, change):
    assert load_run(dataclasses.replace(mine, **change)).id == load_run(mine).id


@pytest.mark.parametrize("file", ["mine.py", "helper.py", "near.py"])
def test_every_file_of_a_plug_in_counts(mine, tmp_path, file):
    before = load_run(mine).id
    (tmp_path / file).write_text((tmp_path / file).read_text() + "CONSTANT = 1\n")
    assert load_run(mine).id != before


def test_batches_count_only_where_they_move_the_last_bits():
    orca, learned = (RunSpec(name, "circle_crossing_5", Cases.parse("8")) for name in ("orca", "sarl_cvm"))
    assert [load_run(dataclasses.replace(each, batch=4)).id == load_run(each).id for each in (orca, learned)] == [
        True,
        False,
    ]


def test_every_file_and_folder_that_a_rollout_reaches_exists():
    for name in identity.REACHED:
        assert ((identity.ROOT if name.startswith("agents/") else identity.PACKAGE) / name).exists()


DRIVE = """
import sys
from crowdbench import Cases, Driver, load_planner, load_scenario
from crowdbench.catalog import PLANNERS
from crowdbench.runs.rollout import rollout
drivers = [Driver(load_planner(name), name) for name in PLANNERS.built_in()]
rollout(Driver(load_planner("orca"), "orca"), load_scenario("circle_crossing_5"), Cases("test", 0, 1))
print(*(module.__file__ for name, module in sys.modules.items() if name.startswith("crowdbench.")))
"""


@pytest.mark.slow
def test_the_digest_of_code_covers_what_shipped_planners_and_a_rollout_load():
    loaded = subprocess.run([sys.executable, "-c", DRIVE], capture_output=True, text=True, check=True).stdout.split()
    names = {Path(file).relative_to(identity.PACKAGE).as_posix() for file in loaded}
    covered = {name for name in names for part in identity.REACHED if name == part or name.startswith(f"{part}/")}
    assert len(covered) > 80
    assert names - covered == {"envs/__init__.py", "envs/registration.py", "runs/__init__.py"}


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A copy of the package and its pedestrian policies; returns the digests of code and of metrics after an edit."""
    for folder in (identity.PACKAGE, identity.ROOT / "agents" / "pedestrians"):
        copy = tmp_path / folder.relative_to(identity.ROOT)
        shutil.copytree(folder, copy, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(identity, "PACKAGE", tmp_path / "crowdbench")
    monkeypatch.setattr(identity, "ROOT", tmp_path)

    def digests(file=None):
        if file:
            with (tmp_path / file).open("ab") as opened:
                opened.write(b"# edited")
        identity.source_digest.cache_clear()
        return identity.code(), identity.source_digest("metrics")

    yield digests
    identity.source_digest.cache_clear()


EDITS = {
    "crowdbench/sim/episode.py": (True, False),
    "crowdbench/scenario/layouts/walled.py": (True, False),
    "crowdbench/planners/lookahead.py": (True, False),
    "crowdbench/core/types/__init__.pyi": (True, False),
    "crowdbench/runs/rollout.py": (True, False),
    "agents/pedestrians/orca.py": (True, False),
    "agents/pedestrians/learned/learned-seed0.safetensors": (True, False),
    "crowdbench/metrics/motion.py": (False, True),
    "crowdbench/cli/cases.py": (False, False),
    "crowdbench/runs/replay.py": (False, False),
    "crowdbench/sim/__pycache__/episode.cpython-311.pyc": (False, False),
}
"""Whether an edit of a file changes the digests of the code and of the metrics."""


def test_an_edit_of_a_file_that_a_rollout_reaches_makes_another_run(package, tmp_path):
    (tmp_path / "crowdbench" / "sim" / "__pycache__").mkdir()
    for file, changes in EDITS.items():
        before = package()
        assert tuple(a != b for a, b in zip(before, package(file), strict=True)) == changes, file


def test_a_copy_of_the_package_has_the_same_digest(package):
    copied = package()
    assert copied == package()
    (identity.PACKAGE / "sim" / "episode.py").rename(identity.PACKAGE / "sim" / "episodes.py")
    assert package() != copied


CELL = """
class Mine:
    pace = 1

    def __call__(self, trace):
        return 2


def mine(trace):
    return 1
"""


def run_cell(text):
    """Execute a notebook cell as IPython does, and return its names."""
    name, space = f"<cell {text!r}>", {"__name__": "a notebook"}
    linecache.cache[name] = (len(text), None, text.splitlines(True), name)
    exec(compile(text, name, "exec"), space)
    return space


def test_code_of_a_notebook_cell_has_the_digest_of_its_text():
    first, other, changed = (run_cell(text) for text in (CELL, f"{CELL}x = 1\n", CELL.replace("pace = 1", "pace = 2")))
    for name in ("Mine", "mine"):
        assert identity.source_of(first[name]) == identity.source_of(other[name])
    assert (
        identity.source_of(first["Mine"]()) == identity.source_of(first["Mine"]) != identity.source_of(changed["Mine"])
    )
    assert identity.source_of(first["mine"]) == identity.source_of(changed["mine"])
