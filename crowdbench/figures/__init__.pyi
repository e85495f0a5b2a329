from .style import COLOURS as COLOURS
from .style import DASHES as DASHES
from .style import FIGURE_HEIGHT as FIGURE_HEIGHT
from .style import MARKERS as MARKERS
from .style import axes as axes
