"""Input and actions of a policy that drives by the scans of a lidar alone."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.core.types import Observation
from crowdbench.networks.features import Features, Vectors, clip_to_disc, features, to_goal_frame, to_world
from crowdbench.networks.features_ahead import motion
from crowdbench.networks.features_scan import SCAN_RAYS, SCAN_REACH, SCANS
from crowdbench.sim.lidar import scan_of

Rays = Float[np.ndarray, "world ray"]

GAP = 0.02
"""Smallest gap in metres to what a scan meets, if it stands still."""

CORRECTIONS = 4
"""Rays along which a velocity is limited one after the other."""

_ANGLE = 2.0 * np.pi * np.arange(SCAN_RAYS) / SCAN_RAYS
_RAYS = np.stack([np.cos(_ANGLE), np.sin(_ANGLE)], axis=1)


class ScanInterface:
    """Scans that a policy observes, and the meaning of its actions.

    The last scans are kept for each world, by the row of the observation. Actions are velocities in the frame of the
    goal. They are limited along the rays, so that the vehicle stops in front of what stands still.

    Attributes:
        nearest: The number of pedestrians that it observes.
        predictor: None, because it predicts no pedestrians.
    """

    nearest = 0
    predictor = None

    def __init__(self) -> None:
        self.reset(np.arange(0))

    def reset(self, rows: Int[np.ndarray, "world"]) -> None:
        """Forget all scans. See `Planner.reset`."""
        self._worlds = len(rows)
        self._scans: Float[np.ndarray, "world scan beam"] | None = None

    def forget(self, rows: Int[np.ndarray, "row"]) -> None:
        """Forget the scans of some worlds, in which another episode starts."""
        if self._scans is not None:
            self._is_new[rows] = True

    def __call__(self, obs: Observation) -> Features:
        """Return the input of the policy for the observation of a step."""
        shown, distance = features(obs, 1), scan_of(obs)
        self._remember(obs, distance)
        assert self._scans is not None
        parts = [shown.vehicle, motion(obs, shown.axis)]
        for scan in range(SCANS):
            rays = _along(self._scans[obs.row, scan], self._headings[obs.row, scan], shown.axis)
            moved = to_goal_frame(obs.vehicle.position - self._positions[obs.row, scan], shown.axis)
            parts.append(np.minimum(rays, SCAN_REACH) - moved @ _RAYS.T)
        nobody = np.zeros_like(shown.pedestrians), np.zeros_like(shown.seen)
        return shown._replace(vehicle=np.concatenate(parts, axis=1), pedestrians=nobody[0], seen=nobody[1])

    def velocities(self, action: Vectors, obs: Observation, axis: Vectors) -> Vectors:
        """Convert actions to velocities in m/s, limited along the rays of the current scan.

        Args:
            action: The actions of a policy.
            obs: The observation.
            axis: The direction of the goal, as in `Features`.
        """
        vehicle, world = obs.vehicle, np.arange(len(obs))
        velocity = clip_to_disc(action, vehicle.preferred_speed)
        room = _along(scan_of(obs), vehicle.heading, axis) - vehicle.radius[:, None] - GAP
        time = obs.dt + vehicle.preferred_speed / vehicle.dynamics.limits[0]  # of a step, and to stop
        limit = np.maximum(room, 0.0) / time[:, None]
        for _ in range(CORRECTIONS):
            excess = velocity @ _RAYS.T - limit
            ray = excess.argmax(axis=1)
            velocity = velocity - np.maximum(excess[world, ray], 0.0)[:, None] * _RAYS[ray]
        return to_world(velocity, axis)

    def _remember(self, obs: Observation, distance: Rays) -> None:
        """Append the current scan, with the heading and the position of the vehicle. New worlds repeat the first."""
        row = obs.row
        if self._scans is None or len(self._is_new) <= row.max():  # the first call, or one without a reset
            worlds = max(self._worlds, int(row.max()) + 1)
            self._scans = np.empty((worlds, SCANS, distance.shape[1]))
            self._headings, self._positions = np.empty((worlds, SCANS)), np.empty((worlds, SCANS, 2))
            self._is_new: Bool[np.ndarray, "world"] = np.ones(worlds, bool)
        now = distance, obs.vehicle.heading, obs.vehicle.position
        for kept, value in zip((self._scans, self._headings, self._positions), now, strict=True):
            before = np.concatenate([value[:, None], kept[row, :-1]], axis=1)
            is_new = self._is_new[row].reshape(-1, *[1] * (kept.ndim - 1))
            kept[row] = np.where(is_new, value[:, None], before)
        self._is_new[row] = False


def _along(distance: Float[np.ndarray, "world beam"], heading: Float[np.ndarray, "world"], axis: Vectors) -> Rays:
    """Return a scan along `SCAN_RAYS` rays, the first along `axis`: each is the shortest of the beams next to it."""
    beams = distance.shape[1]
    angle = np.arctan2(axis[:, 1], axis[:, 0]) - heading
    nearest = np.rint((angle[:, None] + _ANGLE) * (beams / (2.0 * np.pi))).astype(np.int64)
    width = max(beams // SCAN_RAYS, 1)
    around = nearest[..., None] + np.arange(width) - width // 2
    rays: Rays = np.take_along_axis(distance[:, None], around % beams, axis=2).min(axis=2)
    return rays
