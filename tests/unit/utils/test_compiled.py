"""Compiled code on disk: never out of date, never damaged, and never in the way."""

import gc
import os
import shutil
import subprocess
import sys
import time
from collections import namedtuple
from pathlib import Path

import numba
import pytest

import crowdbench
from crowdbench.utils.compiled import kernel_files as store
from crowdbench.utils.compiled import named_tuples, njit
from crowdbench.utils.compiled.kernel_key import kernel_key

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
before = Before(step, position, *still, ones, ones, present, policy, position + 9.0, history, walls)
check = StepCheck(np.zeros(1, np.int64), np.zeros(1), np.zeros(1))
check_step(Rules().numbers, before, After(step, position, *still, history), check)
print(Outcome(check.outcome[0]).name, check.gap[0])
"""


@njit
def half(x):
    return x / 2.0


def limited(x):
    return min(half(x), LIMIT)


def length(x):
    return len(os.environ)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty folder in which compiled code is kept."""
    monkeypatch.setattr(store, "_places", lambda: (store._Place(tmp_path, private=False),))
    return tmp_path


@pytest.fixture
def no_folder(monkeypatch):
    """A user who can write neither in the package nor at home, with nothing chosen so far."""
    monkeypatch.setattr(store.config, "CACHE_DIR", "")
    monkeypatch.setenv("XDG_CACHE_HOME", "/dev/null/cache")
    store._places.cache_clear()
    yield
    store._places.cache_clear()


def hits(expected=2.0):
    """How often `limited`, made anew as in a new process, is found on disk when it is called."""
    kernel = njit(limited)
    assert kernel(6.0) == expected
    return sum(kernel.stats.cache_hits.values())


def run(code, folder):
    """The words that a Python process prints in a folder that holds the package, beside which there is a cache."""
    variables = {name: value for name, value in os.environ.items() if name not in ("NUMBA_CACHE_DIR", "PYTHONPATH")}
    variables["XDG_CACHE_HOME"] = str(folder.parent / "cache")
    command = [sys.executable, "-c", code]
    return subprocess.check_output(command, env=variables, cwd=folder, text=True).split()


def clone(folder):
    """A copy of the package, as in a second installation."""
    return shutil.copytree(PACKAGE, folder / "crowdbench", ignore=shutil.ignore_patterns("__pycache__"))


@pytest.mark.slow
def test_an_edit_acts_at_once_in_functions_of_other_files(tmp_path):
    first, second = tmp_path / "first", tmp_path / "second"
    package = clone(first)
    assert run(GAP_OF_A_STEP, first) == ["RUNNING", "48.0"]
    kept = set((tmp_path / "cache").rglob("*-*"))
    assert any(path.name.startswith("check_step-") for path in kept)
    clone(second)
    assert run(GAP_OF_A_STEP, second) == ["RUNNING", "48.0"]
    assert set((tmp_path / "cache").rglob("*-*")) == kept, "a second clone compiles nothing"
    geometry = package / "core" / "geometry.py"
    edited = geometry.read_text().replace("return least, nearest", "return least - 100.0, nearest")
    assert edited != geometry.read_text()
    geometry.write_text(edited)
    assert run(GAP_OF_A_STEP, first) == ["COLLISION", "-52.0"]
    assert set((tmp_path / "cache").rglob("*-*")) > kept, "two clones with different sources keep what each needs"


@pytest.mark.parametrize(("name", "value"), [("LIMIT", 2.5), ("LIMIT", 2), ("half", njit(limited))])
def test_the_digest_follows_constants_and_called_functions(monkeypatch, name, value):
    before = kernel_key(njit(limited))
    assert kernel_key(njit(limited)) == before
    monkeypatch.setitem(globals(), name, value)
    assert kernel_key(njit(limited)) != before


def test_the_digest_follows_the_options_of_the_compiler():
    assert len({kernel_key(njit(**options)(limited)) for options in ({}, {"parallel": True}, {"nogil": True})}) == 3


def test_a_global_whose_changes_would_pass_unnoticed_is_refused(folder):
    with pytest.raises(TypeError, match=r"os in kernel test_compiled\.length is neither a constant nor a kernel"):
        njit(length)(1.0)


def test_equal_kernels_of_two_modules_share_a_file(folder):
    source = "def doubled(x):\n    return half(x) * 4.0\n"
    for module in ("crowdbench", "test_compiled"):
        scope = {"half": half, "__name__": module}
        exec(source, scope)
        kernel = njit(scope["doubled"])
        assert kernel(2.0) == 4.0
    assert sum(kernel.stats.cache_hits.values()) == 1
    assert len(list(folder.glob("doubled-*"))) == 1


def test_the_digest_tells_which_of_two_kernels_is_called_where():
    def kernel(**called):
        scope = {"__name__": __name__, **called}
        exec("def twice(x):\n    return f(x) + g(x) + h(x)\n", scope)
        return kernel_key(njit(scope["twice"]))

    one, other = njit(lambda x: x + 1.0), njit(lambda x: x + 2.0)
    calls = [(a, b, c) for a in (one, other) for b in (one, other) for c in (one, other)]
    assert len({kernel(f=a, g=b, h=c) for a, b, c in calls}) == len(calls)


def test_the_key_follows_the_constants_of_a_closure():
    def make(limit, kernel):
        return njit(lambda x: [kernel(limit) + y for y in (x, LIMIT)])

    one, other = njit(lambda x: x + 1.0), njit(lambda x: x + 2.0)
    assert kernel_key(make(1.0, one)) == kernel_key(make(1.0, one))
    assert len({kernel_key(make(limit, kernel)) for limit in (1.0, 1, 2.0) for kernel in (one, other)}) == 6


def test_files_that_are_old_or_too_many_go(folder, monkeypatch):
    def make(name, age, size):
        (folder / name).write_bytes(bytes(size))
        os.utime(folder / name, times=(time.time() - age * store.DAY,) * 2)

    monkeypatch.setattr(store, "LARGEST_FOLDER", 1e6)
    for name, age, size in (("a", 91, 1), (".b.killed", 200, 1), ("c", 50, 600_000), ("d", 40, 500_000), ("e", 1, 9)):
        make(name, age, size)
    store._remove_unused.cache_clear()
    store.write("f", b"new")
    assert {path.name for path in folder.iterdir()} == {"d", "e", "f"}


def test_a_file_that_is_used_is_not_old(folder):
    store.write("a", b"new")
    os.utime(folder / "a", times=(0.0, 0.0))
    assert store.read("a") == b"new"
    assert time.time() - (folder / "a").stat().st_mtime < store.DAY


@pytest.mark.parametrize("damage", ["empty", "cut", "zeroed", "flipped"])
def test_a_damaged_file_is_made_anew(folder, damage):
    assert hits() == 0
    assert hits() == 1
    (path,) = folder.glob("*limited*")
    whole = path.read_bytes()
    middle = len(whole) // 2
    path.write_bytes(
        {
            "empty": b"",
            "cut": whole[:-100],
            "zeroed": bytes(len(whole)),
            "flipped": whole[:middle] + bytes([whole[middle] ^ 1]) + whole[middle + 1 :],
        }[damage]
    )
    assert hits() == 0
    assert path.read_bytes() != b""
    assert hits() == 1


def test_a_folder_that_goes_away_stops_nothing(folder):
    assert hits() == 0
    shutil.rmtree(folder)
    folder.write_text("a file is in its place")
    assert hits() == 0


def test_without_a_home_and_with_a_package_that_cannot_be_written_a_private_folder_is_used(
    no_folder, tmp_path, monkeypatch
):
    monkeypatch.setattr(store.tempfile, "tempdir", str(tmp_path))
    assert hits() == 0
    assert hits() == 1
    (private,) = tmp_path.iterdir()
    assert private.stat().st_mode & 0o777 == 0o700
    # Whoever may write there can have put machine code of his own there.
    private.chmod(0o777)
    store._places.cache_clear()
    assert hits() == 0


def test_a_run_works_where_nothing_can_be_kept(no_folder, monkeypatch):
    monkeypatch.setattr(store.tempfile, "tempdir", "/dev/null")
    assert hits() == 0
    assert hits() == 0


def test_kernels_use_this_cache_only():
    others = [path for path in PACKAGE.rglob("*.py") if path.parent.name != "compiled"]
    assert [path.name for path in others if "from numba import" in path.read_text()] == []


def test_a_number_of_threads_that_numba_refuses_gets_one_sentence(tmp_path):
    command = [sys.executable, "-m", "crowdbench", "run", "--planner", "orca", "--out", str(tmp_path / "kept")]
    done = subprocess.run(command, env=os.environ | {"NUMBA_NUM_THREADS": "0"}, capture_output=True, text=True)
    assert done.returncode == 1
    assert done.stderr.startswith("crowdbench: numba does not start with NUMBA_NUM_THREADS=0: ")
    assert len(done.stderr.splitlines()) == 1


def test_named_tuples_whose_fields_differ_are_different_arguments():
    names = [("x", "y"), ("y", "x")]
    first, second = (numba.typeof(namedtuple("Pair", fields)(1.0, 2.0)) for fields in names)
    assert repr(first) == repr(second)
    assert named_tuples([first]) != named_tuples([second])


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
