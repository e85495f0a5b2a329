"""The data types: worlds, what a planner observes of them, the rules of a scenario, and traces of episodes.

Axes always have the order world, action, mode, time, agent, xy. On an axis `agent`, agent 0 is the vehicle and the
others are pedestrians; an axis `pedestrian` has only the pedestrians. Units are SI: metres, seconds, metres per
second, radians.
"""

from __future__ import annotations

from crowdbench.core.types.observation import Observation, Pedestrians, Vehicle
from crowdbench.core.types.rules import (
    COLLISION_RULES,
    DISCOMFORT_GAP,
    HISTORY,
    PERFECT,
    Lidar,
    Noise,
    Outcome,
    RuleNumbers,
    Rules,
    Sensor,
    WalkingLimits,
)
from crowdbench.core.types.world import Trace, World

__all__ = [
    "COLLISION_RULES",
    "DISCOMFORT_GAP",
    "HISTORY",
    "PERFECT",
    "Lidar",
    "Noise",
    "Observation",
    "Outcome",
    "Pedestrians",
    "RuleNumbers",
    "Rules",
    "Sensor",
    "Trace",
    "Vehicle",
    "WalkingLimits",
    "World",
]
