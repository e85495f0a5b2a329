"""Dynamics of the vehicle: commands, their limits, and the motion in one step.

Simulator, lookaheads, samplers and environments move the vehicle only by this package.
"""

from crowdbench.core.dynamics.actuation import DIRECT as DIRECT
from crowdbench.core.dynamics.actuation import Actuation as Actuation
from crowdbench.core.dynamics.body import DISC as DISC
from crowdbench.core.dynamics.body import Body as Body
from crowdbench.core.dynamics.body import chain as chain
from crowdbench.core.dynamics.body import disc_centres as disc_centres
from crowdbench.core.dynamics.body import hull as hull
from crowdbench.core.dynamics.body import nose as nose
from crowdbench.core.dynamics.body import outline as outline
from crowdbench.core.dynamics.body import reach as reach
from crowdbench.core.dynamics.dynamics import Dynamics as Dynamics
from crowdbench.core.dynamics.dynamics import State as State
from crowdbench.core.dynamics.kernels import SPEED_TOLERANCE as SPEED_TOLERANCE
from crowdbench.core.dynamics.vehicles import DYNAMICS as DYNAMICS
from crowdbench.core.dynamics.vehicles import FREE as FREE
from crowdbench.core.dynamics.vehicles import Bicycle as Bicycle
from crowdbench.core.dynamics.vehicles import Holonomic as Holonomic
from crowdbench.core.dynamics.vehicles import Unicycle as Unicycle
