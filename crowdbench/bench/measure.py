"""The measurements: each row is some work, how long it takes here, and how long elsewhere, in turns."""

from __future__ import annotations

import functools
import importlib.util
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from statistics import median
from typing import Any

import numpy as np
from jaxtyping import Float

from crowdbench.bench import Row
from crowdbench.cases import Cases
from crowdbench.catalog import load_scenario
from crowdbench.envs.parallel import parallel_env
from crowdbench.geometry import toward_goal
from crowdbench.sim.orca import orca_velocities
from crowdbench.sim.simulator import advance, crowd_velocities, judge

RADIUS = 0.3
DT = 0.25
STEPS = 28
"""Timed steps of an episode: nobody arrives before step 33, so that all of them are work."""

ROUNDS = 15


def rows() -> Iterator[Row]:
    """All measurements, one by one as they are done."""
    other: Any = None
    if importlib.util.find_spec("navground") and importlib.util.find_spec("navground.learning"):
        from crowdbench.bench import navground as other
    for agents in (6, 51):
        start = circle(agents, 1)[0]
        ours, theirs = _in_turns(
            functools.partial(one_world, start, STEPS),
            other and functools.partial(other.one_world, start, RADIUS, DT, STEPS),
            ROUNDS * 10,
        )
        yield Row(f"ORCA and motion, one world, {agents} agents, per step", 1e6 * ours, "us", theirs and 1e6 * theirs)
    starts = circle(6, 1000)
    ours, theirs = _in_turns(
        functools.partial(many_worlds, starts, STEPS),
        other and functools.partial(other.many_worlds, starts, RADIUS, DT, STEPS),
        5,
    )
    yield Row(
        "ORCA and motion, 1,000 worlds, 6 agents, all cores, per world-step", 1e6 * ours, "us", theirs and 1e6 * theirs
    )
    ours, _ = _in_turns(whole_step, None, ROUNDS)
    yield Row("a step of the simulator with judge, one world, 6 agents", 1e6 * ours, "us")
    ours, theirs = _in_turns(
        functools.partial(environment, STEPS), other and functools.partial(other.environment, STEPS), ROUNDS * 3
    )
    yield Row("PettingZoo environment, 6 agents, per step", 1e6 * ours, "us", theirs and 1e6 * theirs)
    yield from _commands()


def circle(agents: int, worlds: int) -> Float[np.ndarray, "world agent 2"]:
    """Starts on a circle of 4 m, wider where the agents would touch, each moved by up to 0.1 m.

    Moved, because agents in perfect symmetry stop for good in front of each other.
    """
    radius = max(4.0, (2 * RADIUS + 0.3) / (2 * np.sin(np.pi / agents)))
    angle = 2 * np.pi * np.arange(agents) / agents
    places = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return places + np.random.default_rng(0).uniform(-0.1, 0.1, (worlds, agents, 2))


def one_world(start: Float[np.ndarray, "agent 2"], steps: int) -> float:
    """Seconds per step of one world, called step by step."""
    return many_worlds(start[None], steps)


def many_worlds(start: Float[np.ndarray, "world agent 2"], steps: int) -> float:
    """Seconds per world-step: every agent's ORCA velocity, and its motion."""
    position, velocity, goal = start.copy(), np.zeros_like(start), -start
    radius, speed = np.full(start.shape[:2], RADIUS), np.ones(start.shape[:2])
    begin = time.perf_counter()
    for _ in range(steps):
        velocity = orca_velocities(position, velocity, toward_goal(position, goal, speed), radius, speed)
        position = position + velocity * DT
    return (time.perf_counter() - begin) / (steps * len(start))


def whole_step() -> float:
    """Seconds per step of the simulator as a rollout calls it: pedestrians, motion, judge."""
    scenario = load_scenario("circle_crossing_5")
    world = scenario.worlds(Cases("test", 0, 1))
    velocity = np.zeros((1, 6, 2))
    begin = time.perf_counter()
    for _ in range(STEPS):
        velocity[:, 1:] = crowd_velocities(world, scenario.policies)
        after = advance(world, velocity)
        judge(world, after)
        world = after
    return (time.perf_counter() - begin) / STEPS


def environment(steps: int) -> float:
    """Seconds per step of the PettingZoo environment with six agents that are all given velocities."""
    env = parallel_env("circle_crossing_5")
    env.reset(seed=0)
    actions = {agent: np.array([0.1, 0.0]) for agent in env.agents}
    begin = time.perf_counter()
    for _ in range(steps):
        env.step(actions)
    return (time.perf_counter() - begin) / steps


def _in_turns(ours: Callable[[], float], theirs: Callable[[], float] | None, rounds: int) -> tuple[float, float | None]:
    """Medians over rounds in which both work in turn, so that what else the machine does meets both."""
    ours()
    pairs = [(ours(), theirs() if theirs else 0.0) for _ in range(rounds)]
    return median(a for a, _ in pairs), median(b for _, b in pairs) if theirs else None


def _commands() -> Iterator[Row]:
    """Whole commands, each in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        run = ["run", "--planner", "orca", "--record", "none", "--json", "--overwrite", "--out", f"{folder}/run"]
        start_up = median(_command(["--help"])[0] for _ in range(5))
        yield Row("start-up of the command line", start_up, "s")
        short = median(_command([*run, "--cases", "1"])[0] for _ in range(3))
        whole = median(_command([*run, "--cases", "500"])[0] for _ in range(3))
        yield Row("500 cases, ORCA vehicle, start to result", whole, "s")
        first = _command([*run, "--cases", "1"], NUMBA_CACHE_DIR=f"{folder}/cache")[0]
        yield Row("first compilation", first - short, "s")
        yield Row("memory for 10,000 cases", _command([*run, "--cases", "10000"])[1] / 1e6, "MB")


def _command(arguments: list[str], **environment: str) -> tuple[float, float]:
    """Seconds of a command, and the largest memory that it took, in bytes."""
    begin = time.perf_counter()
    process = subprocess.Popen(
        [sys.executable, "-m", "crowdbench", *arguments],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env={**os.environ, **environment},
    )
    _, status, usage = os.wait4(process.pid, 0)
    seconds = time.perf_counter() - begin
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, process.args)
    return seconds, usage.ru_maxrss * 1024.0
