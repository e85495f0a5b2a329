"""Encodes a lidar's last scans by convolutions along the angle, whose ends are joined."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

from crowdbench.networks.features import VEHICLE_FEATURES
from crowdbench.networks.features_ahead import MOTION
from crowdbench.networks.features_scan import OWN, SCAN_RAYS, SCAN_REACH, SCANS
from crowdbench.networks.policy import SCALE, Encoder, Seen

OWN_SCALE = [SCALE, *[1.0] * (VEHICLE_FEATURES - 1 + MOTION), *[SCALE] * 4]
"""Divisors of the numbers about the vehicle, so that they are of the order of 1."""


class ScanEncoder(Encoder):
    """Encoder of the vehicle and its last scans.

    Args:
        width: Channels of the convolutions.
        encoded: Size of the output.
    """

    def __init__(self, width: int = 32, encoded: int = 128) -> None:
        super().__init__()
        self.encoded = encoded
        self.own = nn.Sequential(nn.Linear(OWN, width), nn.ReLU())
        self.scans = nn.Sequential(
            nn.Conv1d(SCANS + 1, width, 5, stride=3, padding=2, padding_mode="circular"),
            nn.ReLU(),
            nn.Conv1d(width, width, 3, stride=2, padding=1, padding_mode="circular"),
            nn.ReLU(),
            nn.Flatten(),
        )
        self.joined = nn.Sequential(nn.Linear(width + width * SCAN_RAYS // 6, encoded), nn.ReLU())

    def forward(self, seen: Seen) -> Float[Tensor, "row encoded"]:
        """Return the code of the observation in each row, without units; see `crowdbench.networks.features_scan`."""
        own, scans = seen.vehicle[:, :OWN], seen.vehicle[:, OWN:].reshape(-1, SCANS, SCAN_RAYS)
        now = scans[:, :1]
        # The proximity of what is near varies more than that of what is far, as its importance does.
        channels = torch.cat([1.0 / (0.5 + now), now / SCAN_REACH, (now - scans[:, 1:]).clamp(-1.0, 1.0)], dim=1)
        return self.joined(torch.cat([self.own(own / own.new_tensor(OWN_SCALE)), self.scans(channels)], dim=1))
