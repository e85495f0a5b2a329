"""A batch of running simulations."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, UInt

from crowdbench.types.rules import Rules


@dataclass(frozen=True)
class World:
    """A batch of running simulations. Immutable: the simulator returns a new one.

    Padding: worlds with fewer pedestrians than the widest one have agents that are not `present`. They stand at the
    origin with radius and speed 1, so that no formula divides by zero. Polygons, corners and waypoints beyond the
    last one of a world are NaN.

    Attributes:
        case: Number of the case within its split.
        key: Start of the random streams of the case.
        step: Steps done so far.
        position: Centres in metres.
        velocity: Velocities of the last step in m/s.
        heading: Direction in which the vehicle faces, in radians. A holonomic vehicle faces where it last moved, and
            its goal before it has moved.
        angular_speed: Change of the heading in the last step over dt, in rad/s.
        goal: Where each agent is going, in metres.
        route: Waypoints on the way to the goal, in metres.
        waypoint: Index in `route` of the waypoint that each agent is heading for; the number of its waypoints where
            it is heading for the goal.
        radius: Radii in metres.
        preferred_speed: Preferred and largest speed in m/s.
        present: Whether the agent exists in this world now.
        person: Who each pedestrian is, a number within the case; -1 in the padding.
        group: Which pedestrians walk together, a number within the case; -1 for who walks alone.
        history: The pedestrians' last positions in metres, oldest first, the present one last. Before there are
            enough, the first position is repeated backwards.
        obstacles: Polygons in metres; two corners are a wall that can be touched from both sides.
        policy: Which of the scenario's policies moves each pedestrian, as its index in `parameters`.
        parameters: By policy and name, what each policy is given (column 0, the vehicle's, is not used).
        memory: By policy, arrays that a policy with a memory keeps from step to step: `[world, ...]`, nested in
            mappings as it likes; empty for policies without.
        rules: What the scenario fixes.
    """

    case: Int[np.ndarray, "world"]
    key: UInt[np.ndarray, "world"]
    step: Int[np.ndarray, "world"]
    position: Float[np.ndarray, "world agent 2"]
    velocity: Float[np.ndarray, "world agent 2"]
    heading: Float[np.ndarray, "world"]
    angular_speed: Float[np.ndarray, "world"]
    goal: Float[np.ndarray, "world agent 2"]
    route: Float[np.ndarray, "world agent waypoint 2"]
    waypoint: Int[np.ndarray, "world agent"]
    radius: Float[np.ndarray, "world agent"]
    preferred_speed: Float[np.ndarray, "world agent"]
    present: Bool[np.ndarray, "world agent"]
    person: Int[np.ndarray, "world pedestrian"]
    group: Int[np.ndarray, "world pedestrian"]
    history: Float[np.ndarray, "world time pedestrian 2"]
    obstacles: Float[np.ndarray, "world polygon corner 2"]
    policy: Int[np.ndarray, "world pedestrian"]
    parameters: Mapping[str, Mapping[str, Float[np.ndarray, "world agent"]]]
    memory: Mapping[str, Any]
    rules: Rules

    def __len__(self) -> int:
        return len(self.case)

    def replace(self, **changes: object) -> World:
        """A copy in which the named fields have other values.

        Raises TypeError where there is no such field.
        """
        # By hand, because `dataclasses.replace` would take as long as the rest of a step of one world.
        fields = self.__dict__ | changes
        if len(fields) != len(self.__dict__):
            raise TypeError(f"a World has no field {', '.join(changes.keys() - self.__dict__.keys())}")
        copy = object.__new__(World)
        object.__setattr__(copy, "__dict__", fields)
        return copy

    def take(self, rows: np.ndarray) -> World:
        """The worlds of the given rows, a mask or indices."""
        return self._map(lambda own: own[rows])

    def put(self, rows: Int[np.ndarray, "row"], others: World) -> World:
        """A copy in which the given rows are the worlds `others`, one per row, of the same scenario."""

        def replaced(own: np.ndarray, other: np.ndarray) -> np.ndarray:
            both = own.copy()
            both[rows] = other
            return both

        return self._map(replaced, others)

    def _map(self, function: Callable[..., np.ndarray], *others: World) -> World:
        """The worlds whose arrays a function makes of each array here and in the others."""
        names = [field.name for field in dataclasses.fields(self) if field.name != "rules"]
        values = {name: _nested(function, *(getattr(world, name) for world in (self, *others))) for name in names}
        return World(**values, rules=self.rules)


def _nested(function: Callable[..., np.ndarray], *values: Any) -> Any:
    """What a function makes of arrays, or of the arrays at the same places of nested mappings."""
    first = values[0]
    if not isinstance(first, Mapping):
        return function(*values)
    return {name: _nested(function, *(value[name] for value in values)) for name in first}
