"""Encodes pedestrians together with the vehicle, as a weighted sum and a maximum."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

from crowdbench.networks.features import PEDESTRIAN_FEATURES, VEHICLE_FEATURES
from crowdbench.networks.layers import attention_weights
from crowdbench.networks.policy import SCALE, Encoder, Seen


class SetEncoder(Encoder):
    """Encoder of the vehicle and any number of pedestrians, whose order does not matter.

    Each pedestrian is encoded together with the vehicle. The output is a sum over pedestrians, weighted by attention,
    and the largest value of each number: the sum describes the crowd, the maximum the most urgent pedestrian.

    Args:
        width: Numbers per pedestrian inside the network.
        encoded: Size of the output.
    """

    def __init__(self, width: int = 64, encoded: int = 128) -> None:
        super().__init__()
        self.encoded = encoded
        self.each = nn.Sequential(
            nn.Linear(VEHICLE_FEATURES + PEDESTRIAN_FEATURES, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU()
        )
        self.attention = nn.Linear(width, 1)
        self.joined = nn.Sequential(nn.Linear(VEHICLE_FEATURES + 2 * width, encoded), nn.ReLU())

    def forward(self, seen: Seen) -> Float[Tensor, "world encoded"]:
        """Return the code of the observation in each world, without units."""
        vehicle, pedestrians, mask = seen
        vehicle = vehicle / vehicle.new_tensor([SCALE, 1.0, 1.0, 1.0, 1.0])
        pedestrians = pedestrians / pedestrians.new_tensor([SCALE, SCALE, 1.0, 1.0, 1.0, 1.0, SCALE, 1.0])
        own = vehicle[:, None].expand(-1, pedestrians.shape[1], -1)
        each = self.each(torch.cat([own, pedestrians], dim=2)) * mask[..., None]
        weight = attention_weights(self.attention(each)[..., 0], mask)
        crowd = (weight[..., None] * each).sum(dim=1)
        # ReLU makes all codes 0 or more, so that the zeros of unseen pedestrians never exceed other codes.
        return self.joined(torch.cat([vehicle, crowd, each.amax(dim=1)], dim=1))
