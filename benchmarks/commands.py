"""Benchmarks of the time and memory of whole commands, each in a separate process."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from statistics import median
from typing import NamedTuple

from benchmarks.measurement import Measurement
from crowdbench import InputError

REPETITIONS = 3
"""Runs of a command; the median of their times counts."""

TIMED = """
import os, subprocess, sys, time
begin = time.perf_counter()
process = subprocess.Popen(sys.argv[1:], stdout=subprocess.DEVNULL)
_, status, usage = os.wait4(process.pid, 0)
seconds = time.perf_counter() - begin
print(seconds, usage.ru_utime + usage.ru_stime, usage.ru_maxrss, os.waitstatus_to_exitcode(status))
"""
"""Prints time, processor time, peak memory and exit status of a command.

It runs in a separate process, because Linux counts the memory of the parent as memory of its child: the parent must
be smaller than the measured process.
"""


class Usage(NamedTuple):
    """Resources of a process, together with the processes that it started and waited for.

    Attributes:
        seconds: Elapsed time.
        processor: Processor time in seconds.
        memory: Peak memory of one process in bytes.
    """

    seconds: float
    processor: float
    memory: float


def measure_start_up() -> Iterator[Measurement]:
    """Yield the time that every command takes before it starts its work."""
    yield Measurement("start-up of the command line", median(command("--help").seconds for _ in range(5)), "s")


def measure_orca_runs() -> Iterator[Measurement]:
    """Measure runs of ORCA as the vehicle. Without a network and a recording, the simulator dominates the time."""
    with tempfile.TemporaryDirectory() as folder:
        run = [*_run("orca", folder), "--record", "none"]
        whole = median(command(*run).seconds for _ in range(REPETITIONS))
        yield Measurement("500 cases, ORCA vehicle, start to result", whole, "s")
        yield Measurement("memory for 10,000 cases", command(*run, "--cases", "10000").memory / 1e6, "MB")


def measure_sarl_runs() -> Iterator[Measurement]:
    """Measure runs of SARL-CVM with the recording that runs make by default."""
    return _measure_planner("sarl_cvm", "SARL-CVM", REPETITIONS)


def measure_sarl_sgan_kce_run() -> Iterator[Measurement]:
    """Measure a single run of SARL-SGAN-KCE, which takes as long as all other measurements together."""
    return _measure_planner("sarl_sgan_kce", "SARL-SGAN-KCE", 1)


def _measure_planner(planner: str, label: str, repetitions: int) -> Iterator[Measurement]:
    with tempfile.TemporaryDirectory() as folder:
        seconds, _, memory = zip(*(command(*_run(planner, folder)) for _ in range(repetitions)), strict=True)
    yield Measurement(f"500 cases, {label}, start to result", median(seconds), "s")
    yield Measurement(f"memory for 500 cases, {label}", max(memory) / 1e6, "MB")


def _run(planner: str, folder: str) -> list[str]:
    return ["run", "--planner", planner, "--json", "--overwrite", "--out", str(Path(folder, "run"))]


def command(*arguments: str) -> Usage:
    """Run a crowdbench command with these arguments. Raises InputError if it fails."""
    return run_timed([sys.executable, "-m", "crowdbench", *arguments], "crowdbench " + " ".join(arguments))


def run_timed(arguments: list[str], name: str, folder: Path | None = None, **environment: str) -> Usage:
    """Run a process, and return its resources.

    Args:
        arguments: Its program and arguments.
        name: Its name in errors.
        folder: Its working directory; None for the working directory of this process.
        environment: Environment variables in addition to the variables of this process.

    Raises:
        InputError: The process fails.
    """
    run = [sys.executable, "-I", "-S", "-c", TIMED, *arguments]
    process = subprocess.run(run, capture_output=True, cwd=folder, env={**os.environ, **environment}, check=True)
    seconds, processor, memory, status = process.stdout.split()
    if int(status):
        error = process.stderr.decode(errors="replace").strip().rpartition("\n")[2]
        raise InputError(f"the measured command failed: {name}: {error}")
    return Usage(float(seconds), float(processor), int(memory) * 1024.0)
