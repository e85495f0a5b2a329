"""The space around the vehicle in which no pedestrian starts or respawns."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from crowdbench.core.arrays import Agents, PerAgent, WayPoints
from crowdbench.core.geometry import dot, norm
from crowdbench.utils.toml import TomlTable, number


class ClearSpace(TomlTable):
    """`[pedestrians] clear_space`: the size of the space.

    Attributes:
        distance: Smallest distance in metres between the rims of the vehicle and of a new pedestrian.
        time: Smallest time in seconds until they touch, if both keep their velocities.
    """

    distance: float = number(least=0.0, below=1e3)
    time: float = number(least=0.0, below=1e3)

    def is_entered(self, discs: Float[np.ndarray, "disc 2"], position: Agents, reach: PerAgent) -> bool:
        """Return whether a pedestrian is nearer to the vehicle than `distance`; see `holds`."""
        return bool((norm(position[:, None] - discs) - reach[:, None] < self.distance).any())

    def holds(
        self,
        discs: Float[np.ndarray, "disc 2"],
        vehicle_velocity: Float[np.ndarray, "2"],
        position: Agents,
        velocity: Agents,
        reach: PerAgent,
    ) -> bool:
        """Return whether all pedestrians keep `distance` and `time` from a vehicle.

        Args:
            discs: Centres of the discs of the vehicle in metres.
            vehicle_velocity: In m/s.
            position: Positions of pedestrians in metres.
            velocity: Velocities of pedestrians in m/s.
            reach: Radius of each pedestrian plus the radius of the discs of the vehicle, in metres.
        """
        if self.is_entered(discs, position, reach):
            return False
        offset = position[:, None] - discs
        motion = np.broadcast_to((velocity - vehicle_velocity)[:, None], offset.shape)
        a, b, c = dot(motion, motion), dot(offset, motion), dot(offset, offset) - reach[:, None] ** 2
        touches = (b < 0.0) & (b**2 >= a * c)
        when = (-b - np.sqrt(np.maximum(b**2 - a * c, 0.0))) / np.where(a > 0.0, a, 1.0)
        return not (touches & (when <= self.time)).any()


def velocities_ahead(start: Agents, goal: Agents, route: WayPoints | None, speed: PerAgent) -> Agents:
    """Return the initial velocities of agents in m/s: at their preferred speed to the first waypoint, or to the
    goal.

    Args:
        start: In metres.
        goal: In metres.
        route: Waypoints in metres, NaN beyond the last one of each; None without obstacles.
        speed: Preferred speeds in m/s.
    """
    toward = goal
    if route is not None and route.shape[1]:
        toward = np.where(np.isfinite(route[:, 0]), route[:, 0], goal)
    offset = toward - start
    return offset * (speed / np.maximum(norm(offset), 1e-9))[:, None]
