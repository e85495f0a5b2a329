"""The layout of window.toml: everybody is at one point far away, until simulate.py places the pedestrians."""

import numpy as np

from crowdbench.scenario import PerAgent, Placement

FAR = 1e5
"""Coordinates in metres: no pedestrian of a recording comes near the vehicle, which stays there."""


def layout(rng: np.random.Generator, radius: PerAgent, preferred_speed: PerAgent) -> Placement:
    """Return the placement."""
    point = np.full((len(radius), 2), FAR)
    return Placement(point, point)
