"""Procedures that drive each kind of plug-in, and further rules of its contract."""

from __future__ import annotations

import dataclasses
import functools
from collections import Counter
from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Int

from crowdbench.check.checks import PADDING, Broken, Procedure, Record, Subject, WithPadding
from crowdbench.check.worlds import check_worlds
from crowdbench.core.dynamics import reach
from crowdbench.core.geometry import norm, toward_goal
from crowdbench.core.types import Observation, Outcome, Trace, World
from crowdbench.envs.rewards import CheckedReward, Reward
from crowdbench.envs.stepping import drive as drive_step
from crowdbench.metrics.registry import Metric
from crowdbench.metrics.user_metrics import measure
from crowdbench.planners.driver import Driver
from crowdbench.planners.planner import OneStepOnly, Planner
from crowdbench.planners.reactive import ORCAPlanner
from crowdbench.predict import Predictor
from crowdbench.predict.predictor import validate_prediction
from crowdbench.runs.rollout import rollout
from crowdbench.runs.spec import Replanning
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.placement import Placement, check_routes
from crowdbench.scenario.scenario import Scenario
from crowdbench.sim.pedestrians.policy import (
    Memory,
    Parameters,
    PedestrianPolicy,
    PolicyWithMemory,
    Velocities,
    init_memory,
    query_policy,
)
from crowdbench.sim.routes import goals_on_way
from crowdbench.sim.visibility_graph import who
from crowdbench.utils.errors import InputError, plugin_errors
from crowdbench.utils.toml import Location
from crowdbench.views.view import NEAREST, View

PLAN_AHEAD = Replanning(8, look_first=1)
"""Replanning of the check of `plan_ahead`."""

INTERVAL, MAX_STEPS = 3, 8
"""A predictor is called at every third step, for 1, 2, ..., 8 steps and then from 1 again."""

Futures = Float[np.ndarray, "world mode time pedestrian 4"]
"""Positions in metres and velocities in m/s."""

UNLIMITED = 1e5
"""Decision limit in seconds of planners that are not checked."""


def _drive_planner(subject: Subject, plugin: Planner, scenario: Scenario, cases: Cases, record: Record) -> None:
    """Drive a planner with its commands, at every step and, if it has `plan_ahead`, for several steps at once."""
    record.limit = UNLIMITED  # the driver measures the time
    driver = _RecordingDriver(plugin, subject.name, subject.limit, record)
    rollout(driver, scenario, cases, undisturbed=False)
    try:
        rollout(driver, scenario, cases, replanning=PLAN_AHEAD, undisturbed=False)
    except Broken as error:
        if not (error.__cause__ and isinstance(error.__cause__.__context__, OneStepOnly)):
            raise


class _RecordingDriver(Driver):
    """Driver that records the commands of a planner."""

    def __init__(self, planner: Planner, name: str, limit: float, record: Record) -> None:
        super().__init__(planner, name, limit)
        self.record = record

    def reset(self, cases: Int[np.ndarray, "world"]) -> None:
        """Start the episodes."""
        self.record.query(lambda: Driver.reset(self, cases), ["at the start"])

    def decide(self, obs: Observation) -> Float[np.ndarray, "world 2"]:
        """Return the commands of the next step."""
        return self._record(functools.partial(Driver.decide, self, obs), obs, "")

    def decide_ahead(self, obs: Observation, steps: int) -> Float[np.ndarray, "world time 2"]:
        """Return the commands of several steps."""
        return self._record(functools.partial(Driver.decide_ahead, self, obs, steps), obs, ", plan_ahead")

    def _record(self, call: Callable[[], np.ndarray], obs: Observation, suffix: str) -> np.ndarray:
        names = _names(self._cases[obs.row], obs.step, suffix)
        return np.array(self.record.keep(names, list(self.record.query(call, names, obs=obs))))


def _drive_policy(subject: Subject, plugin: PedestrianPolicy, scenario: Scenario, cases: Cases, record: Record) -> None:
    """Move pedestrians with a pedestrian policy, with a vehicle that they see and without."""
    policies = {**scenario.policies, subject.name: _RecordingPolicy(plugin, subject.name, record)}
    _drive_test(_TestVehicle(cases), dataclasses.replace(scenario, policies=policies), cases)


class _RecordingPolicy(PolicyWithMemory):
    """Pedestrian policy that records the velocities of another one."""

    def __init__(self, policy: PedestrianPolicy, name: str, record: Record) -> None:
        self.policy, self.name, self.record = policy, name, record

    def memory(self, world: World, parameters: Parameters) -> Memory:
        """Return the memory at the start."""
        if not isinstance(self.policy, PolicyWithMemory):
            return {}
        call = functools.partial(init_memory, self.policy, self.name, world)
        return self.record.query(call, self._names(world), world=world)

    def velocities(  # type: ignore[override]  # as in its base class
        self, world: World, parameters: Parameters, memory: Memory
    ) -> tuple[Velocities, Memory]:
        """Return the velocities and the memory."""
        call, names = functools.partial(query_policy, self.policy, self.name, world), self._names(world)
        velocity, after = self.record.query(call, names, world=world)
        present, followed = world.present[:, 1:], np.zeros_like(velocity)
        rows = self.record.keep(names, [row[there] for row, there in zip(velocity, present, strict=True)])
        followed[present] = np.concatenate(rows)
        return followed, memory if after is None else after

    def _names(self, world: World) -> list[str]:
        return _names(world.case, world.step, "" if world.present[:, 0].all() else ", unseen vehicle")


def _drive_predictor(subject: Subject, plugin: Predictor, scenario: Scenario, cases: Cases, record: Record) -> None:
    """Call a predictor with observations of the test vehicle; with padding, unseen pedestrians have only NaN."""

    def predict(obs: Observation) -> None:
        done, between = divmod(int(obs.step[0]), INTERVAL)
        if between == 0:
            if isinstance(scenario, WithPadding):
                obs = hide_unseen(obs)
            names = _names(cases.indices[obs.row], obs.step)
            call = functools.partial(_predict, plugin, subject.name, obs, 1 + done % MAX_STEPS)
            futures = zip(record.query(call, names, obs=obs), obs.pedestrians.seen, strict=True)
            record.keep(names, [future[:, :, seen] for future, seen in futures])

    _drive_test(_TestVehicle(cases, predict, plugin.privileged), scenario, cases)


def _predict(plugin: Predictor, name: str, obs: Observation, steps: int) -> Futures:
    with plugin_errors(f"predictor {name} raised"):
        answer = plugin.predict(obs, steps)
    prediction = validate_prediction(answer, name, obs, steps)
    return np.concatenate([prediction.position, prediction.velocity], axis=4)


def _drive_metric(subject: Subject, plugin: Metric, scenario: Scenario, cases: Cases, record: Record) -> None:
    """Measure the episodes of the test vehicle with a metric, also without an undisturbed crowd."""
    whole = rollout(Driver(_TestVehicle(cases), "test", UNLIMITED), scenario, cases)
    # Scenarios with non-cooperative pedestrians have traces of the second kind.
    for trace, which in ((whole, ""), (dataclasses.replace(whole, undisturbed=None), ", no undisturbed crowd")):
        names = [f"case {case}{which}" for case in trace.case]
        values = record.query(functools.partial(measure, subject.name, plugin, trace), names, trace=trace)
        record.keep(names, list(values))


def _drive_reward(subject: Subject, plugin: Reward, scenario: Scenario, cases: Cases, record: Record) -> None:
    """Compute a reward for steps in which every third vehicle stands and the others drive straight ahead."""
    checked = CheckedReward(subject.name, plugin)
    view, world = View(scenario, "flat", "world", NEAREST), scenario.worlds(cases)
    while len(world):
        straight = toward_goal(world.position[:, 0], goals_on_way(world)[:, 0], world.preferred_speed[:, 0])
        step = drive_step(view, world, np.where(world.case[:, None] % 3 == 2, 0.0, straight))
        names = _names(world.case, world.step)
        record.keep(names, list(record.query(functools.partial(checked, step), names, step=step)))
        world = step.after.take(~step.ended)


def _drive_scenario(subject: Subject, plugin: Scenario, scenario: Scenario, cases: Cases, record: Record) -> None:
    """Start the cases of a scenario, and drive with ORCA. A layout is checked as a part of its scenario."""
    for number in cases.indices.tolist():
        names = [f"case {number}"]
        record.keep(names, [record.query(functools.partial(_start, plugin, cases.split, number), names)])
    trace = record.query(functools.partial(_drive_orca, plugin, cases), ["all cases"])
    record.keep([f"the episode of case {case}" for case in trace.case], list(trace.position))
    ends = Counter(Outcome(outcome).label for outcome in trace.outcome.tolist())
    record.remark = f" (driven by ORCA: {', '.join(f'{count} {label}' for label, count in ends.most_common())})"


def _start(scenario: Scenario, split: str, case: int) -> np.ndarray:
    """Start a case and return all points of the start in metres.

    Raises InputError if agents overlap, are at their goal, or have a route into a wall.
    """
    world = scenario.draw(split, np.array([case]))
    present = world.present[0]
    start, goal, route = (array[0, present] for array in (world.position, world.goal, world.route))
    radius = world.radius[0, present]
    distance = norm(goal - start)
    with Location(scenario.source, f"case {split}/{case}").named():
        if distance[0] < radius[0]:
            raise InputError(f"the vehicle starts {distance[0]:.3g} m from its goal, where it has arrived")
        if (distance == 0.0).any():
            raise InputError(f"{who(int((distance == 0.0).argmax()))} starts at its goal")
        radius[0] += reach(world.rules.body)
        gap = norm(start[:, None] - start) - (radius[:, None] + radius)
        np.fill_diagonal(gap, np.inf)
        first, second = sorted(int(agent) for agent in np.unravel_index(gap.argmin(), gap.shape))
        if gap[first, second] < 0.0:
            raise InputError(f"agents {first} and {second} overlap by {-gap[first, second]:.3g} m at the start")
        check_routes(Placement(start, goal, route, world.obstacles[0]), radius)
    return np.concatenate([part.ravel() for part in (start, goal, route, world.obstacles[0])])


def _drive_orca(scenario: Scenario, cases: Cases) -> Trace:
    """Drive ORCA through cases. Raises InputError if a layout places a new pedestrian on top of others."""
    trace = rollout(Driver(ORCAPlanner(), "orca"), scenario, cases, undisturbed=False)
    changes = np.argwhere(np.diff(trace.person, axis=1) != 0) if scenario.layout is not None else ()
    for row, step, pedestrian in changes:
        position, radius = trace.position[row, step + 1], trace.radius[row, step + 1]
        gap = norm(position - position[1 + pedestrian]) - (radius + radius[1 + pedestrian])
        gap[1 + pedestrian] = np.inf
        if (gap < 0.0).any():
            where = f"case {cases.split}/{trace.case[row]}, step {step + 1}"
            raise InputError(
                f"in {where}, a new pedestrian at {position[1 + pedestrian].tolist()} overlaps another agent"
            )
    return trace


class _TestVehicle(Planner):
    """Planner that avoids pedestrians in every third case, drives straight in another third, and stands in the rest.

    In this way, all outcomes occur.

    Args:
        cases: The cases.
        look: Called with each observation.
        privileged: True if observations show the pedestrians' next velocities.
    """

    def __init__(
        self, cases: Cases, look: Callable[[Observation], None] | None = None, privileged: bool = False
    ) -> None:
        self.cases, self.look, self.privileged, self.orca = cases.indices, look, privileged, ORCAPlanner()

    def plan(self, obs: Observation) -> Float[np.ndarray, "world 2"]:
        """Return the velocities in m/s."""
        if self.look is not None:
            self.look(obs)
        straight = toward_goal(obs.vehicle.position, obs.vehicle.goal, obs.vehicle.preferred_speed)
        which = self.cases[obs.row][:, None] % 3
        return np.choose(which, [self.orca.plan(obs), straight, np.zeros_like(straight)])


def _drive_test(vehicle: _TestVehicle, scenario: Scenario, cases: Cases) -> None:
    rollout(Driver(vehicle, "test", UNLIMITED), scenario, cases, undisturbed=False)


def _names(cases: Int[np.ndarray, "world"], steps: Int[np.ndarray, "world"], suffix: str = "") -> list[str]:
    """Return the names of worlds at a step."""
    return [f"case {case}, step {step}{suffix}" for case, step in zip(cases.tolist(), steps.tolist(), strict=True)]


def hide_unseen(obs: Observation) -> Observation:
    """Return an observation with NaN in the rows of all pedestrians that are not seen."""
    crowd, seen = obs.pedestrians, obs.pedestrians.seen
    rows = seen[:, :, None]
    masks = {"position": rows, "velocity": rows, "history": rows[:, None], "radius": seen}
    arrays = {name: np.where(mask, getattr(crowd, name), np.nan) for name, mask in masks.items()}
    return dataclasses.replace(obs, pedestrians=dataclasses.replace(crowd, **arrays))


PLANNER = Procedure(_drive_planner, "commands", repeat=1)
POLICY = Procedure(_drive_policy, "worlds' velocities", padding=PADDING)
PREDICTOR = Procedure(
    _drive_predictor, "worlds' predictions", padding=f"{PADDING}, and NaN in the rows of unseen pedestrians"
)
METRIC = Procedure(_drive_metric, "values")
REWARD = Procedure(_drive_reward, "rewards")
SCENARIO = Procedure(_drive_scenario, "starts and episodes", repeat=1, further=check_worlds)
