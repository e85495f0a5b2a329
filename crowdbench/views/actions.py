"""The actions of policies: their names, and their conversion to velocities or to commands of the dynamics.

- `normalized`: numbers in [-1, 1] along the axes of the world, times the agent's preferred speed;
- `normalized_goal_frame`: the same along the axes of the frame of the agent's goal;
- `normalized_native`: numbers in [-1, 1] over the range of each number of a command of the vehicle's dynamics;
- `velocity`: a velocity in m/s along the axes of the world;
- `goal_frame`: a velocity in m/s in the frame of the agent's goal;
- `native`: a command of the vehicle's dynamics, see `crowdbench.core.dynamics`.

A pedestrian moves in any direction, so that its native command is a velocity.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from crowdbench.networks.features import Vectors


class Action(NamedTuple):
    """The meaning of the two numbers of an action.

    Attributes:
        axes: `world` or `goal`, the axes of a velocity; or `native`, a command of the dynamics.
        normalized: True for numbers in [-1, 1], False for physical units.
    """

    axes: str
    normalized: bool


ACTIONS: Mapping[str, Action] = MappingProxyType(
    {
        "normalized": Action("world", normalized=True),
        "normalized_goal_frame": Action("goal", normalized=True),
        "normalized_native": Action("native", normalized=True),
        "velocity": Action("world", normalized=False),
        "goal_frame": Action("goal", normalized=False),
        "native": Action("native", normalized=False),
    }
)
"""The actions by name."""


def scale(action: Vectors, low: Vectors, high: Vectors) -> Vectors:
    """Return normalized actions in physical units; numbers beyond [-1, 1] are clipped.

    Args:
        action: The actions.
        low: The physical values of -1.
        high: The physical values of 1.
    """
    return (low + high) / 2.0 + np.clip(action, -1.0, 1.0) * ((high - low) / 2.0)
