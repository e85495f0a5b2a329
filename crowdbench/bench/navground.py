"""The same work in navground (https://pypi.org/project/navground), a C++ library with a PettingZoo environment.

Its ORCA moves the agents as well and pushes overlapping ones apart. Its environment, in its quickest ordinary
form, shows each agent its five nearest neighbours, as ours does.
"""

from __future__ import annotations

import math
import multiprocessing
import time
from multiprocessing.connection import Connection

import numpy as np
from jaxtyping import Float
from navground import core, sim
from navground.core.behaviors import ORCABehavior
from navground.core.kinematics import OmnidirectionalKinematics
from navground.learning import ControlActionConfig, DefaultObservationConfig
from navground.learning.parallel_env import shared_parallel_env
from navground.sim.state_estimations import BoundedStateEstimation
from navground.sim.tasks import WaypointsTask

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


def make_world(start: Float[np.ndarray, "agent 2"], radius: float, dt: float) -> sim.World:
    """Agents that walk to the point opposite, after a first step that builds navground's indices."""
    world = sim.World()
    for place in start:
        kinematics = OmnidirectionalKinematics(1.0, math.inf)
        behavior = ORCABehavior(kinematics, radius)
        behavior.optimal_speed, behavior.horizon, behavior.time_horizon = 1.0, 10.0, 5.0
        behavior.max_number_of_neighbors = 10
        agent = sim.Agent(radius, behavior, kinematics, WaypointsTask([-place], False, 0.1))
        agent.state_estimation = BoundedStateEstimation(10.0)
        agent.pose = core.Pose2(place, math.atan2(-place[1], -place[0]))
        world.add_agent(agent)
    world.update(dt)
    return world


def one_world(start: Float[np.ndarray, "agent 2"], radius: float, dt: float, steps: int) -> float:
    """Seconds per step of one world, called step by step."""
    world = make_world(start, radius, dt)
    begin = time.perf_counter()
    for _ in range(steps):
        world.update(dt)
    return (time.perf_counter() - begin) / steps


def many_worlds(start: Float[np.ndarray, "world agent 2"], radius: float, dt: float, steps: int) -> float:
    """Seconds per world-step of many worlds on all cores: a process each, whose worlds run all steps in C++.

    navground holds Python's lock while it runs, so threads would gain nothing; making the worlds is not timed.
    """
    context = multiprocessing.get_context("spawn")
    cores = multiprocessing.cpu_count()
    pipes, children = [], []
    for part in np.array_split(start, cores):
        here, there = context.Pipe()
        child = context.Process(target=_worker, args=(there, part, radius, dt, steps))
        child.start()
        pipes.append(here)
        children.append(child)
    for pipe in pipes:
        pipe.recv()
    begin = time.perf_counter()
    for pipe in pipes:
        pipe.send("go")
    for pipe in pipes:
        pipe.recv()
    seconds = time.perf_counter() - begin
    for child in children:
        child.join()
    return seconds / (len(start) * steps)


def _worker(pipe: Connection, start: Float[np.ndarray, "world agent 2"], radius: float, dt: float, steps: int) -> None:
    worlds = [make_world(places, radius, dt) for places in start]
    pipe.send("ready")
    pipe.recv()
    for world in worlds:
        world.run(steps, dt)
    pipe.send("done")


def environment(steps: int) -> float:
    """Seconds per step of the PettingZoo environment with six agents that are all given velocities."""
    env = shared_parallel_env(
        scenario=SCENARIO,
        max_number_of_agents=6,
        sensor="{type: Discs, number: 5, range: 10.0, max_speed: 1.0}",
        time_step=0.25,
        action=ControlActionConfig(max_speed=1.0, fix_orientation=True),
        observation=DefaultObservationConfig(flat=False, include_target_distance=True, include_velocity=True),
        terminate_if_idle=False,
        include_action=False,
        include_success=False,
    )
    env.reset(seed=0)
    actions = {agent: np.array([0.1, 0.0], np.float32) for agent in env.agents}
    begin = time.perf_counter()
    for _ in range(steps):
        env.step(actions)
    return (time.perf_counter() - begin) / steps
