"""The policies of pedestrians, and the kernels that they share."""

from crowdbench.sim.pedestrians.base import Memory, PedestrianPolicy, PolicyWithMemory
from crowdbench.sim.pedestrians.habits import Recorded, Standing, StopAndGo, Straight
from crowdbench.sim.pedestrians.orca_crowd import ORCA, ORCAPlus
from crowdbench.sim.pedestrians.power_law import PowerLaw
from crowdbench.sim.pedestrians.social_force import SocialForce

__all__ = [
    "ORCA",
    "Memory",
    "ORCAPlus",
    "PedestrianPolicy",
    "PolicyWithMemory",
    "PowerLaw",
    "Recorded",
    "SocialForce",
    "Standing",
    "StopAndGo",
    "Straight",
]
