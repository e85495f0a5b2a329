"""A round fountain in the middle of a square: all agents must go around it, on one side or the other."""

import numpy as np

from crowdbench.scenario import PerAgent, Placement, Placer

CORNERS = 12
"""Corners of the polygon of the fountain."""


def layout(
    rng: np.random.Generator,
    radius: PerAgent,
    preferred_speed: PerAgent,
    *,
    fountain: float = 1.5,
    near: float = 3.5,
    far: float = 7.0,
) -> Placement:
    """Let the vehicle cross a square with a fountain from bottom to top, and pedestrians from side to side.

    Args:
        fountain: Radius of the fountain [m].
        near: Smallest distance of starts and goals from its middle [m].
        far: Largest distance [m].
    """
    angles = 2.0 * np.pi * np.arange(CORNERS) / CORNERS
    placer = Placer(radius, [[(fountain * float(np.cos(a)), fountain * float(np.sin(a))) for a in angles]])
    placer.add((0.0, -5.0), (0.0, 5.0))

    def place_next() -> bool:
        for _ in range(100):
            angle, turn = rng.uniform(0.0, 2.0 * np.pi), np.pi + rng.uniform(-np.pi / 3, np.pi / 3)
            middles = [rng.uniform(near, far) * np.array([np.cos(a), np.sin(a)]) for a in (angle, angle + turn)]
            start, goal = (((x - 0.3, y - 0.3), (x + 0.3, y + 0.3)) for x, y in middles)
            if placer.draw(rng, start, goal):
                return True
        return False

    return placer.fill(place_next, "the square around the fountain", "layout.far")
