"""How long whole commands take, each in a process of its own, and how much memory."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from statistics import median

from crowdbench.bench import Row, child
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


def sarl_rows(cases: int = 500, *options: str) -> Iterator[Row]:
    """Runs of SARL-CVM that record as runs do by default, with shipped weights unless `options` say otherwise."""
    return _planner_rows("sarl_cvm", "SARL-CVM", cases, options, TIMES)


def sarl_sgan_kce_rows(cases: int = 500, *options: str) -> Iterator[Row]:
    """A run of SARL-SGAN-KCE alike; one alone, since it takes as long as all else."""
    return _planner_rows("sarl_sgan_kce", "SARL-SGAN-KCE", cases, options, 1)


def _planner_rows(planner: str, label: str, cases: int, options: tuple[str, ...], times: int) -> Iterator[Row]:
    with tempfile.TemporaryDirectory() as folder:
        run = [*_run(planner, folder), "--cases", str(cases)]
        for option in options:
            run += ["--option", option]
        seconds, memory = zip(*(command(*run) for _ in range(times)), strict=True)
    yield Row(f"{cases} cases, {label}, start to result", median(seconds), "s")
    yield Row(f"memory for {cases} cases, {label}", max(memory) / 1e6, "MB")


def _run(planner: str, folder: str) -> list[str]:
    return ["run", "--planner", planner, "--json", "--overwrite", "--out", str(Path(folder, "run"))]


def command(*arguments: str, **environment: str) -> tuple[float, float]:
    """Seconds of a crowdbench command, and the largest memory that it took, in bytes.

    Raises InputError where it fails.
    """
    told = subprocess.run(
        [sys.executable, "-I", "-S", child.__file__, sys.executable, "-m", "crowdbench", *arguments],
        capture_output=True,
        env={**os.environ, **environment},
        check=True,
    )
    seconds, memory, status = told.stdout.split()
    if int(status):
        said = told.stderr.decode(errors="replace").strip().rpartition("\n")[2]
        raise InputError(f"what is measured failed: crowdbench {' '.join(arguments)}: {said}")
    return float(seconds), int(memory) * 1024.0
