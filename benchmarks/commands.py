"""How long whole commands take, each in a process of its own, and how much memory."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from statistics import median

from benchmarks.measurement import Measurement
from crowdbench.utils.errors import InputError

REPETITIONS = 3
"""Runs of a command; the median of their times counts."""

TIMED = """
import os, subprocess, sys, time
begin = time.perf_counter()
process = subprocess.Popen(sys.argv[1:], stdout=subprocess.DEVNULL)
_, status, usage = os.wait4(process.pid, 0)
print(time.perf_counter() - begin, usage.ru_maxrss, os.waitstatus_to_exitcode(status))
"""
"""Prints time, peak memory and exit status of a command.

It runs in a process of its own, because Linux counts the memory of the parent as memory of its child: the parent must
be smaller than what is measured.
"""


def measure_start_up() -> Iterator[Measurement]:
    """The time that every command takes before it starts its work."""
    yield Measurement("start-up of the command line", median(command("--help")[0] for _ in range(5)), "s")


def measure_orca_runs() -> Iterator[Measurement]:
    """Runs of ORCA as the vehicle. It has no network, and nothing is recorded, so that the simulator takes the time."""
    with tempfile.TemporaryDirectory() as folder:
        run = [*_run("orca", folder), "--record", "none"]
        whole = median(command(*run, "--cases", "500")[0] for _ in range(REPETITIONS))
        yield Measurement("500 cases, ORCA vehicle, start to result", whole, "s")
        yield Measurement("memory for 10,000 cases", command(*run, "--cases", "10000")[1] / 1e6, "MB")


def measure_first_run() -> Iterator[Measurement]:
    """How much longer the first run of SARL-SGAN-KCE takes than a later one, because it compiles what it calls."""
    with tempfile.TemporaryDirectory() as folder:
        run = [*_run("sarl_sgan_kce", folder), "--cases", "1"]
        environment = {"NUMBA_CACHE_DIR": f"{folder}/cache"}
        first, later = (command(*run, **environment)[0] for _ in range(2))
    yield Measurement("compiling in the first run of SARL-SGAN-KCE", first - later, "s")


def measure_sarl_runs(cases: int = 500, *options: str) -> Iterator[Measurement]:
    """Runs of SARL-CVM with the recording that runs make by default.

    Args:
        cases: Number of cases.
        options: Options of the planner as `key=value`; without any it has the weights that come with crowdbench.
    """
    return _measure_planner("sarl_cvm", "SARL-CVM", cases, options, REPETITIONS)


def measure_sarl_sgan_kce_run(cases: int = 500, *options: str) -> Iterator[Measurement]:
    """The same for SARL-SGAN-KCE, run once only, because that takes as long as all the rest.

    Args:
        cases: Number of cases.
        options: Options of the planner as `key=value`.
    """
    return _measure_planner("sarl_sgan_kce", "SARL-SGAN-KCE", cases, options, 1)


def _measure_planner(
    planner: str, label: str, cases: int, options: tuple[str, ...], repetitions: int
) -> Iterator[Measurement]:
    with tempfile.TemporaryDirectory() as folder:
        run = [*_run(planner, folder), "--cases", str(cases)]
        for option in options:
            run += ["--option", option]
        seconds, memory = zip(*(command(*run) for _ in range(repetitions)), strict=True)
    yield Measurement(f"{cases} cases, {label}, start to result", median(seconds), "s")
    yield Measurement(f"memory for {cases} cases, {label}", max(memory) / 1e6, "MB")


def _run(planner: str, folder: str) -> list[str]:
    return ["run", "--planner", planner, "--json", "--overwrite", "--out", str(Path(folder, "run"))]


def command(*arguments: str, **environment: str) -> tuple[float, float]:
    """Run a crowdbench command.

    Args:
        arguments: Its command line.
        environment: Environment variables that it gets besides those of this process.

    Returns:
        Its time in seconds and its peak memory in bytes.

    Raises:
        InputError: It fails.
    """
    measured = [sys.executable, "-m", "crowdbench", *arguments]
    run = [sys.executable, "-I", "-S", "-c", TIMED, *measured]
    process = subprocess.run(run, capture_output=True, env={**os.environ, **environment}, check=True)
    seconds, memory, status = process.stdout.split()
    if int(status):
        error = process.stderr.decode(errors="replace").strip().rpartition("\n")[2]
        raise InputError(f"what is measured failed: crowdbench {' '.join(arguments)}: {error}")
    return float(seconds), int(memory) * 1024.0
