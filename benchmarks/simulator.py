"""Benchmarks of steps of the simulator, without and with limited sight, and of the training environments."""

from __future__ import annotations

import functools
import importlib.util
import math
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import gymnasium
import numpy as np
from jaxtyping import Float

from benchmarks.measurement import Measurement, in_turns
from crowdbench import Cases, Scenario, World, load_scenario, parallel_env
from crowdbench.core import Lidar, toward_goal
from crowdbench.envs import VEHICLE, Reward, load_reward
from crowdbench.sim import crowd_velocities, observe, orca_velocities, scan, step

SCENARIO = "circle_crossing_5"

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
"""Agents per square metre in the large worlds."""

FEW_STEPS = 12
"""Steps of a large world that are timed."""

LIMITED_SIGHT: Mapping[str, Any] = {
    "range": 5.0,
    "field_of_view": 180.0,
    "occlusion": True,
    "noise": {"position": 0.05, "velocity": 0.1},
    "missed": 0.1,
    "delay": 0.25,
    "remember": 2.0,
}

SENSORS: Mapping[str, Mapping[str, Any]] = {
    "perfect sight": {},
    "limited sight": LIMITED_SIGHT,
    "limited sight and a lidar of 360 beams": {**LIMITED_SIGHT, "lidar": {"beams": 360, "range": 10.0}},
}
"""The sensors that are compared."""

DISTURBED: Mapping[str, Any] = {"legs": True, "noise": 0.02, "dropout": 0.02, "false_returns": 0.002}
"""The keys of a lidar with all disturbances."""

VEC_ENV_ROUNDS = 7

VEC_OPTIONS: dict[str, Any] = {"reward": "progress", "observation": "goal_frame", "action": "goal_frame", "nearest": 5}


def measure_steps() -> Iterator[Measurement]:
    """Measure ORCA with motion, in one world and in many, and a whole step of a rollout with its collision check."""
    for agents in (6, 51):
        work = f"ORCA and motion, one world, {agents} agents, per step"
        yield _measure_time(work, ROUNDS * 10, functools.partial(many_worlds, circle(agents, 1), STEPS))
    work = "ORCA and motion, 1,000 worlds, 6 agents, all cores, per world-step"
    yield _measure_time(work, 5, functools.partial(many_worlds, circle(6, 1000), STEPS))
    yield _measure_time("a step of the simulator with its collision check, one world, 6 agents", ROUNDS, whole_step)


def measure_sight() -> Iterator[Measurement]:
    """Measure a step and the observation before it, among ten pedestrians, with perfect and with limited sight."""
    scenarios = [load_scenario("circle_crossing_10", {"sensor": sensor}) for sensor in SENSORS.values()]
    for worlds, name, rounds in ((1, "one world", 30), (1000, "1,000 worlds, per world-step", 5)):
        durations = in_turns(rounds, *(functools.partial(observed_steps, each, worlds) for each in scenarios))
        for sensor, seconds in zip(SENSORS, durations, strict=True):
            work = f"processor time of a step and its observation, 10 pedestrians, {name}: {sensor}"
            yield Measurement(work, 1e6 * seconds, "us")


def measure_scans(worlds: int = 500) -> Iterator[Measurement]:
    """Measure scans of 180 beams by the vehicle and by every agent, among 20 pedestrians on a circle of 6 m."""
    plain = load_scenario(SCENARIO, {"pedestrians.number": 20, "layout.circle_radius": 6.0})
    walled = load_scenario("door_10", {"pedestrians.number": 20})
    for name, (scenario, keys) in {
        "people as discs, no walls": (plain, {}),
        "the same with legs, noise, lost and false echoes": (plain, DISTURBED),
        "the same with legs, noise, lost and false echoes, and six walls": (walled, DISTURBED),
    }.items():
        start, lidar = scenario.worlds(Cases("val", 0, worlds)), Lidar(beams=180, range=10.0, **keys)
        for who, agents in (("the vehicle", 1), ("every agent", 21)):
            work = functools.partial(_repeat, functools.partial(scan, start, lidar, agents), 1)
            work_name = f"scan of 180 beams among 20 pedestrians, {who}, per agent and step: {name}"
            yield Measurement(work_name, 1e6 * in_turns(ROUNDS, work)[0] / (worlds * agents), "us")


def measure_fleets(worlds: int = 100) -> Iterator[Measurement]:
    """Measure steps of worlds with four vehicles, and of worlds with one vehicle and as many agents."""
    fleet, alone = (
        load_scenario("fleet_4", {"vehicle.number": vehicles, "pedestrians.number": 16 - vehicles})
        for vehicles in (4, 1)
    )
    four, one = in_turns(5, *(functools.partial(observed_steps, scenario, worlds) for scenario in (fleet, alone)))
    work = f"processor time of a step and its observations, {worlds} worlds of 16 agents, per vehicle"
    yield Measurement(f"{work}: four vehicles", 1e6 * four / 4, "us")
    yield Measurement(f"{work}: one vehicle", 1e6 * one, "us")
    yield Measurement("ratio of the two", four / 4 / one, "")


def measure_thousands() -> Iterator[Measurement]:
    """Measure steps of one world with thousands of agents, per agent."""
    for agents in THOUSANDS:
        work = f"the same, one world, {agents:,} agents, one on 4 m^2: processor time per agent-step"
        yield _measure_time(work, 5, functools.partial(thousands, start_of_thousands(agents)))


def measure_environments() -> Iterator[Measurement]:
    """Measure steps of the environments of one world."""
    yield _measure_time("PettingZoo environment, 6 agents, per step", ROUNDS * 3, functools.partial(environment, STEPS))
    crowdnav = load_reward("crowdnav").reward

    def equal_reward(step: Any) -> Float[np.ndarray, "world"]:
        return crowdnav(step)

    # The compiled step supports only the reward `crowdnav` itself.
    works = [functools.partial(vehicle_environment, STEPS, reward) for reward in ("crowdnav", equal_reward)]
    compiled, composed = in_turns(ROUNDS * 3, *works)
    yield Measurement("Gymnasium environment, 6 agents, per step", 1e6 * compiled, "us")
    yield Measurement("the same without the compiled step", 1e6 * composed, "us")
    yield Measurement("ratio of the two", composed / compiled, "")


def measure_vec_env(worlds: int = 512, steps: int = 60) -> Iterator[Measurement]:
    """Measure steps of the vehicle in many worlds: stable-baselines3's VecEnv and Gymnasium's, in turns.

    Nothing is measured if stable-baselines3 is not installed.

    Args:
        worlds: Number of worlds.
        steps: Number of steps of each.
    """
    if importlib.util.find_spec("stable_baselines3") is None:
        return
    works = [functools.partial(work, worlds, steps) for work in (gymnasium_step, stable_baselines_step)]
    gym, own = in_turns(VEC_ENV_ROUNDS, *works)
    work = f"{worlds} worlds, 5 pedestrians, frame of the goal, per vehicle and step"
    yield Measurement(f"Gymnasium's vector environment, {work}", 1e6 * gym, "us")
    yield Measurement("the same as stable-baselines3's VecEnv", 1e6 * own, "us")


def _measure_time(work: str, rounds: int, seconds: Callable[[], float]) -> Measurement:
    """Return a measurement in microseconds of a function that returns seconds."""
    return Measurement(work, 1e6 * in_turns(rounds, seconds)[0], "us")


def circle(agents: int, worlds: int) -> Float[np.ndarray, "world agent 2"]:
    """Return starts, in metres, on a circle of 4 m radius, or of a larger radius if the agents would touch.

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
    """Measure ORCA's velocities and the motion of all agents towards the opposite point.

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
    """Return seconds per step of one world as in a rollout, in which the vehicle stands still."""
    scenario = load_scenario(SCENARIO)
    return _drive(scenario, scenario.worlds(Cases("test", 0, 1)), STEPS)


def observed_steps(scenario: Scenario, worlds: int) -> float:
    """Return seconds of processor time per step and world, in which the vehicle drives and observes."""
    start = scenario.worlds(Cases("test", 0, worlds))
    return _drive(scenario, start, STEPS, time.process_time, speed=0.5, observes=True) / worlds


def start_of_thousands(agents: int) -> tuple[Scenario, World]:
    """Return a scenario with this number of agents, one per 4 square metres, and the start of a case."""
    changes = {"pedestrians.number": agents - 1, "layout.square_width": math.sqrt(agents / DENSITY)}
    scenario = load_scenario("thousand", changes)
    return scenario, scenario.worlds(Cases("test", 0, 1))


def thousands(start: tuple[Scenario, World]) -> float:
    """Return seconds of processor time, of all cores together, per agent and step of one world as in a rollout.

    Args:
        start: The return value of `start_of_thousands`.
    """
    return _drive(*start, FEW_STEPS, time.process_time) / start[1].radius.size


def _drive(
    scenario: Scenario,
    world: World,
    steps: int,
    clock: Callable[[], float] = time.perf_counter,
    speed: float = 0.0,
    observes: bool = False,
) -> float:
    """Return seconds per step, by a clock, of worlds in which the vehicle drives along y at a speed in m/s."""
    command = np.tile([0.0, speed], (len(world), 1))
    begin = clock()
    for _ in range(steps):
        crowd = crowd_velocities(world, scenario.policies)
        if observes:
            observe(world)
        world, _ = step(world, command, crowd)
    return (clock() - begin) / steps


def environment(steps: int) -> float:
    """Return seconds per step of the PettingZoo environment, in which all six agents are given actions."""
    env = parallel_env(SCENARIO)
    env.reset(seed=0)
    actions = {agent: np.array([0.1, 0.0]) for agent in env.agents}
    return _repeat(functools.partial(env.step, actions), steps)


def vehicle_environment(steps: int, reward: str | Reward) -> float:
    """Return seconds per step of the Gymnasium environment, in which only the vehicle is given actions."""
    env = gymnasium.make(VEHICLE, scenario=SCENARIO, reward=reward, disable_env_checker=True).unwrapped
    env.reset(seed=0)
    return _repeat(functools.partial(env.step, np.array([0.1, 0.0])), steps)


def gymnasium_step(worlds: int, steps: int) -> float:
    """Return seconds per vehicle and step of `gymnasium.make_vec`."""
    envs = gymnasium.make_vec(VEHICLE, num_envs=worlds, scenario=SCENARIO, **VEC_OPTIONS)
    envs.reset(seed=0)
    return _repeat(functools.partial(envs.step, np.tile([0.5, 0.1], (worlds, 1))), steps) / worlds


def stable_baselines_step(worlds: int, steps: int) -> float:
    """Return seconds per vehicle and step of `CrowdVecEnv`."""
    from crowdbench.envs import CrowdVecEnv

    envs = CrowdVecEnv(worlds, SCENARIO, **VEC_OPTIONS, cases=worlds)
    envs.reset()
    return _repeat(functools.partial(envs.step, np.tile([0.5, 0.1], (worlds, 1))), steps) / worlds


def _repeat(work: Callable[[], object], times: int) -> float:
    """Return the mean time of several calls in seconds."""
    begin = time.perf_counter()
    for _ in range(times):
        work()
    return (time.perf_counter() - begin) / times
