"""Compiled code on disk: never out of date, and never in the way."""

import ast
import gc
import importlib
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numba
import numpy as np
import pytest

import crowdbench
from crowdbench.utils import compiled
from crowdbench.utils.compiled import kernel_files, njit

PACKAGE = Path(crowdbench.__file__).parent
LIMIT = 2.0

GAP_OF_A_STEP = """
import numpy as np
from crowdbench.core.types import Outcome, Rules
from crowdbench.sim.episode import StepCheck, check_step
from crowdbench.sim.simulator import After, Before

position = np.zeros((1, 2, 2))
position[0, 1, 0] = 50.0
step, still, history = np.zeros(1, np.int64), (position * 0.0, np.zeros(1), np.zeros(1)), np.empty((1, 0, 1, 2))
ones, present, walls = np.ones((1, 2)), np.ones((1, 2), bool), np.empty((1, 0, 0, 2))
policy = np.zeros((1, 1), np.int64)
before = Before(step, step + 9, position, *still, ones, ones, present, policy, position + 9.0, history, walls)
check = StepCheck(np.zeros(1, np.int64), np.zeros(1), np.zeros(1))
check_step(Rules().numbers, before, After(step, position, *still, history), check)
print(Outcome(check.outcome[0]).name, check.gap[0], sum(check_step.stats.cache_hits.values()))
"""

KERNEL = """
from crowdbench.utils.compiled import njit
from helper import SLOPE, shift

@njit
def line(x):
    return SLOPE * shift(x)
"""

HELPER = """
from crowdbench.utils.compiled import njit

SLOPE = 2.0

@njit
def shift(x):
    return x + 1.0
"""

CALL = "from mine import line; print(line(1.0), sum(line.stats.cache_hits.values()))"


@njit
def half(x):
    return x / 2.0


def limited(x):
    return min(half(x), LIMIT)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty folder in which compiled code is kept."""
    monkeypatch.setattr(compiled.config, "CACHE_DIR", str(tmp_path))
    compiled._folder_of.cache_clear()
    yield tmp_path
    compiled._folder_of.cache_clear()


def hits():
    """How often `limited`, made again as in a new process, is found on disk when it is called."""
    kernel = njit(limited)
    assert kernel(6.0) == 2.0
    return sum(kernel.stats.cache_hits.values())


def run(code, folder, package=PACKAGE.parent):
    """The words that a Python process prints in a folder, with a cache beside it."""
    variables = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    variables |= {"XDG_CACHE_HOME": str(folder.parent / "cache"), "PYTHONPATH": f"{folder}{os.pathsep}{package}"}
    command = [sys.executable, "-c", code]
    return subprocess.check_output(command, env=variables, cwd=folder, text=True).split()


def versions(folder):
    """The versions in the cache beside a folder."""
    return set((folder.parent / "cache").glob("*/kernels/*"))


@pytest.mark.nightly
def test_an_edit_acts_at_once_in_functions_of_other_files(tmp_path):
    first, second = tmp_path / "first", tmp_path / "second"
    for folder in (first, second):
        shutil.copytree(PACKAGE, folder / "crowdbench", ignore=shutil.ignore_patterns("__pycache__"))
    assert run(GAP_OF_A_STEP, first, first) == ["RUNNING", "48.0", "0"]
    assert run(GAP_OF_A_STEP, second, second) == ["RUNNING", "48.0", "1"], "a second clone compiles nothing"
    geometry = first / "crowdbench" / "core" / "geometry.py"
    edited = geometry.read_text().replace("return least, nearest", "return least - 100.0, nearest")
    assert edited != geometry.read_text()
    geometry.write_text(edited)
    assert run(GAP_OF_A_STEP, first, first) == ["COLLISION", "-52.0", "0"]
    assert run(GAP_OF_A_STEP, second, second) == ["RUNNING", "48.0", "1"], "each clone keeps what it needs"


@pytest.mark.slow
@pytest.mark.parametrize(("old", "new"), [("x + 1.0", "x + 2.0"), ("SLOPE = 2.0", "SLOPE = 3.0")])
def test_an_edit_of_a_file_beside_a_plug_in_acts_at_once(tmp_path, old, new):
    folder = tmp_path / "plugin"
    folder.mkdir()
    (folder / "mine.py").write_text(KERNEL)
    (folder / "helper.py").write_text(HELPER)
    assert run(CALL, folder) == ["4.0", "0"]
    assert run(CALL, folder) == ["4.0", "1"]
    (folder / "helper.py").write_text(HELPER.replace(old, new))
    assert run(CALL, folder) == ["6.0", "0"]


@pytest.mark.slow
def test_constants_of_kernels_are_defined_in_files_that_count():
    counted = set(kernel_files())
    for path in counted:
        for source in ast.walk(ast.parse(path.read_text())):
            if isinstance(source, ast.ImportFrom):
                for alias in source.names:
                    check_origin(source.module, alias.name, path, counted)


def check_origin(module, name, path, counted):
    """Check that a constant which a file with kernels imports is defined in a file that counts."""
    value = getattr(importlib.import_module(module), name)
    if module.startswith("crowdbench") and isinstance(value, int | float | tuple) and name.isupper():
        folder = PACKAGE.joinpath(*module.split(".")[1:])
        files = sorted(folder.glob("*.py")) if folder.is_dir() else [folder.with_suffix(".py")]
        defining = [file for file in files if f"\n{name} = " in file.read_text() or f"\n{name}: " in file.read_text()]
        is_used = any(name in ast.unparse(function) for function in kernels_in(path))
        assert not is_used or set(defining) <= counted, (path, name)


def kernels_in(path):
    """The kernels that a file defines, as syntax trees."""
    for function in ast.walk(ast.parse(path.read_text())):
        if isinstance(function, ast.FunctionDef) and any("njit" in ast.unparse(at) for at in function.decorator_list):
            yield function


def test_functions_in_a_function_differ_by_their_variables(folder):
    def make(limit, kernel):
        return njit(lambda x: kernel(x) + limit)

    other = njit(lambda x: x * 3.0)
    for kernel, limit, expected in ((half, 1.0, 3.0), (half, 2.0, 4.0), (other, 1.0, 13.0)):
        for found in (0, 1):
            made = make(limit, kernel)
            assert made(4.0) == expected
            assert sum(made.stats.cache_hits.values()) == found


def test_versions_that_are_not_used_for_long_go(folder):
    (old, recent) = (folder / "crowdbench" / "kernels" / name for name in ("old", "recent"))
    for path in (old, recent):
        path.mkdir(parents=True)
    os.utime(old, times=(time.time() - 2 * compiled.LONGEST_UNUSED,) * 2)
    assert hits() == 0
    assert not old.exists()
    assert recent.exists()


@pytest.mark.parametrize("suffix", ["nbi", "nbc"])
@pytest.mark.parametrize("damage", [b"", b"damaged"])
def test_a_damaged_file_is_made_again(folder, suffix, damage):
    assert hits() == 0
    assert hits() == 1
    (path,) = folder.rglob(f"*limited*.{suffix}")
    path.write_bytes(damage)
    assert hits() == 0
    assert hits() == 1


def test_a_folder_that_goes_away_stops_nothing(folder):
    assert hits() == 0
    shutil.rmtree(folder)
    folder.write_text("a file is in its place")
    assert hits() == 0


def test_a_run_works_where_nothing_can_be_kept(folder, monkeypatch):
    monkeypatch.setattr(compiled.config, "CACHE_DIR", "/dev/null/cache")
    compiled._folder_of.cache_clear()
    assert hits() == 0
    assert hits() == 0


def test_a_function_without_a_file_is_compiled():
    scope = {"half": half}
    exec("def doubled(x):\n    return half(x) * 4.0\n", scope)
    assert njit(scope["doubled"])(2.0) == 4.0


def test_code_of_a_file_that_was_edited_after_its_import_is_not_kept(folder, monkeypatch):
    kernel = njit(limited)
    monkeypatch.setattr(compiled, "read_version", lambda folder: "another")
    assert kernel(6.0) == 2.0
    monkeypatch.undo()
    assert not list(folder.rglob("*limited*"))


def test_kernels_use_this_cache_only():
    others = [path for path in PACKAGE.rglob("*.py") if path.name != "compiled.py"]
    assert [path.name for path in others if "from numba import" in path.read_text()] == []


@pytest.mark.parametrize(
    ("variable", "value", "sentence"),
    [
        ("NUMBA_NUM_THREADS", "0", "numba does not start with NUMBA_NUM_THREADS=0: "),
        ("NUMBA_NUM_THREADS", "many", "numba does not start: Environment variable 'NUMBA_NUM_THREADS' "),
        ("NUMBA_DISABLE_JIT", "yes", "numba does not start: Environment variable 'NUMBA_DISABLE_JIT' "),
    ],
)
def test_a_variable_that_numba_refuses_gets_one_sentence(tmp_path, variable, value, sentence):
    command = [
        sys.executable,
        "-m",
        "crowdbench",
        "run",
        "--planner",
        "orca",
        "--cases",
        "1",
        "--out",
        tmp_path / "run",
    ]
    done = subprocess.run(command, env=os.environ | {variable: value}, capture_output=True, text=True)
    assert done.returncode == 1
    assert done.stderr.startswith(f"crowdbench: {sentence}")
    assert done.stderr.count("\n") == 1


WITHOUT_COMPILATION = """
import sys
import numpy as np
from crowdbench import Cases, load_scenario, parallel_env, rollout

def episodes():
    for planner, scenario in (("orca", "circle_crossing_5"), ("social_force", "door_10")):
        yield rollout(planner, load_scenario(scenario, {"time_limit": 1.5}), Cases.parse("val/3")).position
    for observation in ("flat", "dict"):
        env = parallel_env("circle_crossing_5", observation=observation)
        env.reset(options={"case": "val/3"})
        seen = env.step({"vehicle": np.array([0.1, 0.2])})[0]["pedestrian_0"]
        yield seen if observation == "flat" else seen["history"]

np.savez(sys.argv[1], *episodes())
"""


@pytest.mark.slow
def test_episodes_are_the_same_without_compilation(tmp_path):
    files = [tmp_path / "compiled.npz", tmp_path / "slow.npz"]
    for value, file in enumerate(files):
        variables = os.environ | {"NUMBA_DISABLE_JIT": str(value)}
        command = [sys.executable, "-W", "error", "-c", WITHOUT_COMPILATION, str(file)]
        subprocess.run(command, env=variables, check=True)
    with np.load(files[0]) as fast, np.load(files[1]) as slow:
        assert len(fast.files) == 4
        for name in fast.files:
            np.testing.assert_allclose(fast[name], slow[name], rtol=0.0, atol=1e-12)


def test_garbage_is_collected_again_after_a_kernel_was_compiled_or_could_not_be():
    assert gc.isenabled()
    numba.njit(lambda x: x + 1.5)(2)
    assert gc.isenabled()
    with pytest.raises(numba.TypingError):
        numba.njit(lambda x: x.missing)(2)
    assert gc.isenabled()
    gc.disable()
    numba.njit(lambda x: x + 2.5)(2)
    assert not gc.isenabled()
    gc.enable()
