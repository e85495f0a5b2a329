"""How far people who walk in two directions have formed lanes: an order parameter of lane formation."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

BAND = 0.75
"""Two people are in the same lane where they are at most this many diameters apart across it."""

LEAST_DIAMETER = 0.4
"""Diameter in metres by which the lanes of smaller people are measured, who would all have a lane of their own."""


def lane_order(
    across: Float[np.ndarray, "world person"], direction: Float[np.ndarray, "world person"], radius: float
) -> Float[np.ndarray, "world"]:
    """The reduced order parameter of lane formation.

    For each person, with n people in the same lane in its own direction (itself among them) and m in the other one,
    the order is ((n - m) / (n + m))^2 (Rex and Löwen 2007). Its mean over people, Phi, is 1 where every lane has one
    direction. It is not 0 where directions are mixed, because lanes have few people. Nowak and Schadschneider (2012)
    therefore reduce it: (Phi - Phi_0) / (1 - Phi_0), where Phi_0 is its mean over all ways to distribute the directions
    among the same places. Here half of the N people walk in each direction, and then the mean of (n - m)^2 over these
    ways is k (N - k) / (N - 1) for a lane of k = n + m people.

    Args:
        across: Where each person is across the corridor, in metres.
        direction: 1 or -1, each for half of the people.
        radius: The people's radius in metres.

    Returns:
        1 where every lane has one direction, on average 0 where directions are mixed; NaN where nobody shares a lane.
    """
    near = np.abs(across[:, :, None] - across[:, None]) <= BAND * max(2.0 * radius, LEAST_DIAMETER)
    lane = near.sum(axis=2)
    order = ((near @ direction[..., None])[..., 0] / lane) ** 2
    number = across.shape[1]
    mixed = ((number - lane) / (lane * (number - 1))).mean(axis=1)
    found, room = order.mean(axis=1) - mixed, 1.0 - mixed
    return np.divide(found, room, out=np.full(len(found), np.nan), where=room > 0.0)
