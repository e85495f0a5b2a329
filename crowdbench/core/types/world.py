"""A batch of running simulations, and the traces of their episodes."""

from __future__ import annotations

import dataclasses
import functools
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, UInt

from crowdbench.core.types.rules import HISTORY, Rules


@dataclass(frozen=True)
class World:
    """A batch of running simulations. Immutable: a step of the simulator returns a new one.

    Padding: in worlds with fewer pedestrians than the largest one, the other agents are not `present`. They are at the
    origin with radius and speed 1, so that no formula divides by zero. Polygons, corners and waypoints after the last
    one of a world are NaN.

    With several vehicles, a world has a row for each of them on the axis `world`, see `crowdbench.sim.fleet`.

    Attributes:
        case: Number of the case within its split.
        key: Key of the random streams of the case. It determines the whole case, and is not observed by planners.
        noise_key: Key of the noise of planners.
        step: Steps done so far.
        max_steps: Steps after which the episode times out.
        position: Centres in metres.
        velocity: Velocities of the last step in m/s.
        heading: Direction in which the vehicle faces, in radians. A holonomic vehicle faces in its last direction of
            motion. Before it has moved, it faces its goal; a vehicle on wheels faces its first waypoint, or its goal.
        angular_speed: Change of the heading in the last step, divided by dt, in rad/s.
        origin: Position at which each agent's current path to its goal began, in metres.
        goal: Goal of each agent in metres.
        route: Waypoints on the way to the goal, in metres.
        waypoint: Index in `route` of each agent's next waypoint; the number of its waypoints after it has reached the
            last one.
        radius: Radii in metres.
        preferred_speed: Preferred and largest speed in m/s.
        present: True if the agent exists in this world now.
        person: Number of each pedestrian as a person, unique within the case; -1 in the padding. A pedestrian that
            replaces another one in these arrays has another number.
        since: The step after which each pedestrian appeared; 0 for pedestrians present from the start.
        track: Positions of recorded pedestrians at each step in metres; NaN for absent ones. The axis `moment` is empty
            if no pedestrians are recorded.
        group: Number of the group that each pedestrian walks with, unique within the case; -1 without a group.
        history: The pedestrians' last positions in metres, from the oldest to the current one. Until there are enough,
            the first position is repeated before it.
        obstacles: Polygons in metres. Two corners make a wall that can be touched from both sides.
        policy: The policy that moves each pedestrian, as an index into `parameters`.
        parameters: By policy and name, the parameters of the policies (column 0, the vehicle's, is not used).
        memory: By policy, arrays `[world, ...]` that a policy with a memory stores between steps, in mappings that may
            be nested; empty for other policies. See `PolicyWithMemory`. With a model of
            attention also its state, see `crowdbench.sim.attention`, and with `Rules.intentions` the intentions, see
            `crowdbench.sim.intention`.
        rules: The rules of the scenario.
        actuation: The state of the vehicle's actuators, see `crowdbench.core.dynamics.Actuation`.
        sight: The vehicle's measurements of pedestrians so far, see `crowdbench.sim.sight`; empty if
            `Sensor.sees_all`.
    """

    case: Int[np.ndarray, "world"]
    key: UInt[np.ndarray, "world"]
    noise_key: UInt[np.ndarray, "world"]
    step: Int[np.ndarray, "world"]
    max_steps: Int[np.ndarray, "world"]
    position: Float[np.ndarray, "world agent 2"]
    velocity: Float[np.ndarray, "world agent 2"]
    heading: Float[np.ndarray, "world"]
    angular_speed: Float[np.ndarray, "world"]
    origin: Float[np.ndarray, "world agent 2"]
    goal: Float[np.ndarray, "world agent 2"]
    route: Float[np.ndarray, "world agent waypoint 2"]
    waypoint: Int[np.ndarray, "world agent"]
    radius: Float[np.ndarray, "world agent"]
    preferred_speed: Float[np.ndarray, "world agent"]
    present: Bool[np.ndarray, "world agent"]
    person: Int[np.ndarray, "world pedestrian"]
    since: Int[np.ndarray, "world pedestrian"]
    track: Float[np.ndarray, "world moment pedestrian 2"]
    group: Int[np.ndarray, "world pedestrian"]
    history: Float[np.ndarray, "world time pedestrian 2"]
    obstacles: Float[np.ndarray, "world polygon corner 2"]
    policy: Int[np.ndarray, "world pedestrian"]
    parameters: Mapping[str, Mapping[str, Float[np.ndarray, "world agent"]]]
    memory: Mapping[str, Any]
    rules: Rules
    actuation: Mapping[str, np.ndarray] = dataclasses.field(default_factory=dict)
    sight: Mapping[str, np.ndarray] = dataclasses.field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.case)

    @classmethod
    def create(
        cls,
        *,
        position: Float[np.ndarray, "world agent 2"],
        radius: Float[np.ndarray, "world agent"],
        rules: Rules,
        parameters: Mapping[str, Mapping[str, Float[np.ndarray, "world agent"]]],
        **others: Any,
    ) -> World:
        """Return worlds before their first step, with defaults for fields that are not given.

        By default agents stand at their goals and all are present, with a preferred speed of 1 m/s. There are no
        routes, obstacles, groups or tracks, and all pedestrians follow the first policy.

        Args:
            position: Centres in metres.
            radius: Radii in metres.
            parameters: By policy and name, the parameters of the policies.
            **others: Other fields. TypeError is raised if there is no such field.
        """
        worlds, agents = radius.shape
        people = worlds, agents - 1
        present = others.get("present", np.ones((worlds, agents), bool))
        fields: dict[str, Any] = {
            "case": np.arange(worlds),
            "key": np.zeros(worlds, np.uint64),
            "noise_key": np.zeros(worlds, np.uint64),
            "step": np.zeros(worlds, np.int64),
            "max_steps": np.full(worlds, rules.max_steps, np.int64),
            "velocity": np.zeros_like(position),
            "heading": np.zeros(worlds),
            "angular_speed": np.zeros(worlds),
            "origin": position.copy(),
            "goal": position.copy(),
            "route": np.empty((worlds, agents, 0, 2)),
            "waypoint": np.zeros((worlds, agents), np.int64),
            "preferred_speed": np.ones((worlds, agents)),
            "present": present,
            "person": np.where(present[:, 1:], np.arange(agents - 1), -1),
            "since": np.zeros(people, np.int64),
            "track": np.empty((worlds, 0, agents - 1, 2)),
            "group": np.full(people, -1),
            "history": np.repeat(position[:, None, 1:], HISTORY, axis=1),
            "obstacles": np.empty((worlds, 0, 0, 2)),
            "policy": np.zeros(people, np.int64),
            "memory": {name: {} for name in parameters},
            "actuation": rules.actuation.start(worlds, rules.dt),
        }
        return cls(position=position, radius=radius, rules=rules, parameters=parameters, **(fields | others))

    def replace(self, **changes: object) -> World:
        """Return a copy in which the named fields have other values.

        Raises TypeError if there is no such field.
        """
        # By hand, because `dataclasses.replace` would take as long as the rest of a step of one world.
        fields = self.__dict__ | changes
        if len(fields) != len(self.__dict__):
            raise TypeError(f"a World has no field {', '.join(changes.keys() - self.__dict__.keys())}")
        copy = object.__new__(World)
        object.__setattr__(copy, "__dict__", fields)
        return copy

    def take(self, rows: np.ndarray) -> World:
        """Return the worlds in the given rows (a mask or indices)."""
        # A mask is searched once and not for each array.
        indices = np.flatnonzero(rows) if rows.dtype == bool else rows
        return self._map(lambda array: array.take(indices, axis=0))

    def put(self, rows: Int[np.ndarray, "row"], others: World) -> World:
        """Return a copy in which some worlds are replaced.

        Args:
            rows: Indices of the replaced worlds.
            others: Their replacements, one world per row, of the same scenario.
        """

        def replaced(array: np.ndarray, other: np.ndarray) -> np.ndarray:
            # Routes and obstacles are as long as the longest of the batch.
            both = widen(array, other.shape).copy()
            both[rows] = widen(other, array.shape)
            return both

        return self._map(replaced, others)

    def _map(self, function: Callable[..., np.ndarray], *others: World) -> World:
        """Apply a function to each array of this object and the same array of the others."""
        fields = {name: value for name, value in vars(self).items() if name != "rules"}
        made = {
            name: map_nested(function, value, *(vars(one)[name] for one in others)) for name, value in fields.items()
        }
        return World(**made, rules=self.rules)


def widen(array: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Return an array padded with NaN to `shape` along each axis, except the first one, if `shape` is longer."""
    missing = [(0, max(0, wish - own)) for own, wish in zip(array.shape[1:], shape[1:], strict=True)]
    return np.pad(array, [(0, 0), *missing], constant_values=np.nan) if any(after for _, after in missing) else array


def map_nested(function: Callable[..., np.ndarray], first: Any, *others: Any) -> Any:
    """Apply a function to arrays, or to the arrays with the same names in nested mappings."""
    if isinstance(first, np.ndarray):
        return function(first, *others)
    return {name: map_nested(function, value, *(other[name] for other in others)) for name, value in first.items()}


@dataclass(frozen=True, eq=False, repr=False)
class Trace:
    """Episodes of a rollout. Metrics are functions of a trace.

    The axis `time` counts states from 0 (the start) to `steps`; the axis `step` counts the steps between them: step t
    leads from state t to state t + 1. Position, velocity, heading, command and gaps are NaN after an episode's end.
    Position and velocity of agents that are not `present` are NaN. Do not write to the arrays: those that do not change
    in an episode (goals, radii, ...) may share memory between times.

    Attributes:
        split: The split of the cases.
        case: Number of each case.
        outcome: The `Outcome` of each episode.
        steps: Number of steps of each episode.
        position: Centres in metres.
        velocity: Velocities in m/s during the step before each state.
        heading: Direction in which the vehicle faces, in radians.
        command: The planner's command in each step, in the units of the vehicle's dynamics: m/s for a holonomic one.
        gap: Smallest distance in metres between the rims of the vehicle and any pedestrian during each step, as the
            simulator's collision check measured it; infinite without pedestrians.
        wall_gap: The same between the vehicle's rim and the obstacles; infinite without obstacles.
        goal: Goal of each agent in metres.
        radius: Radii in metres.
        preferred_speed: Preferred and largest speed in m/s of each agent that was present at the start.
        present: True if the agent exists at that time.
        person: Number of each pedestrian as a person, unique within the case; -1 in the padding. If it changes,
            another pedestrian has replaced that one in the arrays, at another position.
        seen: True if the vehicle saw the pedestrian; with a delay, whether it did so then.
        route: The vehicle's waypoints in metres as it started, NaN after the last one.
        obstacles: Polygons in metres, NaN after the last corner; two corners are a wall.
        rules: The rules of the scenario.
        undisturbed: Positions of the pedestrians in the same case without the vehicle, in metres; NaN in entries
            of another pedestrian. None if pedestrians do not see the vehicle, or if not requested.
        perceived: Observed or remembered position of each pedestrian in metres, as in the observation; NaN for other
            pedestrians. With a detector, that of each track. None if `Sensor.sees_all`.
        age: Seconds since each pedestrian was at its last measured position; infinite for pedestrians neither seen
            nor remembered. With a detector, that of each track. None if `Sensor.sees_all`.
        block: The block of recorded time that each case is from: cases of the same block are not independent. With
            several vehicles, the case. None for one vehicle if no pedestrians are recorded.
        vehicle: Index of the vehicle of each episode in its world; None with one vehicle.
        group: Number of the group that each pedestrian walks with, unique within the case; -1 without a group.
            None if the scenario has no groups.
        noticed: True if each pedestrian had noticed the vehicle in the step before each state. None without a model of
            attention: then all notice a visible vehicle.
        logs: Arrays that the planner logged, `[world, step, ...]` by name; NaN in steps in which it logged nothing.
    """

    split: str
    case: Int[np.ndarray, "world"]
    outcome: Int[np.ndarray, "world"]
    steps: Int[np.ndarray, "world"]
    position: Float[np.ndarray, "world time agent 2"]
    velocity: Float[np.ndarray, "world time agent 2"]
    heading: Float[np.ndarray, "world time"]
    command: Float[np.ndarray, "world step 2"]
    gap: Float[np.ndarray, "world step"]
    wall_gap: Float[np.ndarray, "world step"]
    goal: Float[np.ndarray, "world time agent 2"]
    radius: Float[np.ndarray, "world time agent"]
    preferred_speed: Float[np.ndarray, "world agent"]
    present: Bool[np.ndarray, "world time agent"]
    person: Int[np.ndarray, "world time pedestrian"]
    seen: Bool[np.ndarray, "world time pedestrian"]
    route: Float[np.ndarray, "world waypoint 2"]
    obstacles: Float[np.ndarray, "world polygon corner 2"]
    rules: Rules
    undisturbed: Float[np.ndarray, "world time pedestrian 2"] | None = None
    perceived: Float[np.ndarray, "world time track 2"] | None = None
    age: Float[np.ndarray, "world time track"] | None = None
    block: Int[np.ndarray, "world"] | None = None
    vehicle: Int[np.ndarray, "world"] | None = None
    group: Int[np.ndarray, "world time pedestrian"] | None = None
    noticed: Bool[np.ndarray, "world time pedestrian"] | None = None
    logs: Mapping[str, np.ndarray] = dataclasses.field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.case)

    def __repr__(self) -> str:
        worlds, states, agents, _ = self.position.shape
        return f"Trace({worlds} {self.split} episodes, {states} states, {agents} agents)"

    @functools.cached_property
    def of_pedestrians(self) -> Trace:
        """The same episodes without other vehicles."""
        others, changes = self.rules.vehicles - 1, dict[str, Any](rules=dataclasses.replace(self.rules, vehicles=1))
        for field in dataclasses.fields(self) if others else ():
            axes = re.findall(r"\w+", str(field.type).partition("world ")[2])
            for axis, start in (("agent", 1), ("pedestrian", 0)):
                if axis in axes and getattr(self, field.name) is not None:
                    gone, array = slice(start, start + others), getattr(self, field.name)
                    changes[field.name] = np.delete(array, gone, 1 + axes.index(axis))
        return dataclasses.replace(self, **changes) if others else self

    def episode(self, row: int) -> Trace:
        """Return one episode as a trace of one world, without the padding after its end.

        Args:
            row: The row of the episode.
        """
        steps = int(self.steps[row])
        ends = {"time": steps + 1, "step": steps}
        changes: dict[str, Any] = {"logs": {name: log[row : row + 1, :steps] for name, log in self.logs.items()}}
        for field in dataclasses.fields(self):
            array = getattr(self, field.name)
            if isinstance(array, np.ndarray):
                axis = next((axis for axis in ends if f"world {axis}" in str(field.type)), None)
                changes[field.name] = array[row : row + 1] if axis is None else array[row : row + 1, : ends[axis]]
        return dataclasses.replace(self, **changes)
