"""The people that the measurements of validity are made with, and the crowds that they make."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from crowdbench import catalog
from crowdbench.scenario import load as scenario_file
from crowdbench.scenario.placement import Placement
from crowdbench.scenario.scenario import Scenario
from crowdbench.utils.errors import InputError


@dataclass(frozen=True, eq=False)
class People:
    """What the people of a crowd have in common.

    Attributes:
        title: What tables call them.
        radius: In metres.
        preferred_speed: In m/s, as a scenario's file writes it.
        densities: How many of them per square metre walk in a corridor, in 1/m^2. More than the last number would not
            fit, or hardly.
        per_metre: How many of them per metre walk in single file, in 1/m.
        waiting: How many of them per square metre wait before a door, in 1/m^2; None where they do not walk through it.
    """

    title: str
    radius: float
    preferred_speed: float | Mapping[str, float]
    densities: tuple[float, ...]
    per_metre: tuple[float, ...]
    waiting: float | None

    @property
    def free_speed(self) -> float:
        """Their mean preferred speed in m/s."""
        speed = self.preferred_speed
        return speed["mean"] if isinstance(speed, Mapping) else speed


DEFAULT = People("radius 0.3 m, 1 m/s", 0.3, 1.0, (0.5, 1.0, 1.5, 2.0, 2.5), (0.8, 1.0, 1.2, 1.4), 1.6)
"""As in most scenarios."""

_WALKERS = {"mean": 1.34, "std": 0.26, "low": 0.82, "high": 1.86}
"""Walking speeds of pedestrians in m/s (Weidmann 1993), within two standard deviations."""

MEASURED = People("radius 0.2 m, 1.34 m/s", 0.2, _WALKERS, (0.5, 1.0, 2.0, 3.0, 4.0), (0.8, 1.2, 1.6, 2.0), 3.3)
"""With measured speeds, and bodies 0.4 m across, of which as many fit on a square metre as in experiments."""

POINTS = People("radius 0.01 m, 1.34 m/s", 0.01, _WALKERS, (0.5, 1.0, 2.0, 3.0), (), None)
"""Almost points, as in the paper on the social force model (Helbing and Molnár 1995)."""

EVERYBODY = (DEFAULT, MEASURED, POINTS)


def crowd(policy: str, people: People, number: int, layout: Callable[..., Placement]) -> Scenario:
    """A scenario without a vehicle in the way: pedestrians do not see it.

    Args:
        policy: The name of a pedestrian policy, or a file with one.
        people: Who walks.
        number: How many.
        layout: Places them. It is not a plug-in that a user could name.

    Returns:
        The scenario, with the policy's default parameters.

    Raises:
        InputError: There is no such policy.
    """
    table: dict[str, Any] = {
        "vehicle": {"radius": people.radius},  # it has to fit where people do
        "pedestrians": {
            "number": number,
            "policy": policy,
            "radius": people.radius,
            "preferred_speed": people.preferred_speed,
        },
    }
    load = scenario_file.Loaders(lambda _: ("validity", layout, None), catalog.load_policy)
    return scenario_file.parse(table, "validity", "validity", load)


def spread(
    rng: np.random.Generator, number: int, radius: float, length: float, width: float
) -> Float[np.ndarray, "{number} 2"]:
    """Places on a rectangle at which discs do not overlap.

    The rectangle is divided into cells, as square as can be, at least one per disc. Each disc lies in a cell of its
    own, drawn by chance, somewhere within it.

    Args:
        rng: The random stream to draw from.
        number: Number of discs.
        radius: Their radius in metres.
        length: Extent of the rectangle along x in metres, from 0.
        width: Extent along y in metres, with 0 in the middle.

    Returns:
        Centres in metres.

    Raises:
        InputError: There is no room for so many.
    """
    rows = range(1, int(width / (2.0 * radius) + 1e-9) + 1)
    fits = [(min(length / math.ceil(number / row), width / row), row) for row in rows]
    size, across = max(fits, default=(0.0, 1))
    if size < 2.0 * radius - 1e-9:
        raise InputError(f"{number} people of radius {radius:g} m have no room on {length:g} m x {width:g} m")
    cell = np.array([length / math.ceil(number / across), width / across])
    along = math.ceil(number / across)
    chosen = rng.permutation(along * across)[:number]
    middle = (np.stack([chosen % along, chosen // along], axis=1) + 0.5) * cell
    play = np.maximum(cell / 2.0 - radius, 0.0)
    return middle + rng.uniform(-play, play, (number, 2)) - [0.0, width / 2.0]
