"""Compares commands with an empty cache of kernels, with a filled one, and in a second clone that shares the cache.

python -m benchmarks.first_runs
python -m benchmarks.first_runs pytest 'bash .ci/run'

The last column is the processor time of a run with an empty cache beyond that of a run with a filled one, as a
multiple of the processor time of importing NumPy and numba.

Both clones contain the last commit: commit changes before measuring them.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from statistics import median
from typing import Annotated

import typer

from benchmarks.commands import Usage, run_timed
from crowdbench.cli import main, print_table, progress
from crowdbench.utils import Grid

ROOT = Path(__file__).parents[1]

COMMANDS = [
    "crowdbench run --planner orca --cases 1 --overwrite",
    "crowdbench run --planner sarl_sgan_kce --cases 1 --overwrite",
    "crowdbench run --planner sarl_sgan_kce --overwrite",
]

STATES = {"empty cache": "first", "filled cache": "first", "second clone, filled cache": "second"}
"""The clone that a command runs in, for each state of the cache, in this order."""


def first_runs(
    commands: Annotated[list[str] | None, typer.Argument(show_default="three runs")] = None, rounds: int = 1
) -> None:
    """Print processor time and elapsed time of commands with an empty and with a filled cache of kernels.

    Args:
        commands: Shell commands. They run in the root of a clone, with its package and with this Python's programs.
        rounds: Number of runs of each command in each state, in turns; medians are printed.
    """
    commands = commands or COMMANDS
    with (
        tempfile.TemporaryDirectory() as folder,
        progress(len(commands) * rounds * len(STATES), "of all runs") as tell,
    ):
        for clone in {Path(folder, clone) for clone in STATES.values()}:
            subprocess.run(["git", "clone", "--quiet", ROOT, clone], check=True)
            # As pip does: otherwise the first run in each clone would take longer.
            subprocess.run([sys.executable, "-m", "compileall", "-q", clone / "crowdbench"], check=True)
        rows = [row for command in commands for row in measure(command, rounds, Path(folder), tell)]
    heads = "command", "state", "processor time", "elapsed time", "kernels compiled", "compilation / import of numba"
    print_table(Grid("First and later runs", heads, rows, align="llrrrr"))


def measure(command: str, rounds: int, folder: Path, progress: Callable[[float], None]) -> Iterator[list[str]]:
    """Yield the rows of a command, one for each state.

    Args:
        command: The command.
        rounds: Number of runs in each state.
        folder: The folder that holds the clones.
        progress: Called with 1 after each run.
    """
    cache = folder / "cache"
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    found: dict[str, list[tuple[Usage, int]]] = {state: [] for state in STATES}
    imports = []
    for _ in range(rounds):
        imports.append(run_timed([sys.executable, "-c", "import numpy, numba"], "import of numba").processor)
        shutil.rmtree(cache, ignore_errors=True)
        before = 0
        for state, name in STATES.items():
            clone = folder / name
            environment = {"PATH": path, "PYTHONPATH": str(clone), "NUMBA_CACHE_DIR": str(cache)}
            usage = run_timed(["sh", "-c", command], command, clone, **environment)
            kept = len(list(cache.rglob("*.nbc")))
            found[state].append((usage, kept - before))
            before = kept
            progress(1)
    processor, elapsed = (
        {state: median(getattr(usage, name) for usage, _ in runs) for state, runs in found.items()}
        for name in ("processor", "seconds")
    )
    first, later, _ = STATES
    ratio = (processor[first] - processor[later]) / median(imports)
    for state, runs in found.items():
        times = f"{processor[state]:.3g} s", f"{elapsed[state]:.3g} s"
        yield [
            command,
            state,
            *times,
            f"{max(kernels for _, kernels in runs)}",
            f"{ratio:.3g}" if state == first else "",
        ]


if __name__ == "__main__":
    main(first_runs)
