"""The built-in layouts: where the agents of a case start and where they go, and what stands in between.

A scenario names its layout in `[layout] generator`. `crowdbench.scenario.placement.Layout` says what a layout is.
"""

from crowdbench.scenario.layouts import blind_corner, corridor, doorway, intersection, room, traffic
from crowdbench.scenario.layouts.crossings import circle_crossing, square_crossing
from crowdbench.scenario.layouts.crowdnav_plus import crowdnav_plus
from crowdbench.scenario.placement import Layout

LAYOUTS: dict[str, Layout] = {
    "circle_crossing": circle_crossing,
    "square_crossing": square_crossing,
    "crowdnav_plus": crowdnav_plus,
    "doorway": doorway.layout,
    "corridor": corridor.layout,
    "blind_corner": blind_corner.layout,
    "intersection": intersection.layout,
    "room": room.layout,
    "traffic": traffic.layout,
}
"""The built-in layouts by name."""
