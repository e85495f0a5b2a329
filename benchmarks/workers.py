"""Compares a run in one process with the same run on workers of this machine, of Ray and of Dask.

python -m benchmarks.workers

Each worker has one thread, and there are as many workers as cores; the run in one process has as many threads. The last
column is the time as a multiple of that of one process, and the column before it states whether `episodes.csv` and
`commands.parquet` have the same bytes.
"""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path
from statistics import median

from benchmarks.commands import run_timed
from crowdbench.cli import help_from_docstring, main, print_table, progress
from crowdbench.utils import Grid, sha256

FILES = ("episodes.csv", "commands.parquet")


@help_from_docstring
def workers(planner: str = "sarl_cvm", cases: int = 5000, rounds: int = 1) -> None:
    """Print the time of a run in one process and on workers.

    Args:
        planner: The planner.
        cases: Number of validation cases.
        rounds: Number of runs of each kind, in turns; medians are printed.
    """
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    kinds = {
        "one process": (),
        f"{cores} processes": ("--workers", f"{cores}"),
        "Ray": ("--engine", "ray", "--workers", f"{cores}"),
        "Dask": ("--engine", "dask", "--workers", f"{cores}"),
    }
    seconds: dict[str, list[float]] = {name: [] for name in kinds}
    digests: dict[str, list[str]] = {}
    run = [sys.executable, "-m", "crowdbench", "run", "--planner", planner, "--cases", f"val:{cases}"]
    with tempfile.TemporaryDirectory() as folder, progress(rounds * len(kinds), "of all runs") as tell:
        out = Path(folder, "run")
        for name, options in list(kinds.items()) * rounds:
            command = [*run, "--record", "commands", "--overwrite", "--out", str(out), *options]
            seconds[name].append(run_timed(command, name).seconds)
            digests[name] = [sha256(out / file) for file in FILES]
            tell(1)
    one = median(seconds["one process"])
    rows = [
        [
            name,
            f"{median(times):.1f} s",
            "yes" if digests[name] == digests["one process"] else "no",
            f"{median(times) / one:.2f}",
        ]
        for name, times in seconds.items()
    ]
    print_table(Grid(f"{planner}, {cases} cases", ["workers", "time", "same bytes", "ratio"], rows, align="lrrr"))


if __name__ == "__main__":
    main(workers)
