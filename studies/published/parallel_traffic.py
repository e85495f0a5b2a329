"""Parallel traffic of Van Der Meer et al. (2025): the vehicle drives against a stream of pedestrians on open ground."""

import numpy as np

from crowdbench.scenario import MAX_DRAWS, LayoutWithRespawn, PerAgent, Placement, Placer, Position, Surroundings, Trip

HALF, SIDE = 7.0, 1.5
"""Half of the length and of the width of the area in which pedestrians start, in metres."""

GOAL = -HALF - 0.3
"""x of the pedestrians' goals in metres: a pedestrian with a radius of 0.3 m arrives at the end of the area."""


def traffic(rng: np.random.Generator, radius: PerAgent, preferred_speed: PerAgent) -> Placement:
    """Let the vehicle drive from left to right, and pedestrians walk straight from right to left."""
    placer = Placer(radius)
    placer.add((1.0 - HALF, 0.0), (HALF - 1.0, 0.0))

    def place_next() -> bool:
        reach = HALF - placer.radius[len(placer.start)]
        for _ in range(MAX_DRAWS):
            x, y = rng.uniform((-reach, -SIDE), (reach, SIDE)).tolist()
            if placer.start.is_clear(x, y):
                placer.add((x, y), (GOAL, y))
                return True
        return False

    return placer.fill(place_next, f"an area of {2 * HALF:g} m by {2 * SIDE:g} m", "its length")


def come_in(
    rng: np.random.Generator,
    surroundings: Surroundings,
    radius: float,
    preferred_speed: float,
    position: Position | None,
) -> Trip:
    """Return start and goal of a pedestrian that respawns at the right end of the area, behind all others."""
    x, y = (
        max(HALF, float((surroundings.position[:, 0] + surroundings.radius).max()) + radius),
        rng.uniform(-SIDE, SIDE),
    )
    return np.array([x, y]), np.array([GOAL, y])


layout = LayoutWithRespawn(traffic, come_in)
