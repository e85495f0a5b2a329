"""The built-in layouts: where the agents of a case start and where they go, and what stands in between.

A scenario names its layout in `[layout] generator`. `crowdbench.scenario.placement.Layout` says what a layout is.
"""

from crowdbench.scenario.layouts import walled
from crowdbench.scenario.layouts.crossings import circle_crossing, crowdnav_plus, square_crossing
from crowdbench.scenario.placement import Layout

LAYOUTS: dict[str, Layout] = {
    "circle_crossing": circle_crossing,
    "square_crossing": square_crossing,
    "crowdnav_plus": crowdnav_plus,
    "doorway": walled.doorway,
    "corridor": walled.corridor,
    "blind_corner": walled.blind_corner,
    "intersection": walled.intersection,
    "room": walled.room,
    "traffic": walled.traffic,
}
"""The built-in layouts by name."""
