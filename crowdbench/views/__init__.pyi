from .ego import AGENT_FEATURES as AGENT_FEATURES
from .ego import ego_views as ego_views
from .view import NEAREST as NEAREST
from .view import Observed as Observed
from .view import View as View
from .view import encode as encode
from .view import row_of as row_of
