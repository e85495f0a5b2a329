"""Fixtures of all tests. `--shapes` checks shapes at every call; tests skip if their reference data is missing."""

import os
import pkgutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings
from jaxtyping import install_import_hook

import crowdbench

# Tests run in several processes, whose networks' threads would get in each other's way. Of numba's own threads
# torch knows nothing; OpenMP's they would share, and numba would give torch as many as itself.
os.environ |= {"OMP_NUM_THREADS": "1"}

SHARED = "CROWDBENCH_SHARED"
COMMANDS = "crowdbench.cli"

# The same examples at every run, and nothing left in the folder.
settings.register_profile("reproducible", derandomize=True, database=None, deadline=None)
settings.load_profile("reproducible")


def pytest_addoption(parser):
    # Not by default: it takes four times as long.
    parser.addoption("--shapes", action="store_true", help="check the shapes in annotations at every call")


def pytest_configure(config):
    if config.getoption("--shapes"):
        # Commands take no arrays, and typer gives them a context that is not of the class that it names.
        checked = [
            module.name
            for module in pkgutil.iter_modules(crowdbench.__path__, "crowdbench.")
            if module.name != COMMANDS
        ]
        install_import_hook(checked, "typecheck.checked")


@pytest.fixture(autouse=True)
def one_thread():
    """Let networks compute in one thread again, because a resumed training sets its own number of threads."""
    yield
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(1)


@pytest.fixture
def call(monkeypatch, capfd):
    """Run a command in this process, from its arguments to its exit status and all that it prints."""
    from crowdbench.cli import app as cli  # after the hook that checks shapes

    monkeypatch.setattr(cli.interrupts, "handle", lambda: None)
    monkeypatch.setattr(cli.watchdog, "enable", lambda: None)  # its process would hold files that tests have open

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["crowdbench", *arguments])
        with pytest.raises(SystemExit) as stop:
            cli.main()
        return subprocess.CompletedProcess(sys.argv, stop.value.code or 0, *capfd.readouterr())

    return run


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder with reference data, which does not come with the project."""
    path = os.environ.get(SHARED)
    if path is None:
        pytest.skip(f"needs the reference data: set {SHARED} to the folder that holds it")
    assert Path(path).is_dir(), f"{SHARED} is {path}, which is no folder"
    return Path(path)


@pytest.fixture
def reference(shared):
    """Opens one of the reference files."""
    return lambda name: np.load(shared / "reference" / f"{name}.npz")


@pytest.fixture
def study_folder(tmp_path, monkeypatch):
    """An empty folder to be in, with a planner that has networks."""
    from study_folders import MINE

    monkeypatch.chdir(tmp_path)
    Path("mine.py").write_text(MINE)
    Path("weights.json").write_text('{"one": 0.2, "two": 0.1}')
