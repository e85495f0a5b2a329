"""A scenario: the constants of all its cases, and the random draw of the start of each case."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, Int

from crowdbench.core import rng
from crowdbench.core.dynamics import Holonomic
from crowdbench.core.geometry import pad_arrays
from crowdbench.core.types import Rules, World
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.digest import scenario_digest
from crowdbench.scenario.placement import LayoutCall
from crowdbench.scenario.population import Population
from crowdbench.scenario.schema import VehicleSpec
from crowdbench.scenario.starts import Case, LayoutStarts
from crowdbench.sim.least_time import least_steps
from crowdbench.sim.pedestrians import PedestrianPolicy
from crowdbench.sim.sight import look
from crowdbench.sim.simulator import PostStepRule, init_memories
from crowdbench.utils.errors import InputError
from crowdbench.utils.toml import Location

if TYPE_CHECKING:  # most scenarios have no recorded pedestrians
    from crowdbench.scenario.recorded import TrackedCrowd


@dataclass(frozen=True)
class Scenario:
    """Scenario, a generator of worlds from case numbers. `crowdbench.scenario.scenario_file` reads it from a file.

    Attributes:
        name: Name of the scenario.
        source: Name of its file in error messages.
        table: Its complete table, as written to results. Each case has a random stream that depends on seed, split and
            case number.
        vehicle: The vehicle's radius and preferred speed, among others.
        rules: Constants of all cases.
        crowd: The pedestrians.
        starts: Generator of the starts of cases: from a layout, as in CrowdNav++, or from recorded tracks.
        policies: The pedestrian policies by name.
    """

    name: str
    source: str
    table: Mapping[str, Any]
    vehicle: VehicleSpec
    rules: Rules
    crowd: Population
    starts: LayoutStarts | TrackedCrowd
    policies: Mapping[str, PedestrianPolicy]

    @functools.cached_property
    def digest(self) -> str:
        """Twelve hexadecimal digits that change with the cases, see `scenario_digest`."""
        return scenario_digest(self.table)

    @functools.cached_property
    def post_step_rule(self) -> PostStepRule | None:
        """Rule applied after each step: arrivals, respawn, goal changes; None if pedestrians only walk."""
        return self.starts.post_step_rule(self.crowd)

    @property
    def tracks(self) -> TrackedCrowd | None:
        """The recorded pedestrians that form the crowd; None for a simulated crowd."""
        return None if isinstance(self.starts, LayoutStarts) else self.starts

    @property
    def layout(self) -> LayoutCall | None:
        """The layout that places the agents of a case, with its options; None if pedestrians are recorded."""
        return self.starts.layout if isinstance(self.starts, LayoutStarts) else None

    @property
    def has_files(self) -> bool:
        """True if a pedestrian policy or the layout is in a file of the user."""
        return bool(self.table["pedestrians"]["policy_files"] or self.table.get("layout", {}).get("generator_file"))

    @property
    def max_agents(self) -> int:
        """The largest number of agents: the vehicles and the pedestrians."""
        return self.crowd.number[1] + self.rules.vehicles

    def check_data(self, data: Path | None) -> None:
        """Refuse recorded tracks that the scenario does not need.

        Args:
            data: The folder that the user gave, or None.

        Raises:
            InputError: A folder is given, and the scenario has no `[tracks]`.
        """
        if data is not None and self.tracks is None:
            raise InputError(f"--data does not go with {self.name}, which has no table [tracks]: leave out one of them")

    def without_tracker(self) -> Scenario:
        """Return the scenario with a detector, if it has one, that shows planners its detections instead of tracks.

        It has the same table and digest: only the observation differs.
        """
        sensor = self.rules.sensor
        if sensor.detector is None:
            return self
        sensor = sensor.model_copy(update={"detector": sensor.detector.model_copy(update={"raw": True})})
        return dataclasses.replace(self, rules=dataclasses.replace(self.rules, sensor=sensor))

    def worlds(self, cases: Cases) -> World:
        """Return the starts of a range of cases."""
        return self.draw(cases.split, cases.indices)

    def draw(self, split: str, cases: Int[np.ndarray, "world"]) -> World:
        """Draw the starts of any cases of a split.

        Args:
            split: `train`, `val` or `test`.
            cases: Numbers of the cases.

        Returns:
            A world per case, in the given order; with several vehicles, a row for each of them.

        Raises:
            InputError: A layout has no room, raises, or returns an invalid placement, or a policy returns no memory.
        """
        keys = rng.case_keys(int(self.table["seed"]), split, cases)
        drawn = [
            Case(Location(self.source, f"case {split}/{case}"), split, case, key)
            for case, key in zip(cases.tolist(), keys, strict=True)
        ]
        starts = [self.starts.start(case, self.crowd, self.vehicle, self.rules) for case in drawn]
        if (vehicles := self.rules.vehicles) > 1:
            cases, keys = cases.repeat(vehicles), rng.vehicle_keys(keys, vehicles)
            starts = [
                start._replace(placement=start.placement.as_seen_by(vehicle))
                for start in starts
                for vehicle in range(vehicles)
            ]
        placements, traits = [start.placement for start in starts], [start.traits for start in starts]
        agents = self.max_agents
        routes = [_NO_POINTS if placement.route is None else placement.route for placement in placements]
        obstacles = [_NO_POINTS if placement.obstacles is None else placement.obstacles for placement in placements]

        def stack(vehicle: float, pedestrians: Sequence[Float[np.ndarray, "_"]], padding: float) -> np.ndarray:
            vehicles = np.full((len(cases), 1), vehicle)
            return np.concatenate([vehicles, pad_arrays(pedestrians, padding, agents - 1)], axis=1)

        parameters = {
            name: {
                parameter: stack(0.0, [people.parameters[name][parameter] for people in traits], 0.0)
                for parameter in table
            }
            for name, table in self.crowd.parameters.items()
        }
        world = World.create(
            case=cases,
            key=keys,
            noise_key=rng.noise_keys(keys),
            position=pad_arrays([placement.start for placement in placements], 0.0, agents),
            goal=pad_arrays([placement.goal for placement in placements], 0.0, agents),
            route=pad_arrays(routes, np.nan, agents),
            radius=stack(self.vehicle.radius, [people.radius for people in traits], 1.0),
            preferred_speed=stack(self.vehicle.preferred_speed, [people.preferred_speed for people in traits], 1.0),
            present=pad_arrays([np.ones(len(people.radius) + 1, bool) for people in traits], False, agents),
            group=pad_arrays([start.group for start in starts], -1, agents - 1),
            obstacles=pad_arrays(obstacles, np.nan),
            policy=pad_arrays([people.policy for people in traits], 0, agents - 1),
            parameters=parameters,
            rules=self.rules,
        )
        world = world.replace(heading=_initial_heading(world))
        world = _with_limits(self.starts.complete(world, drawn, starts))
        return init_memories(look(world), self.policies)

    def blocks(self, cases: Cases) -> Int[np.ndarray, "world"] | None:
        """Return the block of recorded time of each case, or the case of each vehicle; None if no pedestrians are
        recorded and there is one vehicle: then episodes are independent."""
        if self.tracks is None:
            return cases.indices.repeat(self.rules.vehicles) if self.rules.vehicles > 1 else None
        return self.tracks.blocks(cases.split, cases.indices)


def _initial_heading(world: World) -> Float[np.ndarray, "world"]:
    """Return the direction from each vehicle to its goal, in radians; for a vehicle on wheels, to its first waypoint
    if there is one."""
    ahead = world.goal[:, 0] - world.position[:, 0]
    if not isinstance(world.rules.dynamics, Holonomic) and world.route.shape[2]:
        waypoint = world.route[:, 0, 0]
        ahead = np.where(np.isnan(waypoint), ahead, waypoint - world.position[:, 0])
    return np.arctan2(ahead[:, 1], ahead[:, 0])


def _with_limits(world: World) -> World:
    """Return worlds with the time limit of each case, if it is a multiple of the least time."""
    if world.rules.time_limit_factor is None:
        return world
    least = least_steps(
        world.rules,
        world.position[:, 0],
        world.goal[:, 0],
        velocity=world.velocity[:, 0],
        heading=world.heading,
        radius=world.radius[:, 0],
        max_speed=world.preferred_speed[:, 0],
        obstacles=world.obstacles,
    )
    limit = np.minimum(np.ceil(world.rules.time_limit_factor * least - 1e-9) + 1, world.rules.max_steps)
    return world.replace(max_steps=limit.astype(np.int64))


_NO_POINTS = np.empty((0, 0, 2))
"""The routes or the obstacles of a case that has none."""
