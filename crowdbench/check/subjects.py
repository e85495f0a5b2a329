"""How each kind of plug-in is driven, and what else its contract says."""

from __future__ import annotations

import dataclasses
import functools
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from crowdbench.check.contract import Broken, Record, Subject
from crowdbench.core import rng
from crowdbench.core.dynamics import reach
from crowdbench.core.geometry import norm, toward_goal
from crowdbench.core.types import HISTORY, Observation, Outcome, World
from crowdbench.envs.rewards import CheckedReward, Reward
from crowdbench.envs.stepping import drive as drive_step
from crowdbench.envs.views import NEAREST, View
from crowdbench.metrics import Metric
from crowdbench.metrics.load import measure
from crowdbench.planners.base import OneStepOnly, Planner
from crowdbench.planners.driver import Driver
from crowdbench.planners.reactive import ORCAPlanner
from crowdbench.predict import Prediction, Predictor
from crowdbench.predict.base import validate_prediction
from crowdbench.runs.rollout import rollout
from crowdbench.runs.spec import Replanning
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.placement import LayoutCall, Placement, Position, check_routes, who
from crowdbench.scenario.respawn import Room, draw_again
from crowdbench.scenario.scenario import Scenario
from crowdbench.sim.pedestrians.base import (
    Memory,
    Parameters,
    PedestrianPolicy,
    PolicyWithMemory,
    Velocities,
    init_memory,
    query_policy,
)
from crowdbench.sim.routes import goals_on_way
from crowdbench.utils.errors import InputError, plugin_errors
from crowdbench.utils.toml import Location

AHEAD = Replanning(8, look_first=1)
"""How `plan_ahead` is called."""

EVERY, MOST_STEPS = 3, 8
"""A predictor predicts at every third step, 1, 2, ... and at most 8 steps in turn."""

MORE_MODES = 3
"""Number of modes that a predictor must be able to add without changing the first ones."""

Futures = Float[np.ndarray, "world mode time pedestrian 4"]
"""Positions in metres and velocities in m/s."""

UNLIMITED = 1e5
"""Seconds that planners may take which are not checked."""


@dataclass
class PlannerSubject(Subject[Planner]):
    """Drives a planner by its own commands, at every step and, where it has `plan_ahead`, several steps at once."""

    answers = "commands"
    repeat = 1

    def drive(self, plugin: Planner, scenario: Scenario, cases: Cases, record: Record) -> None:
        """Drive through cases and record the commands."""
        record.limit = UNLIMITED  # the driver measures the time
        driver = _RecordingDriver(plugin, self.name, self.limit, record)
        rollout(driver, scenario, cases, undisturbed=False)
        try:
            rollout(driver, scenario, cases, replanning=AHEAD, undisturbed=False)
        except Broken as error:
            if not (error.__cause__ and isinstance(error.__cause__.__context__, OneStepOnly)):
                raise


class _RecordingDriver(Driver):
    """Records the commands of a planner."""

    def __init__(self, planner: Planner, name: str, limit: float, record: Record) -> None:
        super().__init__(planner, name, limit)
        self.record = record

    def reset(self, cases: Int[np.ndarray, "world"]) -> None:
        """Start the episodes."""
        self.record.ask(lambda: Driver.reset(self, cases), ["at the start"])

    def decide(self, obs: Observation) -> Float[np.ndarray, "world 2"]:
        """Return the commands of the next step."""
        return self._record(functools.partial(Driver.decide, self, obs), obs, "")

    def decide_ahead(self, obs: Observation, steps: int) -> Float[np.ndarray, "world time 2"]:
        """Return the commands of several steps."""
        return self._record(functools.partial(Driver.decide_ahead, self, obs, steps), obs, ", plan_ahead")

    def _record(self, call: Callable[[], np.ndarray], obs: Observation, suffix: str) -> np.ndarray:
        names = _names(self._cases[obs.row], obs.step, suffix)
        return np.array(self.record.keep(names, list(self.record.ask(call, names, obs=obs))))


@dataclass
class PolicySubject(Subject[PedestrianPolicy]):
    """Lets a pedestrian policy move its pedestrians, with a vehicle that they see and without."""

    answers = "worlds' velocities"
    padding = True

    def drive(self, plugin: PedestrianPolicy, scenario: Scenario, cases: Cases, record: Record) -> None:
        """Drive the test vehicle and record the velocities of the pedestrians."""
        policies = {**scenario.policies, self.name: _RecordingPolicy(plugin, self.name, record)}
        _drive_test(_TestVehicle(cases), dataclasses.replace(scenario, policies=policies), cases)

    def scenarios(self) -> Mapping[str, Scenario]:
        """Return the scenario, and the same with a vehicle that pedestrians do not see."""
        invisible = dataclasses.replace(self.scenario.rules, visible=False)
        return {"": self.scenario, "invisible vehicle: ": dataclasses.replace(self.scenario, rules=invisible)}


class _RecordingPolicy(PolicyWithMemory):
    """Records the velocities of a policy."""

    def __init__(self, policy: PedestrianPolicy, name: str, record: Record) -> None:
        self.policy, self.name, self.record = policy, name, record

    def memory(self, world: World, parameters: Parameters) -> Memory:
        """Return the memory at the start."""
        if not isinstance(self.policy, PolicyWithMemory):
            return {}
        call = functools.partial(init_memory, self.policy, self.name, world)
        return self.record.ask(call, self._names(world), world=world)

    def velocities(  # type: ignore[override]  # as in its base class
        self, world: World, parameters: Parameters, memory: Memory
    ) -> tuple[Velocities, Memory]:
        """Return the velocities and the memory."""
        call, names = functools.partial(query_policy, self.policy, self.name, world), self._names(world)
        velocity, after = self.record.ask(call, names, world=world)
        present, followed = world.present[:, 1:], np.zeros_like(velocity)
        rows = self.record.keep(names, [row[there] for row, there in zip(velocity, present, strict=True)])
        followed[present] = np.concatenate(rows)
        return followed, memory if after is None else after

    def _names(self, world: World) -> list[str]:
        return _names(world.case, world.step, "" if world.present[:, 0].all() else ", unseen vehicle")


@dataclass
class PredictorSubject(Subject[Predictor]):
    """Lets a predictor predict what the test vehicle sees.

    Attributes:
        modes: The number of modes, and what makes a predictor with another one, where it has the option `modes`.
    """

    answers = "worlds' predictions"
    padding = True

    modes: tuple[int, Callable[[int], Predictor]] | None = None

    def drive(self, plugin: Predictor, scenario: Scenario, cases: Cases, record: Record) -> None:
        """Drive the test vehicle and record predictions at every third step."""

        def predict(obs: Observation) -> None:
            done, between = divmod(int(obs.step[0]), EVERY)
            if between == 0:
                names = _names(cases.indices[obs.row], obs.step)
                call = functools.partial(self._predict, plugin, obs, 1 + done % MOST_STEPS)
                futures = zip(record.ask(call, names, obs=obs), obs.pedestrians.seen, strict=True)
                record.keep(names, [future[:, :, seen] for future, seen in futures])

        _drive_test(_TestVehicle(cases, predict, plugin.privileged), scenario, cases)

    def _predict(self, plugin: Predictor, obs: Observation, steps: int) -> Futures:
        with plugin_errors(f"predictor {self.name} raised"):
            answer = plugin.predict(obs, steps)
        prediction = validate_prediction(answer, self.name, obs, steps)
        return np.concatenate([prediction.position, prediction.velocity], axis=4)

    def variants(self) -> Mapping[str, Callable[[], Predictor]]:
        """Return predictors that see other values in the rows of unseen pedestrians, and one with more modes."""
        variants: dict[str, Callable[[], Predictor]] = {
            "with NaN in the rows of unseen pedestrians": lambda: _Changed(self.make(), nan_in_unseen),
            "with other people in these rows": lambda: _Changed(self.make(), people_in_unseen),
        }
        if self.modes is not None:
            modes, with_modes = self.modes
            variants[f"with {MORE_MODES} more modes"] = lambda: _Changed(with_modes(modes + MORE_MODES), modes=modes)
        return variants


class _Changed(Predictor):
    """A predictor that sees something else, or the first modes of a predictor."""

    def __init__(
        self, predictor: Predictor, change: Callable[[Observation], Observation] | None = None, modes: int | None = None
    ) -> None:
        self.predictor, self.change, self.modes = predictor, change, modes
        self.privileged = predictor.privileged  # type: ignore[misc]  # of this object alone

    def predict(self, obs: Observation, steps: int) -> Prediction:
        """Predict."""
        found = self.predictor.predict(obs if self.change is None else self.change(obs), steps)
        return Prediction(found.position[:, : self.modes], found.velocity[:, : self.modes])


@dataclass
class MetricSubject(Subject[Metric]):
    """Lets a metric measure the episodes of the test vehicle."""

    answers = "values"

    def drive(self, plugin: Metric, scenario: Scenario, cases: Cases, record: Record) -> None:
        """Drive the test vehicle and record the value of each episode, also without an undisturbed crowd."""
        whole = rollout(Driver(_TestVehicle(cases), "test", UNLIMITED), scenario, cases)
        # A scenario whose pedestrians do not see the vehicle has traces of the second kind.
        for trace, which in ((whole, ""), (dataclasses.replace(whole, undisturbed=None), ", no undisturbed crowd")):
            names = [f"case {case}{which}" for case in trace.case]
            values = record.ask(functools.partial(measure, self.name, plugin, trace), names, trace=trace)
            record.keep(names, list(values))


@dataclass
class RewardSubject(Subject[Reward]):
    """Lets a reward judge steps in which every third vehicle stands and the others go straight on."""

    answers = "rewards"

    def drive(self, plugin: Reward, scenario: Scenario, cases: Cases, record: Record) -> None:
        """Drive through cases and record the rewards of all steps."""
        checked = CheckedReward(self.name, plugin)
        view, world = View(scenario, "flat", "world", NEAREST), scenario.worlds(cases)
        while len(world):
            straight = toward_goal(world.position[:, 0], goals_on_way(world)[:, 0], world.preferred_speed[:, 0])
            step = drive_step(view, world, np.where(world.case[:, None] % 3 == 2, 0.0, straight))
            names = _names(world.case, world.step)
            record.keep(names, list(record.ask(functools.partial(checked, step), names, step=step)))
            world = step.after.take(~step.ended)


@dataclass
class ScenarioSubject(Subject[Scenario]):
    """Starts the cases of a scenario, draws a pedestrian and a goal again, and has ORCA drive.

    A layout is checked as a part of its scenario.
    """

    answers = "starts, draws and episodes"
    repeat = 1

    def drive(self, plugin: Scenario, scenario: Scenario, cases: Cases, record: Record) -> str:
        """Start each case and drive through all of them."""
        drawn: list[bool] = []
        for number in cases.indices.tolist():
            start, *ways = record.ask(functools.partial(_start, plugin, cases.split, number), [f"case {number}"])
            names = [f"{what}case {number}" for what in ("", "a new pedestrian in ", "a new goal in ")]
            record.keep(names[: 1 + len(ways)], [start, *ways])
            drawn += [len(way) > 0 for way in ways]
        room = f"room for {sum(drawn)} of {len(drawn)} new pedestrians and goals"
        if plugin.renewal is not None and drawn and not any(drawn) and not record.expected:
            raise Broken(f"the layout finds {room}, but the scenario draws some")
        drive = functools.partial(rollout, Driver(ORCAPlanner(), "orca"), plugin, cases, undisturbed=False)
        trace = record.ask(drive, ["all cases"])
        record.keep([f"the episode of case {case}" for case in trace.case], list(trace.position))
        ends = Counter(Outcome(outcome).label for outcome in trace.outcome.tolist())
        return f" ({room}; driven by ORCA: {', '.join(f'{count} {label}' for label, count in ends.most_common())})"


def _start(scenario: Scenario, split: str, case: int) -> list[np.ndarray]:
    """Start a case, and draw its last pedestrian and a goal for it again.

    Returns:
        All points of the start in metres; the new pedestrian's start and goal, and its new goal, empty without room.

    Raises:
        InputError: Agents overlap, are at their goal, are led into a wall, or cannot be drawn again.
    """
    world = scenario.draw(split, np.array([case]))
    there = world.present[0]
    start, goal, route, obstacles = (
        world.position[0, there],
        world.goal[0, there],
        world.route[0, there],
        world.obstacles[0],
    )
    ways, last = [], int(np.flatnonzero(there)[-1])
    with Location(scenario.source, f"case {split}/{case}").named():
        radius = world.radius[0, there] + np.where(np.arange(len(start)) == 0, reach(world.rules.body), 0.0)
        gap = norm(start[:, None] - start) - (radius[:, None] + radius)
        np.fill_diagonal(gap, np.inf)
        one, other = sorted(int(agent) for agent in np.unravel_index(gap.argmin(), gap.shape))
        if gap[one, other] < 0.0:
            raise InputError(f"agents {one} and {other} overlap by {-gap[one, other]:.3g} m at the start")
        distance = norm(goal - start)
        if distance[0] < world.radius[0, 0]:
            raise InputError(f"the vehicle starts {distance[0]:.3g} m from its goal, where it has arrived")
        if (distance == 0.0).any():
            raise InputError(f"{who(int((distance == 0.0).argmax()))} starts at its goal")
        check_routes(Placement(start, goal, route, obstacles), radius)
        if scenario.layout is not None and last > 0:
            ways = [_draw_again(scenario.layout, world, last, position) for position in (None, world.position[0, last])]
    return [np.concatenate([part.ravel() for part in (start, goal, route, obstacles)]), *ways]


def _draw_again(
    layout: LayoutCall, world: World, agent: int, position: Position | None
) -> Float[np.ndarray, "point 2"]:
    """Return start and goal of a new pedestrian, or one with a new goal: no point where there is no room for it."""
    room, radius = Room.of(world, 0, np.array([agent])), float(world.radius[0, agent])
    stream = rng.generator(world.key[0], "places again")
    way = draw_again(layout, stream, room, radius, float(world.preferred_speed[0, agent]), position)
    if way is None:
        return np.empty((0, 2))
    start, goal = way
    if position is not None and not np.array_equal(start, position):
        raise InputError(f"who gets another goal is put at {start.tolist()}, but is at {position.tolist()}")
    if position is None and not room.is_clear(start, radius, clearance=0.0, walls=0.0):
        raise InputError(f"somebody new at {start.tolist()} overlaps with somebody, a goal or a wall")
    if room.way(start, goal, radius) is None:
        raise InputError(f"no way leads somebody from {start.tolist()} to its goal at {goal.tolist()}")
    return np.array(way)


class _TestVehicle(Planner):
    """Avoids pedestrians in every third case, drives straight in another third, and stands in the rest.

    So that all outcomes occur.

    Args:
        cases: The cases.
        look: Called with each observation.
        privileged: Whether observations show the pedestrians' next velocities.
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


def nan_in_unseen(obs: Observation) -> Observation:
    """Return an observation with NaN in the rows of all pedestrians that are not seen."""
    return _replace_unseen(obs, position=np.nan, velocity=np.nan, radius=np.nan, history=np.nan)


def people_in_unseen(obs: Observation) -> Observation:
    """Return an observation in which all pedestrians that are not seen pass the vehicle."""
    here = obs.vehicle.position[:, None] + 1.0
    velocity = np.broadcast_to(np.array([-1.0, 0.0]), obs.pedestrians.velocity.shape)
    past = here[:, None] + obs.dt * np.arange(1 - HISTORY, 1)[:, None, None] * velocity[:, None]
    return _replace_unseen(obs, position=here, velocity=velocity, radius=0.3, history=past, observed=HISTORY, age=0.0)


def _replace_unseen(obs: Observation, **values: Any) -> Observation:
    """Return an observation with other values, by array, in the rows of the pedestrians that are not seen."""
    crowd, seen = obs.pedestrians, obs.pedestrians.seen
    masks = {"position": seen[:, :, None], "velocity": seen[:, :, None], "history": seen[:, None, :, None]}
    arrays = {name: np.where(masks.get(name, seen), getattr(crowd, name), value) for name, value in values.items()}
    return dataclasses.replace(obs, pedestrians=dataclasses.replace(crowd, **arrays))
