"""Compares steps of the environments in two checkouts: python -m benchmarks.compare_checkouts OLD

Each checkout runs in a process of its own. Both do the same work in turns, so that other load affects them
equally. The work is that of `benchmarks.simulator` in each checkout, in processor time.
"""

import functools
import os
import subprocess
import sys
from pathlib import Path

from benchmarks.measurement import in_turns

ROUNDS = 25

WORKS = {
    "Gymnasium environment, 6 agents, per step": "simulator.vehicle_environment(28, 'crowdnav')",
    "Gymnasium's vector environment, 64 worlds, per vehicle and step": "simulator.gymnasium_step(64, 28)",
    "PettingZoo environment, 6 agents, per step": "simulator.environment(28)",
}

WORKER = """
import sys, time
time.perf_counter = time.process_time
from benchmarks import simulator
for line in sys.stdin:
    print(eval(line), flush=True)
"""


class Checkout:
    """A process that measures the works of a checkout."""

    def __init__(self, folder: Path) -> None:
        variables = {**os.environ, "PYTHONPATH": str(folder)}
        command = [sys.executable, "-c", WORKER]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True, "bufsize": 1}
        self._process = subprocess.Popen(command, cwd=folder, env=variables, **pipes)  # type: ignore[call-overload]

    def seconds(self, work: str) -> float:
        """Return the time that a work takes."""
        self._process.stdin.write(f"{work}\n")
        return float(self._process.stdout.readline())


if __name__ == "__main__":
    old, new = (Checkout(Path(folder).resolve()) for folder in (sys.argv[1], "."))
    print(f"{'microseconds':66} {'old':>8} {'new':>8} {'ratio':>7}")
    for name, work in WORKS.items():
        before, after = in_turns(ROUNDS, *(functools.partial(one.seconds, work) for one in (old, new)))
        print(f"{name:66} {1e6 * before:8.2f} {1e6 * after:8.2f} {before / after:7.2f}", flush=True)
