"""The data types: worlds, observations of planners, the rules of a scenario, and traces of episodes.

Axes always have the order world, action, mode, time, agent, xy. On an axis `agent`, agent 0 is the vehicle and the
others are pedestrians; an axis `pedestrian` has only the pedestrians. Units are SI: metres, seconds, metres per
second, radians.
"""

from __future__ import annotations

from crowdbench.core.types.observation import Observation as Observation
from crowdbench.core.types.observation import Pedestrians as Pedestrians
from crowdbench.core.types.observation import Vehicle as Vehicle
from crowdbench.core.types.rules import COLLISION_RULES as COLLISION_RULES
from crowdbench.core.types.rules import DISCOMFORT_GAP as DISCOMFORT_GAP
from crowdbench.core.types.rules import HISTORY as HISTORY
from crowdbench.core.types.rules import PERFECT_SENSOR as PERFECT_SENSOR
from crowdbench.core.types.rules import Detector as Detector
from crowdbench.core.types.rules import Intention as Intention
from crowdbench.core.types.rules import Lidar as Lidar
from crowdbench.core.types.rules import Noise as Noise
from crowdbench.core.types.rules import Outcome as Outcome
from crowdbench.core.types.rules import RuleNumbers as RuleNumbers
from crowdbench.core.types.rules import Rules as Rules
from crowdbench.core.types.rules import Sensor as Sensor
from crowdbench.core.types.rules import WalkingLimits as WalkingLimits
from crowdbench.core.types.world import Trace as Trace
from crowdbench.core.types.world import World as World
