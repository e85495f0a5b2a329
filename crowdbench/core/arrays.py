"""Types of arrays that many functions share: numbers, points, vectors and flags."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

Numbers = Float[np.ndarray, "*batch"]
Vectors = Float[np.ndarray, "*batch 2"]
"""Vectors or points."""

PerAgent = Float[np.ndarray, "agent"]
"""A number per agent, the vehicle first."""

Agents = Float[np.ndarray, "agent 2"]
"""A point or a vector per agent, the vehicle first."""

WayPoints = Float[np.ndarray, "agent waypoint 2"]
"""The waypoints of each agent, NaN after its last one."""

Polygons = Float[np.ndarray, "polygon corner 2"]
"""Obstacles, NaN after the last corner of each; two corners are a wall."""

WorldPoints = Float[np.ndarray, "world 2"]
WorldPaths = Float[np.ndarray, "world time 2"]
Walls = Float[np.ndarray, "world polygon corner 2"]
"""The `Polygons` of each world."""

AgentNumbers = Float[np.ndarray, "world agent"]
AgentPoints = Float[np.ndarray, "world agent 2"]
AgentFlags = Bool[np.ndarray, "world agent"]
AgentInts = Int[np.ndarray, "world agent"]
PedestrianFlags = Bool[np.ndarray, "world pedestrian"]
