"""The observation of a planner."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from jaxtyping import Bool, Float, Int, UInt

from crowdbench.core import rng
from crowdbench.core.arrays import AgentNumbers, AgentPoints
from crowdbench.core.dynamics import DIRECT, DISC, FREE, Actuation, Body, Dynamics, State, hull
from crowdbench.core.geometry import local_goals
from crowdbench.core.types.rules import PERFECT_SENSOR, Sensor
from crowdbench.utils.errors import InputError

Part = TypeVar("Part", "Vehicle", "Pedestrians", "Observation")


@dataclass(frozen=True)
class Vehicle:
    """The vehicle's own state and goal.

    Attributes:
        position: Centre in metres.
        velocity: Velocity of the last step in m/s.
        heading: Direction in which it faces, in radians.
        angular_speed: Change of the heading in the last step, divided by dt, in rad/s.
        goal: Its goal in metres.
        route: Waypoints on the way to the goal, in metres; NaN after the last one.
        waypoint: Index in `route` of the next waypoint; the number of waypoints after the last one was reached.
        radius: Radius in metres.
        preferred_speed: Preferred and largest speed in m/s.
        dynamics: Its dynamics.
        actuation: Delay and lag with which it executes commands.
        goal_tolerance: Distance in metres to its goal below which it has arrived; None means its radius.
        body: The discs that it consists of.
    """

    position: Float[np.ndarray, "*world 2"]
    velocity: Float[np.ndarray, "*world 2"]
    heading: Float[np.ndarray, "*world"]
    angular_speed: Float[np.ndarray, "*world"]
    goal: Float[np.ndarray, "*world 2"]
    route: Float[np.ndarray, "*world waypoint 2"]
    waypoint: Int[np.ndarray, "*world"]
    radius: Float[np.ndarray, "*world"]
    preferred_speed: Float[np.ndarray, "*world"]
    dynamics: Dynamics = FREE
    actuation: Actuation = DIRECT
    goal_tolerance: float | None = None
    body: Body = DISC

    @property
    def state(self) -> State:
        """Its motion state, as an argument of its dynamics."""
        return State(self.position, self.velocity, self.heading, self.angular_speed)

    @property
    def local_goal(self) -> Float[np.ndarray, "*world 2"]:
        """The point in metres that it heads for on its route, see `crowdbench.core.geometry.local_goals`.

        If no waypoint is left, it is the goal.
        """
        return local_goals(self.position, self.goal, self.route, self.waypoint)


@dataclass(frozen=True)
class Pedestrians:
    """The pedestrians as the vehicle sees them. Their goals and policies cannot be seen.

    Ignore pedestrians that are not `seen`: they are padding, or hidden from the vehicle.

    With limited sight (`Sensor`), all values are measurements, with noise and delay. A pedestrian that is out of sight
    but remembered continues at constant velocity: it counts as `seen`, and its `age` is above 0.

    Attributes:
        position: Centres in metres.
        velocity: Velocities of the last step in m/s.
        radius: Radii in metres.
        seen: True if the vehicle sees the pedestrian now, or remembers it.
        history: The last 8 positions in metres, from the oldest to the current one. Before the first observed
            position, that one is repeated.
        observed: Number of positions in `history` since the pedestrian was first observed.
        age: Time in seconds since the pedestrian was at its last observed position: 0 if it is seen now, infinite if it
            is neither seen nor remembered.
        filled: True for positions since the first observation that were not observed, but filled in: by linear
            interpolation, or by extrapolation at constant velocity. None if positions are never filled in.
        deviation: Standard deviations of each coordinate of the position in metres and of the velocity in m/s, as
            estimated by a filter; None without one.
        is_vehicle: True for other vehicles; None if there is one vehicle, or with a detector, which cannot tell.
    """

    position: Float[np.ndarray, "*world pedestrian 2"]
    velocity: Float[np.ndarray, "*world pedestrian 2"]
    radius: Float[np.ndarray, "*world pedestrian"]
    seen: Bool[np.ndarray, "*world pedestrian"]
    history: Float[np.ndarray, "*world time pedestrian 2"]
    observed: Int[np.ndarray, "*world pedestrian"]
    age: Float[np.ndarray, "*world pedestrian"]
    filled: Bool[np.ndarray, "*world time pedestrian"] | None = None
    deviation: Float[np.ndarray, "*world pedestrian 2"] | None = None
    is_vehicle: Bool[np.ndarray, "*world pedestrian"] | None = None


@dataclass(frozen=True)
class Observation:
    """Input of a planner at each decision, for every world that is still running.

    Worlds whose episode has ended leave the batch, so that a planner with a memory must index its entries by `row`.
    For planners of one world at a time, the arrays have no world axis.

    Observations do not contain the number of the case, so that planners cannot look up hidden data. The start positions
    still identify the case if the scenario and its seed are known.

    Attributes:
        vehicle: The vehicle's own state and goal.
        pedestrians: The observed pedestrians.
        obstacles: Polygons in metres, NaN after the last corner and the last polygon. Two corners make a wall.
        row: Index of each world in the initial batch: the same during the whole episode.
        noise_key: Key of the noise of each world.
        step: Steps done so far.
        dt: Length of a step in seconds.
        future: The pedestrians' next velocities in m/s; None unless the planner is privileged.
        logs: Arrays that the planner has logged in this decision, by name; None if nothing is recorded.
        sensor: Properties of the vehicle's sensor: range, noise, delay and others.
        lidar: Distance in metres from the vehicle's position at which each beam meets a pedestrian or an obstacle, or
            the lidar's range if it meets none; see `crowdbench.core.types.Lidar`. None without a lidar.
    """

    vehicle: Vehicle
    pedestrians: Pedestrians
    obstacles: Float[np.ndarray, "*world polygon corner 2"]
    row: Int[np.ndarray, "*world"]
    noise_key: UInt[np.ndarray, "*world"]
    step: Int[np.ndarray, "*world"]
    dt: float
    sensor: Sensor = PERFECT_SENSOR
    future: Float[np.ndarray, "*world pedestrian 2"] | None = None
    logs: dict[str, np.ndarray] | None = None
    lidar: Float[np.ndarray, "*world beam"] | None = None

    def __len__(self) -> int:
        return len(self.row)

    def take(self, rows: np.ndarray | slice) -> Observation:
        """Return a copy of the given rows (a mask, indices or a slice). Calls of `log` on the copy are not recorded."""
        return self.rows(lambda array: array[rows].copy(), logs=None)

    def rows(self, chosen: Callable[[np.ndarray], np.ndarray], logs: dict[str, np.ndarray] | None) -> Observation:
        """Return the observation of some of the worlds.

        Args:
            chosen: Function that selects these worlds from an array `[world, ...]`.
            logs: Dictionary for the logs of the new observation.

        Returns:
            An observation with the chosen part of each array.
        """
        vehicle, pedestrians = _chosen(self.vehicle, chosen), _chosen(self.pedestrians, chosen)
        return dataclasses.replace(_chosen(self, chosen), vehicle=vehicle, pedestrians=pedestrians, logs=logs)

    @property
    def time(self) -> Float[np.ndarray, "*world"]:
        """Seconds since the start."""
        return np.asarray(self.step * self.dt)

    def everybody(self) -> tuple[AgentPoints, AgentPoints, AgentNumbers, Bool[np.ndarray, "world agent"]]:
        """Return all agents in common arrays, the vehicle first, as the smallest disc around its body. Only for
        batches.

        Returns:
            Position in metres, velocity in m/s, radius in metres, and whether the agent is seen (always, for the
            vehicle).
        """
        vehicle, crowd = self.vehicle, self.pedestrians
        position, radius = hull(vehicle.body, vehicle.position, vehicle.heading, vehicle.radius)
        return (
            np.concatenate([position[:, None], crowd.position], axis=1),
            np.concatenate([vehicle.velocity[:, None], crowd.velocity], axis=1),
            np.concatenate([radius[:, None], crowd.radius], axis=1),
            np.concatenate([np.ones((len(self), 1), bool), crowd.seen], axis=1),
        )

    def noise(self, purpose: str, shape: tuple[int, ...]) -> Float[np.ndarray, "*world *shape"]:
        """Return standard normal noise that depends only on seed, split, case, step, purpose and the indices.

        Repeated calls return the same noise, in any batch. A longer axis only adds numbers, so that noise for
        `(pedestrians, 3)` is the same with any padding.

        Args:
            purpose: Name of the noise. Different names have independent noise.
            shape: Shape of the noise of one world, with at most five axes.

        Raises:
            InputError: The shape has more axes, or a negative or huge one.
        """
        drawn = rng.normal(np.atleast_1d(self.noise_key), purpose, np.atleast_1d(self.step), tuple(shape))
        return drawn.reshape(*np.shape(self.noise_key), *shape)

    def true_next(self) -> Float[np.ndarray, "*world pedestrian 2"]:
        """Return the velocities in m/s that the pedestrians will take in this step.

        Raises PermissionError unless the planner is `privileged`.
        """
        if self.future is None:
            raise PermissionError("true_next() shows what no vehicle sees: it is for planners with `privileged = True`")
        return self.future

    def log(self, name: str, values: np.ndarray | float) -> None:
        """Record an array of the planner.

        Args:
            name: Letters, digits and underscores, a letter first.
            values: `[world]` or `[world, n]` become curves over time, `[world, n, 2]` points in metres, `[world, n, 3]`
                commands, each a velocity in m/s and its value, as arrows from the vehicle, and
                `[world, ..., time, n, 2]` lines over time, in metres, from the next step on; with a third number, the
                line's weight, `[world, ..., time, n, 3]`, they are coloured by it.

        Raises:
            InputError: The name has other characters, or the values are no numbers with one entry per world.
        """
        if not name.isidentifier():
            raise InputError(f"a log is called {name!r}, but names are letters, digits and underscores, a letter first")
        if self.logs is None:
            return
        try:
            array = np.array(values, np.float64, subok=False)
        except (TypeError, ValueError):
            raise InputError(f"the log {name} is a {type(values).__name__}, but must be an array of numbers") from None
        worlds = np.shape(self.row)
        if array.shape[: len(worlds)] != worlds:
            raise InputError(f"the log {name} has shape {array.shape}, but its first axis must be {len(self)} worlds")
        self.logs[name] = array


def _chosen(part: Part, chosen: Callable[[np.ndarray], np.ndarray]) -> Part:
    """Return a copy of a dataclass with the chosen part of each array."""
    arrays = {name: chosen(value) for name, value in vars(part).items() if isinstance(value, np.ndarray)}
    return dataclasses.replace(part, **arrays)  # type: ignore[arg-type]
