"""How long steps of the simulator and of the PettingZoo environment take, here and in navground."""

from __future__ import annotations

import functools
import importlib.util
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from jaxtyping import Float

from crowdbench.bench import Row
from crowdbench.bench.timing import in_turns
from crowdbench.catalog import load_scenario
from crowdbench.envs.parallel import parallel_env
from crowdbench.geometry import toward_goal
from crowdbench.scenario.cases import Cases
from crowdbench.sim.orca import orca_velocities
from crowdbench.sim.episode import check_step
from crowdbench.sim.simulator import advance, crowd_velocities

RADIUS = 0.3
DT = 0.25
STEPS = 28
"""Timed steps of an episode: nobody arrives before step 33, so that all of them are work."""

ROUNDS = 15


def one_world_rows() -> Iterator[Row]:
    """One world, called step by step."""
    other = _navground()
    for agents in (6, 51):
        start = circle(agents, 1)
        yield _row(
            f"ORCA and motion, one world, {agents} agents, per step",
            ROUNDS * 10,
            functools.partial(many_worlds, start, STEPS),
            other and functools.partial(other.one_world, start[0], RADIUS, DT, STEPS),
        )


def many_worlds_row() -> Iterator[Row]:
    """Many worlds on all cores."""
    other = _navground()
    starts = circle(6, 1000)
    yield _row(
        "ORCA and motion, 1,000 worlds, 6 agents, all cores, per world-step",
        5,
        functools.partial(many_worlds, starts, STEPS),
        other and functools.partial(other.many_worlds, starts, RADIUS, DT, STEPS),
    )


def whole_step_row() -> Iterator[Row]:
    """A step as a rollout makes it."""
    yield _row("a step of the simulator with judge, one world, 6 agents", ROUNDS, whole_step)


def environment_row() -> Iterator[Row]:
    """A step of the PettingZoo environment."""
    other = _navground()
    yield _row(
        "PettingZoo environment, 6 agents, per step",
        ROUNDS * 3,
        functools.partial(environment, STEPS),
        other and functools.partial(other.environment, STEPS),
    )


def _row(work: str, rounds: int, ours: Callable[[], float], theirs: Callable[[], float] | None = None) -> Row:
    """A row in microseconds of works that give seconds."""
    took = in_turns(rounds, *(each for each in (ours, theirs) if each))
    return Row(work, 1e6 * took[0], "us", 1e6 * took[1] if theirs else None)


def _navground() -> Any:
    """The module with the same work in navground, or None where that is not installed."""
    if not (importlib.util.find_spec("navground") and importlib.util.find_spec("navground.learning")):
        return None
    from crowdbench.bench import navground

    return navground


def circle(agents: int, worlds: int) -> Float[np.ndarray, "world agent 2"]:
    """Starts on a circle of 4 m, wider where the agents would touch, each moved by up to 0.1 m.

    Moved, because agents in perfect symmetry stop for good in front of each other.
    """
    radius = max(4.0, (2 * RADIUS + 0.3) / (2 * np.sin(np.pi / agents)))
    angle = 2 * np.pi * np.arange(agents) / agents
    places = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return places + np.random.default_rng(0).uniform(-0.1, 0.1, (worlds, agents, 2))


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
        check_step(world, after)
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
