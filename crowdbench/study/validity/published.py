"""What is published about pedestrians: figures, and where they are from."""

from __future__ import annotations

import math

JAM_DENSITY = 5.4
"""People per square metre at which nobody moves any more (Weidmann 1993)."""


def weidmann_speed(density: float, free_speed: float = 1.34) -> float:
    """Mean walking speed on level ground by density, a fit to 25 data sets (Weidmann 1993).

    Args:
        density: In 1/m^2.
        free_speed: Mean speed of people who walk alone in m/s; Weidmann's is 1.34 m/s.

    Returns:
        In m/s.
    """
    return free_speed * (1.0 - math.exp(-1.913 * (1.0 / density - 1.0 / JAM_DENSITY)))


def single_file_speed(per_metre: float) -> float:
    """Mean walking speed in single file by density, from the required length 0.36 m + 1.06 s v (Seyfried et al. 2005).

    Args:
        per_metre: People per metre, in 1/m.

    Returns:
        In m/s.
    """
    return (1.0 / per_metre - 0.36) / 1.06


DOOR_FLOW = {0.8: 1.61, 1.0: 1.90, 1.2: 1.97}
"""Specific flow in 1/(m s) of 60 people through a bottleneck by its width in metres (Seyfried et al. 2009, table 2)."""
