"""Drive a planner through cases, all in lock-step."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.core.geometry import norm
from crowdbench.core.types import Outcome, Trace, World
from crowdbench.planners.driver import Driver
from crowdbench.runs.spec import EVERY_STEP, Replanning
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario
from crowdbench.sim.episode import StepCheck
from crowdbench.sim.fleet import in_whole_worlds, is_running
from crowdbench.sim.routes import goals_on_way
from crowdbench.sim.sensor import ages, observe
from crowdbench.sim.simulator import (
    ATTENTION,
    crowd_decisions,
    has_attention,
    init_memories,
    limit_velocities,
    step,
    step_pedestrians,
)
from crowdbench.utils.errors import InputError
from crowdbench.utils.fork_guard import ForkGuard
from crowdbench.utils.resources import plugin_in_time

Rows = Int[np.ndarray, "running"]
Velocities = Float[np.ndarray, "running 2"]

LOG_MEMORY = 256e6
"""Largest size in bytes of the logs of a batch, unless the batch has only one world."""


Progress = Callable[[float], None]
"""Called after each step with its progress, summed over the episodes, in fractions of an episode."""


class LogsTooLarge(Exception):
    """Raised if the logs of a planner would take too much memory: the batch must be smaller.

    Attributes:
        fitting: The number of cases whose logs fit.
    """

    def __init__(self, fitting: int) -> None:
        super().__init__(f"the logs of {fitting} cases fit")
        self.fitting = fitting


def rollout(
    driver: Driver,
    scenario: Scenario,
    cases: Cases,
    *,
    others: Driver | None = None,
    replanning: Replanning = EVERY_STEP,
    keep_logs: bool = False,
    undisturbed: bool = True,
    progress: Progress | None = None,
    watch: Callable[[World], None] | None = None,
) -> Trace:
    """Drive a planner through cases until each has an outcome. Finished worlds leave the batch.

    With several vehicles in a world, each of them is a world for its planner, and an episode of the trace.

    Args:
        driver: The driver of the planner.
        scenario: The scenario of the cases.
        cases: The cases.
        others: The driver of the planner of all vehicles except the first one of each case, if it is another planner.
        replanning: The steps at which the planner gets an observation. If it returns several commands at once, its
            `plan_ahead` is called, and the commands are executed in open loop.
        keep_logs: True if the trace contains the logs of the planner.
        undisturbed: True if the trace contains the paths of cooperative pedestrians without the vehicle, which some
            metrics need (`MetricInfo.needs`). The crowd of each episode is then simulated a second time.
        progress: Called after each step with its progress, summed over the episodes, in fractions of an episode.
        watch: Called with the worlds before each step.

    Returns:
        The trace of all episodes.

    Raises:
        InputError: The planner or the scenario breaks its contract.
        LogsTooLarge: The logs would take more than `LOG_MEMORY`; only with `keep_logs`.
    """
    if driver.raw:
        scenario = scenario.without_tracker()
    world = scenario.worlds(cases)
    vehicles = world.rules.vehicles
    is_first = np.arange(len(world)) % vehicles == 0
    teams = [_Team(driver, world, is_first | (others is None))]
    if others is not None:
        teams.append(_Team(others, world, ~is_first))
    builder = _TraceBuilder(world, scenario.post_step_rule is not None, bool(scenario.crowd.groups))
    shares = None if progress is None else _Shares(len(world), progress)
    start, rows = world, np.arange(len(world))
    for t in range(scenario.rules.max_steps):
        if watch is not None:
            watch(world)
        crowd, world = _decide(world, scenario)
        ahead, acts = replanning.steps_executed(t), is_running(world)
        if ahead == 0:
            steps = replanning.steps_to_plan(t)
            commands = np.zeros((len(world), steps, 2))
            for team in teams:
                chosen = acts & team.drives[rows]
                logs: dict[str, np.ndarray] | None = {} if keep_logs and team.driver is driver else None
                if chosen.any():
                    commands[chosen] = team.decide(_rows_of(world, chosen), rows[chosen], crowd[chosen], steps, logs)
                builder.log(rows[chosen], t, logs or {})
        after, check = step(world, commands[:, ahead], crowd, scenario.post_step_rule)
        result = StepCheck(*(part[acts] for part in check))
        builder.add(rows[acts], t, commands[acts, ahead], _rows_of(after, acts), result)
        running = check.outcome == Outcome.RUNNING
        if shares is not None:
            shares.add(rows, after, running)
        stays = in_whole_worlds(running, vehicles)
        if not stays.all():
            after, rows, commands = after.take(stays), rows[stays], commands[stays]
        if not len(rows):
            break
        world = after
    trace = builder.trace(cases.split, scenario.blocks(cases))
    if undisturbed and scenario.rules.visible:
        return dataclasses.replace(trace, undisturbed=_walk_alone(scenario, start, trace))
    return trace


def _rows_of(world: World, chosen: Bool[np.ndarray, "running"]) -> World:
    """Return rows of worlds, without a copy if all are chosen."""
    return world if chosen.all() else world.take(chosen)


class _Team:
    """The vehicles that a planner drives.

    Args:
        driver: The driver of the planner.
        world: The worlds at their start.
        drives: True for the rows of its vehicles.
    """

    def __init__(self, driver: Driver, world: World, drives: Bool[np.ndarray, "world"]) -> None:
        self.driver, self.drives = driver, drives
        self._number = np.cumsum(drives) - 1
        self._guard = ForkGuard(f"planner {driver.name}")
        with self._guard:
            driver.reset(world.case[drives])

    def decide(
        self, world: World, rows: Rows, crowd: Velocities, steps: int, logs: dict[str, np.ndarray] | None
    ) -> Float[np.ndarray, "running time 2"]:
        """Return the commands for the next steps of some of its vehicles.

        Args:
            world: Their rows of the worlds.
            rows: The numbers of these rows at the start.
            crowd: The pedestrians' velocities in m/s.
            steps: Number of steps.
            logs: Receives what the planner logs.
        """
        future = limit_velocities(world, crowd) if self.driver.privileged else None
        obs = observe(world, self._number[rows], future, logs)
        with self._guard:
            return self.driver.decide(obs)[:, None] if steps == 1 else self.driver.decide_ahead(obs, steps)


def _walk_alone(scenario: Scenario, world: World, trace: Trace) -> Float[np.ndarray, "world time pedestrian 2"]:
    """Simulate the pedestrians of each episode without the vehicle, until the episode ends.

    Args:
        scenario: The scenario.
        world: The worlds at their start.
        trace: The episodes with the vehicle.

    Returns:
        Positions in metres; NaN after the end of the episode, and for pedestrians that are not present in the episode.
    """
    # The memory of policies must depend on this crowd only.
    world = init_memories(world.replace(rules=dataclasses.replace(world.rules, visible=False)), scenario.policies)
    positions, rows = np.full(trace.position[:, :, 1:].shape, np.nan), np.arange(len(world))
    for t in range(scenario.rules.max_steps + 1):
        same = trace.present[rows, t, 1:] & (world.person == trace.person[rows, t]) & (trace.steps[rows, None] >= t)
        positions[rows, t] = np.where(same[..., None], world.position[:, 1:], np.nan)
        running = trace.steps[rows] > t
        if not running.any():
            break
        stays = in_whole_worlds(running, world.rules.vehicles)
        if not stays.all():
            world, rows = world.take(stays), rows[stays]
        crowd, world = _decide(world, scenario)
        world = step_pedestrians(world, crowd, scenario.post_step_rule)
    return positions


def _decide(world: World, scenario: Scenario) -> tuple[Float[np.ndarray, "running pedestrian 2"], World]:
    """Return `crowd_decisions`. A policy of the user has a limit of time."""
    if not scenario.has_files:
        return crowd_decisions(world, scenario.policies)
    with plugin_in_time("a pedestrian policy raised"):
        return crowd_decisions(world, scenario.policies)


class _Shares:
    """Progress of the episodes, which increases with time, also before the first episode ends.

    A running episode is expected to end when the vehicle reaches its goal on a straight line, or at the time limit.
    """

    def __init__(self, worlds: int, progress: Progress) -> None:
        self.progress = progress
        self.share = np.zeros(worlds)

    def add(self, rows: Rows, after: World, running: Bool[np.ndarray, "running"]) -> None:
        """Report the progress of a step.

        Args:
            rows: The rows of the worlds that were running in the step.
            after: The worlds after the step.
            running: True if each of them is still running.
        """
        seconds_left = norm(goals_on_way(after)[:, 0] - after.position[:, 0]) / after.preferred_speed[:, 0]
        expected = np.minimum(after.step + seconds_left / after.rules.dt, after.max_steps)
        share = np.where(running, np.maximum(after.step / expected, self.share[rows]), 1.0)
        self.progress(float((share - self.share[rows]).sum()) / after.rules.vehicles)
        self.share[rows] = share


_OF_PEOPLE = ("goal", "radius", "present", "person")
"""Fields that change in an episode only if pedestrians spawn, leave, or change their goals."""


class _TraceBuilder:
    """Builder of a trace, which fills the arrays step by step while finished worlds leave the batch.

    Args:
        start: The worlds at their start.
        changing: True if pedestrians may spawn, leave, or change their goals.
        grouped: True if pedestrians may walk in groups.

    Attributes:
        arrays: The fields of the trace that are filled step by step, by name.
    """

    def __init__(self, start: World, changing: bool, grouped: bool) -> None:
        worlds, agents = start.radius.shape
        steps = start.rules.max_steps
        self.start, self.changing = start, changing or start.rules.vehicles > 1
        self.steps, self.outcome = np.zeros((2, worlds), np.int64)
        self.logs: dict[str, np.ndarray] = {}
        states = {"position": (steps + 1, agents, 2), "velocity": (steps + 1, agents, 2), "heading": (steps + 1,)}
        shapes = {**states, "gap": (steps,), "wall_gap": (steps,), "command": (steps, 2)}
        if not start.rules.sensor.sees_all:
            columns = start.sight["unseen"].shape[1]
            shapes |= {"perceived": (steps + 1, columns, 2), "age": (steps + 1, columns)}
        self.arrays = {name: np.full((worlds, *shape), np.nan) for name, shape in shapes.items()}
        people = {name: self._always(getattr(start, name)) for name in (*_OF_PEOPLE, *["group"] * grouped)}
        self.arrays |= {name: array.copy() if self.changing else array for name, array in people.items()}
        self.names_of_state = [*states, *(people if self.changing else [])]
        if "age" in self.arrays:
            self.arrays["age"][:] = np.inf
        if start.rules.sensor.detector is not None:
            self.arrays["seen"] = np.zeros((worlds, steps + 1, agents - 1), bool)
        if has_attention(start.rules):
            self.arrays["noticed"] = np.zeros((worlds, steps + 1, agents - 1), bool)
        self._add_state(np.arange(worlds), 0, start)

    def _add_state(self, rows: Rows, t: int, world: World) -> None:
        """Store state `t` of the worlds in these rows, and the measurements of the vehicles in it."""
        for name in self.names_of_state:
            self.arrays[name][rows, t] = getattr(world, name)
        if "age" in self.arrays:
            self.arrays["age"][rows, t] = age = ages(world)
            perceived = np.where(np.isinf(age)[..., None], np.nan, world.sight["state"][..., :2])
            self.arrays["perceived"][rows, t] = perceived
        if "seen" in self.arrays:
            self.arrays["seen"][rows, t] = world.sight["detected"]
        if "noticed" in self.arrays:
            self.arrays["noticed"][rows, t] = world.memory[ATTENTION]["remaining"] > 0.0

    def add(self, rows: Rows, t: int, command: Velocities, after: World, check: StepCheck) -> None:
        """Store a step.

        Args:
            rows: The rows of the worlds that were running in the step.
            t: Number of the step, from 0.
            command: The planner's command, in the units of the vehicle's dynamics.
            after: The worlds after the step.
            check: The gaps and the outcomes of the step.
        """
        self._add_state(rows, t + 1, after)
        for name, values in (("gap", check.gap), ("wall_gap", check.wall_gap), ("command", command)):
            self.arrays[name][rows, t] = values
        self.outcome[rows] = check.outcome
        self.steps[rows] = t + 1

    def log(self, rows: Rows, t: int, logs: Mapping[str, np.ndarray]) -> None:
        """Store the logs of the planner.

        Args:
            rows: The worlds that are running.
            t: The number of the step, from 0.
            logs: Logs by name, one entry for each of these worlds.

        Raises:
            InputError: A log has another shape than before.
            LogsTooLarge: The logs would take more than `LOG_MEMORY`.
        """
        for name, values in logs.items():
            shape = (*self.arrays["gap"].shape, *values.shape[1:])
            if name not in self.logs:
                # Curves are stored in float64; float32 is sufficient to draw points and lines.
                dtype = np.dtype(np.float64 if len(shape) <= 3 else np.float32)
                size = math.prod(shape) * dtype.itemsize + sum(log.nbytes for log in self.logs.values())
                cases = shape[0] // self.start.rules.vehicles
                if size > LOG_MEMORY and cases > 1:
                    raise LogsTooLarge(max(1, int(cases * LOG_MEMORY / size)))
                self.logs[name] = np.full(shape, np.nan, dtype)
            if self.logs[name].shape != shape:
                raise InputError(
                    f"the log {name} has shape {list(values.shape[1:])} per world in step {t}, "
                    f"but had {list(self.logs[name].shape[2:])} before"
                )
            with np.errstate(over="ignore"):
                self.logs[name][rows, t] = values

    def trace(self, split: str, block: Int[np.ndarray, "world"] | None) -> Trace:
        """Return the trace of all episodes, from the split of the cases and their blocks of recorded time."""
        arrays = self.arrays
        if self.changing:
            arrays |= {name: arrays[name][self._last_states()] for name in (*_OF_PEOPLE, "group") if name in arrays}
            arrays["present"][:, :, 0] = self.start.present[:, :1]  # also of a vehicle that leaves as it arrives
        if "noticed" in arrays:
            arrays["noticed"] = arrays["noticed"][self._last_states()]
        for name in ("position", "velocity"):
            arrays[name][~arrays["present"]] = np.nan
        vehicles = self.start.rules.vehicles
        return Trace(
            split=split,
            case=self.start.case,
            outcome=self.outcome,
            steps=self.steps,
            **(arrays | {"seen": self._seen()}),
            preferred_speed=self.start.preferred_speed,
            route=self.start.route[:, 0],
            obstacles=self.start.obstacles,
            rules=self.start.rules,
            block=block,
            vehicle=np.arange(len(self.steps)) % vehicles if vehicles > 1 else None,
            logs=self.logs,
        )

    def _seen(self) -> Bool[np.ndarray, "world time pedestrian"]:
        """Return the pedestrians that the vehicles saw; after the end of an episode, those in its last state."""
        if "seen" in self.arrays:
            return np.asarray(self.arrays["seen"][self._last_states()])
        if "age" not in self.arrays:
            return self.arrays["present"][:, :, 1:]
        dt = self.start.rules.dt
        late = (self.start.rules.sensor.steps_delayed(dt) + 0.5) * dt
        return np.asarray(self.arrays["age"][self._last_states()] < late)

    def _last_states(self) -> tuple[Int[np.ndarray, "world 1"], Int[np.ndarray, "world time"]]:
        """Return the indices that repeat the last state of each world after the end of its episode."""
        time = np.arange(self.start.rules.max_steps + 1)
        return np.arange(len(self.steps))[:, None], np.minimum(time, self.steps[:, None])

    def _always(self, array: np.ndarray) -> np.ndarray:
        """Return an array `[world, ...]` that is constant in an episode as a view `[world, time, ...]`, without a
        copy."""
        return np.broadcast_to(array[:, None], (len(array), self.start.rules.max_steps + 1, *array.shape[1:]))
