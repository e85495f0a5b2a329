"""How the vehicle moves: what a command is, which limits it has, and where it leads in a step.

Simulator, lookaheads, samplers and environments all move the vehicle by this package and by nothing else.
"""

from crowdbench.core.dynamics.base import Dynamics as Dynamics
from crowdbench.core.dynamics.base import State as State
from crowdbench.core.dynamics.body import DISC as DISC
from crowdbench.core.dynamics.body import Body as Body
from crowdbench.core.dynamics.body import chain as chain
from crowdbench.core.dynamics.body import disc_centres as disc_centres
from crowdbench.core.dynamics.body import hull as hull
from crowdbench.core.dynamics.body import nose as nose
from crowdbench.core.dynamics.body import outline as outline
from crowdbench.core.dynamics.body import reach as reach
from crowdbench.core.dynamics.motion import SPEED_TOLERANCE as SPEED_TOLERANCE
from crowdbench.core.dynamics.vehicles import DYNAMICS as DYNAMICS
from crowdbench.core.dynamics.vehicles import FREE as FREE
from crowdbench.core.dynamics.vehicles import Bicycle as Bicycle
from crowdbench.core.dynamics.vehicles import Holonomic as Holonomic
from crowdbench.core.dynamics.vehicles import Unicycle as Unicycle
