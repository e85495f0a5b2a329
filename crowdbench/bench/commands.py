"""How long whole commands take, each in a process of its own, and how much memory."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from statistics import median

from crowdbench.bench import Row
from crowdbench.errors import InputError

TIMES = 3
"""Times that a run is repeated for its median."""


def start_up_row() -> Iterator[Row]:
    """What every command waits for."""
    yield Row("start-up of the command line", median(command("--help")[0] for _ in range(5)), "s")


def orca_rows() -> Iterator[Row]:
    """Runs of ORCA as the vehicle: no network, and nothing recorded, so that the simulator is what takes time."""
    with tempfile.TemporaryDirectory() as folder:
        run = [*_run("orca", folder), "--record", "none"]
        short = median(command(*run, "--cases", "1")[0] for _ in range(TIMES))
        whole = median(command(*run, "--cases", "500")[0] for _ in range(TIMES))
        yield Row("500 cases, ORCA vehicle, start to result", whole, "s")
        first = command(*run, "--cases", "1", NUMBA_CACHE_DIR=f"{folder}/cache")[0]
        yield Row("first compilation", first - short, "s")
        yield Row("memory for 10,000 cases", command(*run, "--cases", "10000")[1] / 1e6, "MB")


def sarl_rows(cases: int = 500, weights: str = "sarl") -> Iterator[Row]:
    """Runs of SARL-CVM that record as runs do by default, with shipped weights or those of a file."""
    with tempfile.TemporaryDirectory() as folder:
        run = [*_run("sarl_cvm", folder), "--option", f"weights={weights}", "--cases", str(cases)]
        seconds, memory = zip(*(command(*run) for _ in range(TIMES)), strict=True)
    yield Row(f"{cases} cases, SARL-CVM, start to result", median(seconds), "s")
    yield Row(f"memory for {cases} cases, SARL-CVM", max(memory) / 1e6, "MB")


def _run(planner: str, folder: str) -> list[str]:
    return ["run", "--planner", planner, "--json", "--overwrite", "--out", str(Path(folder, "run"))]


def command(*arguments: str, **environment: str) -> tuple[float, float]:
    """Seconds of a crowdbench command, and the largest memory that it took, in bytes.

    Raises InputError where it fails.
    """
    with tempfile.TemporaryFile() as errors:
        begin = time.perf_counter()
        process = subprocess.Popen(
            [sys.executable, "-m", "crowdbench", *arguments],
            stdout=subprocess.DEVNULL,
            stderr=errors,
            env={**os.environ, **environment},
        )
        _, status, usage = os.wait4(process.pid, 0)
        seconds = time.perf_counter() - begin
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            errors.seek(0)
            said = errors.read().decode(errors="replace").strip().rpartition("\n")[2]
            raise InputError(f"what is measured failed: crowdbench {' '.join(arguments)}: {said}")
    return seconds, usage.ru_maxrss * 1024.0
