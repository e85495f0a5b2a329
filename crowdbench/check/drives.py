"""Drive planners, pedestrian policies, predictors and scenarios; call functions of a batch, such as metrics."""

from __future__ import annotations

import dataclasses
import functools
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from crowdbench.check.checks import PADDING, AnswerLog, ContractBroken, Procedure, WithPadding
from crowdbench.check.worlds import check_worlds
from crowdbench.core.dynamics import reach
from crowdbench.core.geometry import norm, toward_goal
from crowdbench.core.types import Observation, Outcome, Trace, World
from crowdbench.envs.rewards import CheckedReward, Reward, Step
from crowdbench.envs.stepping import drive as drive_step
from crowdbench.metrics.user_metrics import measure
from crowdbench.planners.driver import Driver
from crowdbench.planners.planner import OneStepOnly, Planner
from crowdbench.planners.reactive import ORCAPlanner
from crowdbench.predict.predictor import Predictor, validate_prediction
from crowdbench.runs.rollout import rollout
from crowdbench.runs.spec import Replanning
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.placement import Placement, check_routes
from crowdbench.scenario.scenario import Scenario
from crowdbench.sim.pedestrians.policy import (
    PedestrianPolicy,
    query_policy,
)
from crowdbench.sim.routes import goals_on_way
from crowdbench.sim.visibility_graph import who
from crowdbench.utils.errors import InputError, plugin_errors
from crowdbench.utils.toml import Location
from crowdbench.views.view import View

PLAN_AHEAD = Replanning(8, look_first=1)
"""Replanning of the check of `plan_ahead`."""

INTERVAL, MAX_STEPS = 3, 8
"""A predictor is called at every third step, for 1, 2, ..., 8 steps and then from 1 again."""

UNLIMITED = 1e5
"""Decision limit in seconds of planners that are not checked."""


def _drive_planner(plugin: Planner, name: str, scenario: Scenario, cases: Cases, log: AnswerLog) -> None:
    """Drive a planner with its commands, at every step and, if it has `plan_ahead`, for several steps at once."""
    driver = _RecordingDriver(plugin, name, log)
    rollout(driver, scenario, cases, undisturbed=False)
    try:
        rollout(driver, scenario, cases, replanning=PLAN_AHEAD, undisturbed=False)
    except ContractBroken as error:
        # The driver reports a planner without `plan_ahead` in an InputError of its own.
        if error.__cause__ is None or not isinstance(error.__cause__.__context__, OneStepOnly):
            raise


class _RecordingDriver(Driver):
    """Driver that records the commands of a planner."""

    def __init__(self, planner: Planner, name: str, log: AnswerLog) -> None:
        super().__init__(planner, name, log.limit)
        self.log = log

    def reset(self, cases: Int[np.ndarray, "world"]) -> None:
        """Start the episodes, without a limit of time."""
        try:
            super().reset(cases)
        except InputError as error:
            raise ContractBroken(f"{self.log.where}{error}") from error

    def decide(self, obs: Observation) -> Float[np.ndarray, "world 2"]:
        """Return the commands of the next step."""
        return self._record(functools.partial(Driver.decide, self, obs), obs, "")

    def decide_ahead(self, obs: Observation, steps: int) -> Float[np.ndarray, "world time 2"]:
        """Return the commands of several steps."""
        return self._record(functools.partial(Driver.decide_ahead, self, obs, steps), obs, ", plan_ahead")

    def _record(self, call: Callable[[], np.ndarray], obs: Observation, suffix: str) -> np.ndarray:
        names = _names(self._cases[obs.row], obs.step, suffix)
        return np.array(self.log.keep(names, list(self.log.query(call, names, obs=obs))))


Samples = Callable[[Scenario, Cases], Iterator[tuple[list[str], dict[str, Any]]]]
"""Yields arguments of a plug-in that is a function of a batch, each with the names of the rows."""

CheckedCall = Callable[..., Iterable[np.ndarray]]
"""Calls a plug-in, given with its name, and returns an answer per row. Raises InputError if they are invalid."""


def _function_procedure(samples: Samples, call: CheckedCall, answers: str, padding: str = "") -> Procedure:
    """Return the procedure for plug-ins that are functions of a batch."""

    def drive(plugin: Any, name: str, scenario: Scenario, cases: Cases, log: AnswerLog) -> None:
        for names, arguments in samples(scenario, cases):
            log.keep(names, list(log.query(functools.partial(call, name, plugin, **arguments), names, **arguments)))

    return Procedure(drive, answers, padding=padding)


def _sample_worlds(scenario: Scenario, cases: Cases) -> Iterator[tuple[list[str], dict[str, Any]]]:
    """Yield the worlds before each step of the simple vehicle."""
    world = scenario.worlds(cases)
    while len(world):
        yield _names(world.case, world.step), {"world": world}
        step = _drive_simply(scenario, world)
        world = step.after.take(~step.ended)


def _sample_steps(scenario: Scenario, cases: Cases) -> Iterator[tuple[list[str], dict[str, Any]]]:
    """Yield the steps of the simple vehicle."""
    for names, sample in _sample_worlds(scenario, cases):
        yield names, {"step": _drive_simply(scenario, sample["world"])}


def _drive_simply(scenario: Scenario, world: World) -> Step:
    """Simulate a step in which the vehicle stands in every third case, and drives straight ahead in the others."""
    velocity = toward_goal(world.position[:, 0], goals_on_way(world)[:, 0], world.preferred_speed[:, 0])
    velocity[world.case % 3 == 2] = 0.0
    return drive_step(View(scenario, action="velocity"), world, velocity)


def _sample_observations(scenario: Scenario, cases: Cases) -> Iterator[tuple[list[str], dict[str, Any]]]:
    """Yield observations of every third step, and horizons; with padding, unseen pedestrians have only NaN."""
    vehicle = _TestVehicle(cases)
    rollout(Driver(vehicle, "test", UNLIMITED), scenario, cases, undisturbed=False)
    for number, obs in enumerate(vehicle.observations[::INTERVAL]):
        shown = hide_unseen(obs) if isinstance(scenario, WithPadding) else obs
        yield _names(cases.indices[obs.row], obs.step), {"obs": shown, "steps": 1 + number % MAX_STEPS}


def _sample_traces(scenario: Scenario, cases: Cases) -> Iterator[tuple[list[str], dict[str, Any]]]:
    """Yield the trace of the test vehicle, also without an undisturbed crowd, as non-cooperative scenarios have it."""
    trace = rollout(Driver(_TestVehicle(cases), "test", UNLIMITED), scenario, cases)
    for undisturbed, suffix in ((trace.undisturbed, ""), (None, ", no undisturbed crowd")):
        names = [f"case {case}{suffix}" for case in trace.case]
        yield names, {"trace": dataclasses.replace(trace, undisturbed=undisturbed)}


class _TestVehicle(Planner):
    """Planner that avoids pedestrians in every third case, drives straight in another third, and stands in the rest.

    In this way, all outcomes occur.

    Attributes:
        observations: Its observations.
    """

    privileged = True  # its observations are samples for predictors that may be privileged

    def __init__(self, cases: Cases) -> None:
        self.cases = cases.indices
        self.orca = ORCAPlanner()
        self.observations: list[Observation] = []

    def plan(self, obs: Observation) -> Float[np.ndarray, "world 2"]:
        """Return the velocities in m/s."""
        self.observations.append(obs)
        straight = toward_goal(obs.vehicle.position, obs.vehicle.goal, obs.vehicle.preferred_speed)
        which = self.cases[obs.row][:, None] % 3
        return np.choose(which, [self.orca.plan(obs), straight, np.zeros_like(straight)])


def hide_unseen(obs: Observation) -> Observation:
    """Return an observation with NaN in the rows of all pedestrians that are not seen."""
    crowd, seen = obs.pedestrians, obs.pedestrians.seen
    rows = seen[:, :, None]
    masks = {"position": rows, "velocity": rows, "history": rows[:, None], "radius": seen}
    arrays = {name: np.where(mask, getattr(crowd, name), np.nan) for name, mask in masks.items()}
    return dataclasses.replace(obs, pedestrians=dataclasses.replace(crowd, **arrays))


def _call_policy(name: str, policy: PedestrianPolicy, world: World) -> list[np.ndarray]:
    """Return the velocities of the pedestrians that are present."""
    velocity, _ = query_policy(policy, name, world)
    return [row[present] for row, present in zip(velocity, world.present[:, 1:], strict=True)]


def _call_predictor(name: str, predictor: Predictor, obs: Observation, steps: int) -> list[np.ndarray]:
    """Return positions and velocities of the pedestrians that are seen."""
    shown = obs if predictor.privileged else dataclasses.replace(obs, future=None)
    with plugin_errors(f"predictor {name} raised"):
        answer = predictor.predict(shown, steps)
    prediction = validate_prediction(answer, name, obs, steps)
    futures = np.concatenate([prediction.position, prediction.velocity], axis=4)
    return [future[:, :, seen] for future, seen in zip(futures, obs.pedestrians.seen, strict=True)]


def _call_reward(name: str, reward: Reward, step: Step) -> Float[np.ndarray, "world"]:
    return CheckedReward(name, reward)(step)


def _drive_scenario(plugin: Scenario, name: str, scenario: Scenario, cases: Cases, log: AnswerLog) -> None:
    """Start the cases of a scenario, and drive with ORCA. A layout is checked as a part of its scenario."""
    for number in cases.indices.tolist():
        names = [f"case {number}"]
        log.keep(names, [log.query(functools.partial(_start, plugin, cases.split, number), names)])
    trace = log.query(functools.partial(_drive_orca, plugin, cases), ["all cases"])
    log.keep([f"the episode of case {case}" for case in trace.case], list(trace.position))
    ends = Counter(Outcome(outcome).label for outcome in trace.outcome.tolist())
    log.remark = f" (driven by ORCA: {', '.join(f'{count} {label}' for label, count in ends.most_common())})"


def _start(scenario: Scenario, split: str, case: int) -> np.ndarray:
    """Start a case and return all points of the start in metres.

    Raises InputError if agents overlap, are at their goal, or have a route into a wall.
    """
    world = scenario.draw(split, np.array([case]))
    present = world.present[0]
    start = world.position[0, present]
    goal = world.goal[0, present]
    route = world.route[0, present]
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


def _names(cases: Int[np.ndarray, "world"], steps: Int[np.ndarray, "world"], suffix: str = "") -> list[str]:
    """Return the names of worlds at a step."""
    return [f"case {case}, step {step}{suffix}" for case, step in zip(cases.tolist(), steps.tolist(), strict=True)]


PLANNER = Procedure(_drive_planner, "commands", stateless=False)
SCENARIO = Procedure(_drive_scenario, "starts and episodes", stateless=False, further=check_worlds)
POLICY = _function_procedure(_sample_worlds, _call_policy, "worlds' velocities", PADDING)
PREDICTOR = _function_procedure(
    _sample_observations,
    _call_predictor,
    "worlds' predictions",
    f"{PADDING}, and NaN in the rows of unseen pedestrians",
)
REWARD = _function_procedure(_sample_steps, _call_reward, "rewards")
METRIC = _function_procedure(_sample_traces, measure, "values")
