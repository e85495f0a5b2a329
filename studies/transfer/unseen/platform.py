"""A platform of a railway station, with pillars: some pedestrians get off a train, and others get on."""

import numpy as np

from crowdbench.scenario import PerAgent, Placement, Placer

HALF = 9.0
"""Half of the length of the platform, in metres."""


def layout(
    rng: np.random.Generator, radius: PerAgent, preferred_speed: PerAgent, *, width: float = 5.0, in_share: float = 0.5
) -> Placement:
    """Let the vehicle drive along a platform between the wall and the train, and pedestrians get on and off the train.

    Args:
        width: Width of the platform [m].
        in_share: Share of the pedestrians that get on [1].
    """
    side = width / 2
    wall = [(-HALF, -side), (HALF, -side)]
    pillars = [[(x, -0.3), (x + 0.6, -0.3), (x + 0.6, 0.3), (x, 0.3)] for x in (-4.3, -0.3, 3.7)]
    placer = Placer(radius, [wall, *pillars])
    placer.add((-6.0, -1.2), (5.0, 1.2))
    train, hall = (
        ((-5.0, side - 0.9), (5.0, side)),
        [((-HALF, 0.7 - side), (-6.5, side)), ((6.5, 0.7 - side), (HALF, side))],
    )

    def place_next() -> bool:
        end = hall[int(rng.integers(2))]
        start, goal = (end, train) if rng.random() < in_share else (train, end)
        return placer.draw(rng, start, goal)

    return placer.fill(place_next, f"a platform of {width:g} m", "layout.width")
