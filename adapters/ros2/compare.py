"""Compares drives through topics, by `simulate.py` and `node.py` in two processes, with the runs of `crowdbench run`.

python adapters/ros2/compare.py --out runs/live
"""

from __future__ import annotations

import contextlib
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from crowdbench import InputError, Result, run
from crowdbench.cli import main

HERE = Path(__file__).parent

PLANNERS, SCENARIOS = ["mppi", "orca"], ["circle_crossing_5", "groups_12", "unicycle"]


@contextlib.contextmanager
def node(planner: str) -> Iterator[None]:
    """Run a planner as a node in another process."""
    process = subprocess.Popen(
        [sys.executable, HERE / "node.py", "--planner", planner], stderr=subprocess.DEVNULL, text=True
    )
    try:
        yield
    finally:
        process.terminate()
        process.wait()


def simulate(planner: str, scenario: str, cases: str, out: Path, real_time: bool) -> Result:
    """Return the result of a simulation in another process, which a node drives."""
    options = ["--name", planner, "--scenario", scenario, "--cases", cases, "--out", str(out), "--overwrite"]
    options += ["--real-time"] * real_time
    ended = subprocess.run([sys.executable, HERE / "simulate.py", *options], stderr=subprocess.PIPE, text=True)
    if ended.returncode:
        raise InputError(ended.stderr.strip().splitlines()[-1])
    return Result.read(out)


def describe_difference(live: Result, direct: Result) -> str:
    """Return the differences between two runs of the same cases, and the latency of the first one."""
    first, second = live.episodes, direct.episodes
    outcomes = int((first.outcome != second.outcome).sum())
    steps = int((first.steps != second.steps).sum())
    time = np.nanmax(np.abs(first.columns["navigation_time"] - second.columns["navigation_time"]), initial=0.0)
    latency, lost = first.columns["command_latency"], first.columns["commands_lost"]
    return (
        f"{len(first)} cases: {outcomes} outcomes and {steps} numbers of steps differ, times by at most {time:.1e} s; "
        f"latency {1e3 * np.nanmedian(latency):.1f} ms, at most {1e3 * np.nanmax(latency):.1f} ms; "
        f"{lost.sum():.0f} of {first.steps.sum()} commands lost"
    )


def compare(
    out: Annotated[Path, typer.Option()],
    planner: list[str] = PLANNERS,
    scenario: list[str] = SCENARIOS,
    cases: str = "20",
    real_time: bool = False,
) -> None:
    """Print the differences between drives through topics and direct ones.

    Args:
        out: Folder for the runs.
        planner: A planner. Repeatable.
        scenario: A scenario. Repeatable.
        real_time: Simulate in real time instead of lock-step.
    """
    for name in planner:
        with node(name):
            for place in scenario:
                live = simulate(name, place, cases, out / f"{name}-{place}", real_time)
                direct = run(name, place, cases, progress=lambda done: None)
                print(f"{name} on {place}, {describe_difference(live, direct)}", flush=True)


if __name__ == "__main__":
    main(compare)
