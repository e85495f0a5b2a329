"""How long steps of the simulator and of the PettingZoo environment take."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Iterator

import numpy as np
from jaxtyping import Float

from crowdbench.bench.measurement import Measurement
from crowdbench.bench.timing import in_turns
from crowdbench.catalog import load_scenario
from crowdbench.envs.parallel import parallel_env
from crowdbench.geometry import toward_goal
from crowdbench.scenario.cases import Cases
from crowdbench.sim.episode import check_step
from crowdbench.sim.orca import orca_velocities
from crowdbench.sim.simulator import advance, crowd_velocities

RADIUS = 0.3
"""Radius of every agent in metres."""

DT = 0.25
"""Length of a step in seconds."""

STEPS = 28
"""Steps of an episode that are timed. No agent arrives before step 33, so that every agent moves in all of them."""

ROUNDS = 15


def measure_one_world() -> Iterator[Measurement]:
    """ORCA and motion in one world, called step by step, among few and among many agents."""
    for agents in (6, 51):
        work = f"ORCA and motion, one world, {agents} agents, per step"
        yield _measured(work, ROUNDS * 10, functools.partial(many_worlds, circle(agents, 1), STEPS))


def measure_many_worlds() -> Iterator[Measurement]:
    """ORCA and motion in many worlds at once, on all cores."""
    work = "ORCA and motion, 1,000 worlds, 6 agents, all cores, per world-step"
    yield _measured(work, 5, functools.partial(many_worlds, circle(6, 1000), STEPS))


def measure_whole_step() -> Iterator[Measurement]:
    """A step as in a rollout: pedestrians, motion, collision check."""
    yield _measured("a step of the simulator with its collision check, one world, 6 agents", ROUNDS, whole_step)


def measure_environment() -> Iterator[Measurement]:
    """A step of the PettingZoo environment."""
    yield _measured("PettingZoo environment, 6 agents, per step", ROUNDS * 3, functools.partial(environment, STEPS))


def _measured(work: str, rounds: int, seconds: Callable[[], float]) -> Measurement:
    """A measurement in microseconds of something that returns seconds."""
    [took] = in_turns(rounds, seconds)
    return Measurement(work, 1e6 * took, "us")


def circle(agents: int, worlds: int) -> Float[np.ndarray, "world agent 2"]:
    """Starts, in metres, on a circle of 4 m radius, or of a larger radius where the agents would touch.

    Each start is moved by up to 0.1 m, because agents in perfect symmetry block each other for ever.

    Args:
        agents: Number of agents in each world.
        worlds: Number of worlds.
    """
    radius = max(4.0, (2 * RADIUS + 0.3) / (2 * np.sin(np.pi / agents)))
    angle = 2 * np.pi * np.arange(agents) / agents
    evenly = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return evenly + np.random.default_rng(0).uniform(-0.1, 0.1, (worlds, agents, 2))


def many_worlds(start: Float[np.ndarray, "world agent 2"], steps: int) -> float:
    """Let all agents walk to the opposite point: ORCA's velocities, and the motion.

    Args:
        start: Starts in metres.
        steps: Number of steps.

    Returns:
        Seconds per step and world.
    """
    position, velocity, goal = start.copy(), np.zeros_like(start), -start
    radius, speed = np.full(start.shape[:2], RADIUS), np.ones(start.shape[:2])
    begin = time.perf_counter()
    for _ in range(steps):
        velocity = orca_velocities(position, velocity, toward_goal(position, goal, speed), radius, speed)
        position = position + velocity * DT
    return (time.perf_counter() - begin) / (steps * len(start))


def whole_step() -> float:
    """Seconds per step of one world as in a rollout, in which the vehicle stands still."""
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
    """Seconds per step of the PettingZoo environment, in which all six agents are given actions.

    Args:
        steps: Number of steps.
    """
    env = parallel_env("circle_crossing_5")
    env.reset(seed=0)
    actions = {agent: np.array([0.1, 0.0]) for agent in env.agents}
    begin = time.perf_counter()
    for _ in range(steps):
        env.step(actions)
    return (time.perf_counter() - begin) / steps
