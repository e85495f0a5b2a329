"""Compiled code on disk: never out of date, never damaged, and never in the way."""

import gc
import os
import shutil
import subprocess
import sys
import threading
from collections import namedtuple
from pathlib import Path

import numba
import numpy as np
import pytest

import crowdbench
from crowdbench.sim.pedestrians import orca
from crowdbench.utils.compiled import named_tuples, njit, store
from crowdbench.utils.compiled.digest import code_digest

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
before = Before(step, position, *still, ones, ones, present, position + 9.0, history, walls)
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
    monkeypatch.setattr(store, "PACKAGE", Path("/dev/null"))
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
    """The words that a Python process prints in a folder that holds the package."""
    variables = {name: value for name, value in os.environ.items() if name not in ("NUMBA_CACHE_DIR", "PYTHONPATH")}
    command = [sys.executable, "-c", code]
    return subprocess.check_output(command, env=variables, cwd=folder, text=True).split()


@pytest.mark.slow
def test_an_edit_acts_at_once_in_functions_of_other_files(tmp_path):
    package = shutil.copytree(PACKAGE, tmp_path / "crowdbench", ignore=shutil.ignore_patterns("__pycache__"))
    assert run(GAP_OF_A_STEP, tmp_path) == ["RUNNING", "48.0"]
    geometry = package / "core" / "geometry.py"
    edited = geometry.read_text().replace("return least, nearest", "return least - 100.0, nearest")
    assert edited != geometry.read_text()
    geometry.write_text(edited)
    assert run(GAP_OF_A_STEP, tmp_path) == ["COLLISION", "-52.0"]
    kernels = [path.name.partition("-")[0] for path in (package / "__pycache__" / "kernels").iterdir()]
    assert {"crowdbench.core.geometry.nearest_in_step", "crowdbench.sim.episode.check_step"} < set(kernels)
    assert len(kernels) == len(set(kernels)), "one file each is left, since those that are out of date are removed"


@pytest.mark.parametrize(("name", "value"), [("LIMIT", 2.5), ("LIMIT", 2), ("half", njit(limited))])
def test_the_digest_follows_constants_and_called_functions(monkeypatch, name, value):
    before = code_digest(njit(limited))
    assert code_digest(njit(limited)) == before
    monkeypatch.setitem(globals(), name, value)
    assert code_digest(njit(limited)) != before


def test_the_digest_follows_the_options_of_the_compiler():
    assert len({code_digest(njit(**options)(limited)) for options in ({}, {"parallel": True}, {"nogil": True})}) == 3


def test_a_global_whose_changes_would_pass_unnoticed_is_refused(folder):
    with pytest.raises(TypeError, match=r"kernel test_compiled\.length: .* is neither a constant nor a kernel"):
        njit(length)(1.0)


def test_only_files_of_the_same_function_that_are_out_of_date_are_removed(folder, monkeypatch):
    assert hits() == 0
    assert njit(limited)(np.float32(2.0)) == 1.0
    (folder / f".{next(folder.glob('*limited*')).name.replace('limited-', 'limited-0')}.killed").touch()
    (folder / "test_compiled.limited_too-0-0.cpython-311").touch()
    before = set(folder.iterdir())
    monkeypatch.setitem(globals(), "LIMIT", 2.5)
    assert hits(2.5) == 0
    removed = before - set(folder.iterdir())
    assert len(removed) == 3
    assert all("limited-" in path.name for path in removed)


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


def test_several_threads_may_run_the_simulator(monkeypatch):
    # The tests use numba's layer workqueue, which ends the process when two threads enter it.
    monkeypatch.setattr(orca, "PARALLEL_AGENTS", 0)
    position = np.random.default_rng(0).normal(size=(40, 6, 2)) * 9.0
    size, speed = np.full((40, 6), 0.3), np.ones((40, 6))
    results = []

    def compute():
        for _ in range(30):
            results.append(orca.orca_velocities(position, position * 0.0, -position, size, speed))

    threads = [threading.Thread(target=compute) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(results) == 120
    assert all(np.array_equal(one, results[0]) for one in results)


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
