"""`PyRVOSimulator` as in the module `rvo2` of Python-RVO2, computed by crowdbench's ORCA in double precision."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from crowdbench.core import pad_arrays
from crowdbench.sim import Agents, Avoidance, avoid, per_agent

Point = Sequence[float]

DEFAULTS = "NeighborDist", "MaxNeighbors", "TimeHorizon", "TimeHorizonObst", "Radius", "MaxSpeed", "Velocity"
"""Defaults of an agent, in the order of Python-RVO2's arguments."""

FIELDS = "Position", *DEFAULTS, "PrefVelocity"
"""Fields that `setAgent...` sets and `getAgent...` returns."""

POINTS = "Position", "Velocity", "PrefVelocity"


class PyRVOSimulator:
    """Agents that avoid each other by ORCA. Methods and their arguments equal Python-RVO2's.

    Getters of neighbours, ORCA lines and obstacle vertices are missing, and so is `queryVisibility`.

    Args:
        timeStep: In seconds.
        neighborDist: In metres.
        maxNeighbors: A number of agents.
        timeHorizon: In seconds.
        timeHorizonObst: In seconds.
        radius: In metres.
        maxSpeed: In m/s.
        velocity: In m/s.
    """

    def __init__(
        self,
        timeStep: float,
        neighborDist: float,
        maxNeighbors: int,
        timeHorizon: float,
        timeHorizonObst: float,
        radius: float,
        maxSpeed: float,
        velocity: Point = (0.0, 0.0),
    ) -> None:
        self._time_step, self._time = timeStep, 0.0
        self._agents = {field: np.empty((1, 0, 2) if field in POINTS else (1, 0)) for field in FIELDS}
        self._polygons: list[Sequence[Point]] = []
        self._obstacles = np.empty((1, 0, 0, 2))
        self.setAgentDefaults(neighborDist, maxNeighbors, timeHorizon, timeHorizonObst, radius, maxSpeed, velocity)

    def setAgentDefaults(
        self,
        neighbor_dist: float,
        max_neighbors: int,
        time_horizon: float,
        time_horizon_obst: float,
        radius: float,
        max_speed: float,
        velocity: Point = (0.0, 0.0),
    ) -> None:
        """Set the parameters of agents that are added with only a position."""
        self._defaults = neighbor_dist, max_neighbors, time_horizon, time_horizon_obst, radius, max_speed, velocity

    def addAgent(
        self,
        pos: Point,
        neighborDist: float | None = None,
        maxNeighbors: int | None = None,
        timeHorizon: float | None = None,
        timeHorizonObst: float | None = None,
        radius: float | None = None,
        maxSpeed: float | None = None,
        velocity: Point | None = None,
    ) -> int:
        """Add an agent with all of its parameters, or with the defaults. Return its number."""
        given = neighborDist, maxNeighbors, timeHorizon, timeHorizonObst, radius, maxSpeed, velocity
        if neighborDist is not None and None in given:
            raise ValueError("give addAgent the position alone, or all parameters")
        values = pos, *(self._defaults if neighborDist is None else given), (0.0, 0.0)
        for field, value in zip(FIELDS, values, strict=True):
            self._agents[field] = np.append(self._agents[field], np.array([[value]], float), axis=1)
        agents = self._agents
        everybody = np.ones((1, 1), bool)
        state = (agents[field] for field in (*POINTS, "Radius", "MaxSpeed"))
        self._crowd = Agents(*state, everybody, everybody)
        self._avoidance = Avoidance(*(agents[field] for field in DEFAULTS[:4]), per_agent(0.0))
        return self.getNumAgents() - 1

    def addObstacle(self, vertices: Sequence[Point]) -> int:
        """Add a polygon with counter-clockwise corners, or a wall between two. Return the first corner's number.

        Agents avoid it after `processObstacles`.
        """
        self._polygons.append(vertices)
        return sum(map(len, self._polygons[:-1]))

    def processObstacles(self) -> None:
        """Make agents avoid the added obstacles."""
        if self._polygons:
            self._obstacles = pad_arrays([np.asarray(polygon, float) for polygon in self._polygons], np.nan)[None]

    def doStep(self) -> None:
        """Compute the velocities of all agents, and move the agents."""
        velocity = avoid(0, self._crowd, self._time_step, self._obstacles, self._avoidance)
        self._agents["Velocity"][:] = velocity
        self._agents["Position"] += self._time_step * velocity
        self._time += self._time_step

    def getNumAgents(self) -> int:
        """Return the number of agents."""
        return self._agents["Radius"].shape[1]

    def getGlobalTime(self) -> float:
        """Return the time since the start in seconds."""
        return self._time

    def getTimeStep(self) -> float:
        """Return the length of a step in seconds."""
        return self._time_step

    def setTimeStep(self, time_step: float) -> None:
        """Set the length of a step in seconds."""
        self._time_step = time_step


def _getter(field: str) -> Callable[[PyRVOSimulator, int], Any]:
    def get(self: PyRVOSimulator, agent_no: int) -> Any:
        value = self._agents[field][0, agent_no].tolist()
        return tuple(value) if field in POINTS else value

    return get


def _setter(field: str) -> Callable[[PyRVOSimulator, int, Any], None]:
    def set_(self: PyRVOSimulator, agent_no: int, value: Any) -> None:
        self._agents[field][0, agent_no] = value

    return set_


for _field in FIELDS:
    setattr(PyRVOSimulator, f"getAgent{_field}", _getter(_field))
    setattr(PyRVOSimulator, f"setAgent{_field}", _setter(_field))
