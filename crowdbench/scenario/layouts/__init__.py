"""The built-in layouts: starts and goals of the agents of a case, and the obstacles between them.

A scenario names its layout in `[layout] generator`. `crowdbench.scenario.placement.Layout` defines layouts.
"""

from crowdbench.scenario.layouts.crossings import circle_crossing, crowdnav_plus, square_crossing
from crowdbench.scenario.layouts.floor_plan import floor_plan
from crowdbench.scenario.layouts.walled import blind_corner, corridor, doorway, intersection, room, traffic
from crowdbench.scenario.placement import Layout

_CROSSINGS: list[Layout] = [circle_crossing, square_crossing, crowdnav_plus]
_WALLED: list[Layout] = [doorway, corridor, blind_corner, intersection, room, traffic, floor_plan]

LAYOUTS = {layout.__name__: layout for layout in _CROSSINGS + _WALLED}
"""The built-in layouts by name."""
