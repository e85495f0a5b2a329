"""How the vehicle moves: what a command is, which limits it has, and where it leads in a step.

Simulator, lookaheads, samplers and environments all move the vehicle by this package and by nothing else.
"""

from crowdbench.dynamics.base import Dynamics, State
from crowdbench.dynamics.motion import SPEED_TOLERANCE
from crowdbench.dynamics.vehicles import DYNAMICS, Bicycle, Holonomic, Unicycle

__all__ = ["DYNAMICS", "SPEED_TOLERANCE", "Bicycle", "Dynamics", "Holonomic", "State", "Unicycle"]
