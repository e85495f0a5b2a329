"""Compares the speed of crowdbench and navground: pip install "navground>=0.6,<0.8" "navground_learning>=0.2,<0.3"

navground (https://pypi.org/project/navground) is a C++ library with ORCA agents and a PettingZoo environment. Both
do the same work in turns, in a single run: python -m benchmarks.compare_navground

The same work: agents with ORCA walk to the opposite point of a circle, or cross a square, and avoid at most ten others
within 10 m. navground moves them too, and in addition pushes overlapping agents apart. A whole step of crowdbench is a
step of a rollout: ORCA, motion, the history of each pedestrian, and the collision check of the vehicle. navground's
environment, in its fastest usual form, observes the five nearest neighbours of each agent, as crowdbench's does.
"""

import functools
import math
import multiprocessing
import time
from collections.abc import Callable
from multiprocessing.connection import Connection

import numpy as np
from navground import core, sim
from navground.core.behaviors import ORCABehavior
from navground.core.kinematics import OmnidirectionalKinematics
from navground.learning import ControlActionConfig, DefaultObservationConfig
from navground.learning.parallel_env import shared_parallel_env
from navground.sim.state_estimations import BoundedStateEstimation
from navground.sim.tasks import WaypointsTask

from benchmarks import simulator
from benchmarks.measurement import in_turns
from benchmarks.simulator import DT, FEW_STEPS, RADIUS, STEPS, THOUSANDS, circle

SCENARIO = """
type: Antipodal
radius: 4.0
tolerance: 0.1
position_noise: 0.1
groups:
  - type: pedestrian
    number: 6
    radius: 0.3
    control_period: 0.0
    kinematics: {type: Omni, max_speed: 1.0, max_angular_speed: 1.0}
    behavior: {type: ORCA, optimal_speed: 1.0, horizon: 10.0, time_horizon: 5.0}
    state_estimation: {type: Bounded, range: 10.0}
"""


def make_world(start: np.ndarray, goal: np.ndarray) -> sim.World:
    """Return a world of navground, one step after the start: the first step builds its indices.

    Args:
        start: Starts in metres, `[agent, 2]`.
        goal: Goals in metres, `[agent, 2]`.
    """
    world = sim.World()
    for position, target in zip(start, goal, strict=True):
        kinematics = OmnidirectionalKinematics(1.0, math.inf)
        behavior = ORCABehavior(kinematics, RADIUS)
        behavior.optimal_speed, behavior.horizon, behavior.time_horizon = 1.0, 10.0, 5.0
        behavior.max_number_of_neighbors = 10
        agent = sim.Agent(RADIUS, behavior, kinematics, WaypointsTask([target], False, 0.1))
        agent.state_estimation = BoundedStateEstimation(10.0)
        agent.pose = core.Pose2(position, math.atan2(*(target - position)[::-1]))
        world.add_agent(agent)
    world.update(DT)
    return world


def one_world(
    start: np.ndarray, goal: np.ndarray, steps: int = STEPS, clock: Callable[[], float] = time.perf_counter
) -> float:
    """Return seconds per step of one world of navground, called step by step.

    Args:
        start: Starts in metres, `[agent, 2]`.
        goal: Goals in metres, `[agent, 2]`.
        steps: Number of steps.
        clock: Returns the time in seconds.
    """
    world = make_world(start, goal)
    begin = clock()
    for _ in range(steps):
        world.update(DT)
    return (clock() - begin) / steps


def large_world(start: np.ndarray, goal: np.ndarray) -> float:
    """Return seconds of processor time per agent and step of a large world of navground; arguments as of
    `one_world`."""
    return one_world(start, goal, FEW_STEPS, time.process_time) / len(start)


def many_worlds(start: np.ndarray) -> float:
    """Return seconds per step and world of many worlds of navground on all cores.

    Each core has a process, whose worlds run all their steps in C++: navground holds Python's lock while it runs, so
    that threads would not help. Making the worlds is not measured. `start` is `[world, agent, 2]` in metres.
    """
    context = multiprocessing.get_context("spawn")
    pipes, workers = [], []
    for part in np.array_split(start, multiprocessing.cpu_count()):
        here, there = context.Pipe()
        worker = context.Process(target=run_worlds, args=(there, part))
        worker.start()
        pipes.append(here)
        workers.append(worker)
    for pipe in pipes:
        pipe.recv()
    begin = time.perf_counter()
    for pipe in pipes:
        pipe.send("go")
    for pipe in pipes:
        pipe.recv()
    seconds = time.perf_counter() - begin
    for worker in workers:
        worker.join()
    return seconds / (len(start) * STEPS)


def run_worlds(pipe: Connection, start: np.ndarray) -> None:
    """Run one process of `many_worlds`: make worlds, wait for the signal, run all steps.

    Args:
        pipe: The connection to the process that measures.
        start: Starts of the agents of each world in metres.
    """
    worlds = [make_world(positions, -positions) for positions in start]
    pipe.send("ready")
    pipe.recv()
    for world in worlds:
        world.run(STEPS, DT)
    pipe.send("done")


def environment() -> float:
    """Return seconds per step of navground's PettingZoo environment, in which all six agents are given actions."""
    env = shared_parallel_env(
        scenario=SCENARIO,
        max_number_of_agents=6,
        sensor="{type: Discs, number: 5, range: 10.0, max_speed: 1.0}",
        time_step=DT,
        action=ControlActionConfig(max_speed=1.0, fix_orientation=True),
        observation=DefaultObservationConfig(flat=False, include_target_distance=True, include_velocity=True),
        terminate_if_idle=False,
        include_action=False,
        include_success=False,
    )
    env.reset(seed=0)
    actions = {agent: np.array([0.1, 0.0], np.float32) for agent in env.agents}
    begin = time.perf_counter()
    for _ in range(STEPS):
        env.step(actions)
    return (time.perf_counter() - begin) / STEPS


def compare(work: str, rounds: int, ours: Callable[[], float], theirs: Callable[[], float]) -> None:
    """Measure two functions in turns, and print their medians in microseconds and the ratio.

    Args:
        work: Name of the measured work, to print.
        rounds: Number of measurements of each.
        ours: The work in crowdbench; returns its time in seconds.
        theirs: The same work in navground.
    """
    crowdbench, navground = (1e6 * seconds for seconds in in_turns(rounds, ours, theirs))
    print(f"{work:84} {crowdbench:10.3g} {navground:10.3g} {navground / crowdbench:6.1f}x", flush=True)


if __name__ == "__main__":
    print(f"{'microseconds':84} {'crowdbench':>10} {'navground':>10} {'ratio':>7}")
    for agents in (6, 51):
        compare(
            f"ORCA and motion, one world, {agents} agents, per step",
            150,
            functools.partial(simulator.many_worlds, circle(agents, 1), STEPS),
            functools.partial(one_world, circle(agents, 1)[0], -circle(agents, 1)[0]),
        )
    compare(
        "a whole step, one world, 6 agents",
        45,
        simulator.whole_step,
        functools.partial(one_world, circle(6, 1)[0], -circle(6, 1)[0]),
    )
    for agents in THOUSANDS:
        _, start = large = simulator.start_of_thousands(agents)
        compare(
            f"a whole step, one world, {agents:,} agents, one on 4 m^2, processor time per agent-step",
            5 if agents <= 1000 else 2,
            functools.partial(simulator.thousands, large),
            functools.partial(large_world, start.position[0], start.goal[0]),
        )
    compare(
        "ORCA and motion, 1,000 worlds, 6 agents, all cores, per world-step",
        5,
        functools.partial(simulator.many_worlds, circle(6, 1000), STEPS),
        functools.partial(many_worlds, circle(6, 1000)),
    )
    compare(
        "PettingZoo environment, 6 agents, per step", 45, functools.partial(simulator.environment, STEPS), environment
    )
