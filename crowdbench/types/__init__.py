"""The data that everything is made of: worlds, what a planner sees of them, and what an episode leaves.

Axes always come in the order world, action, mode, time, agent, xy. Agent 0 is the vehicle, the others
are pedestrians; an axis called `pedestrian` leaves the vehicle out. Units are SI: metres, seconds,
metres per second, radians.
"""

from __future__ import annotations

from crowdbench.types.observation import Observation, Pedestrians, Vehicle
from crowdbench.types.rules import COLLISION_RULES, DISCOMFORT_GAP, HISTORY, Outcome, Rules
from crowdbench.types.trace import Trace
from crowdbench.types.world import World

__all__ = [
    "COLLISION_RULES",
    "DISCOMFORT_GAP",
    "HISTORY",
    "Observation",
    "Outcome",
    "Pedestrians",
    "Rules",
    "Trace",
    "Vehicle",
    "World",
]
