from .isolated_planner import IsolatedPlanner as IsolatedPlanner
from .isolated_planner import ResourceLimits as ResourceLimits
from .limits import describe_limits as describe_limits
from .limits import usable_cores as usable_cores
from .sandbox import PROCESS as PROCESS
from .sandbox import level as level
from .untrusted_text import one_line as one_line
