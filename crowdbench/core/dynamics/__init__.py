"""How the vehicle moves: what a command is, which limits it has, and where it leads in a step.

Simulator, lookaheads, samplers and environments all move the vehicle by this package and by nothing else.
"""

from crowdbench.core.dynamics.base import Dynamics, State
from crowdbench.core.dynamics.body import DISC, Body, chain, disc_centres, hull, nose, outline, reach
from crowdbench.core.dynamics.motion import SPEED_TOLERANCE
from crowdbench.core.dynamics.vehicles import DYNAMICS, FREE, Bicycle, Holonomic, Unicycle

__all__ = [
    "DISC",
    "DYNAMICS",
    "FREE",
    "SPEED_TOLERANCE",
    "Bicycle",
    "Body",
    "Dynamics",
    "Holonomic",
    "State",
    "Unicycle",
    "chain",
    "disc_centres",
    "hull",
    "nose",
    "outline",
    "reach",
]
