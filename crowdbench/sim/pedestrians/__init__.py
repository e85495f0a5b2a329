"""The policies of pedestrians, and the kernels that they share."""

from crowdbench.sim.pedestrians.orca_crowd import ORCA as ORCA
from crowdbench.sim.pedestrians.policy import Memory as Memory
from crowdbench.sim.pedestrians.policy import PedestrianPolicy as PedestrianPolicy
from crowdbench.sim.pedestrians.policy import PolicyWithMemory as PolicyWithMemory
from crowdbench.sim.pedestrians.recorded import Recorded as Recorded
from crowdbench.sim.pedestrians.social_force import SocialForce as SocialForce
