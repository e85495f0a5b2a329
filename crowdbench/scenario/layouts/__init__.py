"""The built-in layouts: where the agents of a case start and where they go, and what stands in between.

A scenario names its layout in `[layout] generator`. `crowdbench.scenario.placement.Layout` says what a layout is.
"""

from crowdbench.scenario.layouts.crossings import circle_crossing, square_crossing
from crowdbench.scenario.placement import Layout, Placement

__all__ = ["LAYOUTS", "Layout", "Placement", "circle_crossing", "square_crossing"]

LAYOUTS: dict[str, Layout] = {
    "circle_crossing": circle_crossing,
    "square_crossing": square_crossing,
}
"""The built-in layouts by name."""
