"""How long steps of the simulator and of the PettingZoo environment take."""

from __future__ import annotations

import functools
import math
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
from crowdbench.scenario.scenario import Scenario
from crowdbench.sim.orca import orca_velocities
from crowdbench.sim.simulator import crowd_velocities, step
from crowdbench.types import World

RADIUS = 0.3
"""Radius of every agent in metres."""

DT = 0.25
"""Length of a step in seconds."""

STEPS = 28
"""Steps of an episode that are timed. No agent arrives before step 33, so that every agent moves in all of them."""

ROUNDS = 15

THOUSANDS = (1000, 10_000)
"""Agents of the large worlds."""

DENSITY = 0.25
"""Agents per square metre there."""

FEW_STEPS = 12
"""Steps of a large world that are timed."""


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


def measure_thousands() -> Iterator[Measurement]:
    """The same in one world of thousands, per agent."""
    for agents in THOUSANDS:
        work = f"the same, one world, {agents:,} agents, one on 4 m^2: processor time per agent-step"
        yield _measured(work, 5, functools.partial(thousands, start_of_thousands(agents)))


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
    return _steps(scenario, scenario.worlds(Cases("test", 0, 1)), STEPS)


def start_of_thousands(agents: int) -> tuple[Scenario, World]:
    """A scenario of so many agents, one on 4 square metres, and the start of a case."""
    scenario = load_scenario(
        "thousand", {"pedestrians.number": agents - 1, "layout.square_width": math.sqrt(agents / DENSITY)}
    )
    return scenario, scenario.worlds(Cases("test", 0, 1))


def thousands(start: tuple[Scenario, World]) -> float:
    """Seconds of processor time, of all cores together, per agent and step of one world as in a rollout.

    Args:
        start: What `start_of_thousands` made.
    """
    return _steps(*start, FEW_STEPS, time.process_time) / start[1].radius.size


def _steps(scenario: Scenario, world: World, steps: int, clock: Callable[[], float] = time.perf_counter) -> float:
    """Seconds per step of one world as in a rollout, in which the vehicle stands still.

    Args:
        scenario: Its scenario.
        world: The world at the start.
        steps: Number of steps.
        clock: Tells the time in seconds.
    """
    standing = np.zeros((1, 2))
    begin = clock()
    for _ in range(steps):
        world, _ = step(world, standing, crowd_velocities(world, scenario.policies))
    return (clock() - begin) / steps


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
