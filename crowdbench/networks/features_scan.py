"""Input of a policy that observes scans of a lidar instead of pedestrians.

In the frame of the goal, in metres and seconds: the numbers about the vehicle of `crowdbench.networks.features`, its
motion and next two waypoints as in `crowdbench.networks.features_ahead`, and `SCANS` scans of `SCAN_RAYS` distances.
The first ray lies along the x axis, the others follow counter-clockwise. The first scan is the current one; those
before are shortened by the vehicle's motion since then, so that a difference is a motion of others.
"""

from __future__ import annotations

from crowdbench.networks.features import VEHICLE_FEATURES
from crowdbench.networks.features_ahead import MOTION

SCAN_RAYS = 90
"""Rays of a scan."""

SCANS = 3
"""Scans in the input: the current one, and the scans of the steps before."""

SCAN_REACH = 10.0
"""Length of a ray in metres."""

OWN = VEHICLE_FEATURES + MOTION + 4
"""Numbers about the vehicle itself."""

VEHICLE_SCANS = OWN + SCANS * SCAN_RAYS
"""Numbers of the input."""
