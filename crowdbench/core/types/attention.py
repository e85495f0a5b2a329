"""Parameters of the attention of pedestrians to a visible vehicle; the model is in `sim.attention`."""

from __future__ import annotations

from typing import Any

from pydantic import Field

from crowdbench.utils.toml import TomlTable, number

AVOIDS, IGNORES, YIELDS_LATE, ATTRACTED = 0, 1, 2, 3
"""Reactions of pedestrians that have noticed the vehicle: as to other pedestrians, none, only just before contact, and
approach out of interest. Agrawal et al. (2025) name avoidance, neutrality and attraction."""


CLEARANCE = 0.2
"""Default distance in metres to the vehicle: the discomfort distance of Chen et al. (2019)."""


def _share(default: float) -> Any:
    return Field(default=default, ge=0, le=1, description="a share from 0 to 1")


class Attention(TomlTable):
    """`[pedestrians.attention]`: how pedestrians notice a visible vehicle and react to it.

    It has no effect if the vehicle is not visible. Shares are of all pedestrians. Pedestrians that neither ignore the
    vehicle, nor yield late, nor are attracted, avoid it.

    Attributes:
        ignores: Share of pedestrians that adapt to it only while it stands.
        yields_late: Share of pedestrians that adapt just before they would touch it.
        attracted: Share of pedestrians that approach it to look at it.
        distracted: Share of pedestrians that look away at times. Of 10,543 observed pedestrians 8 % were texting
            while they walked (PMC5762430).
        delay: Time in seconds from the first sight of the vehicle until it is noticed.
        clearance: Distance in metres between rims that pedestrians who adapt keep to the vehicle; None for `CLEARANCE`.
    """

    ignores: float = _share(0.0)
    yields_late: float = _share(0.0)
    attracted: float = _share(0.0)
    distracted: float = _share(0.08)
    delay: float = number(0.4, least=0.0, below=1e3)
    # Absent from the dump by default, so that it does not change the identity of other scenarios.
    clearance: float | None = Field(
        default=None, ge=0, le=100, exclude_if=lambda value: value is None, description="a number from 0 to 100"
    )

    @property
    def distance(self) -> float:
        """The clearance in metres."""
        return CLEARANCE if self.clearance is None else self.clearance
