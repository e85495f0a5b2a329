"""Encodes pedestrians by attention from the vehicle to them (Liu et al. 2023)."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

from crowdbench.networks.features import VEHICLE_FEATURES
from crowdbench.networks.features_ahead import MOTION, PEDESTRIAN_AHEAD, RAYS, REACH, STEPS, VEHICLE_AHEAD
from crowdbench.networks.layers import attention_weights
from crowdbench.networks.policy import SCALE, Encoder, Seen

HEADS = 4
"""Heads of the attention."""

MEMORY = 64
"""Size of the memory of a policy."""

VEHICLE_SCALE = [SCALE, *[1.0] * (VEHICLE_FEATURES - 1 + MOTION), *[SCALE] * 4, *[REACH] * RAYS]
PEDESTRIAN_SCALE = [SCALE, SCALE, *[1.0] * 4, SCALE, 1.0, *[SCALE] * (2 * STEPS), REACH, 1.0]
"""Divisors of the inputs, so that they are of the order of 1."""


class AttentionEncoder(Encoder):
    """Encoder of the vehicle, walls and any number of pedestrians, whose order does not matter.

    Only the vehicle attends, with several heads (Vaswani et al. 2017). Its queries are compared directly with the codes
    of the pedestrians, because a key matrix could be merged into the query matrix.

    Unlike in Liu et al., pedestrians do not attend to each other, because that takes most of the time.

    Args:
        width: Numbers per pedestrian inside the network.
        encoded: Size of the output.
    """

    def __init__(self, width: int = 64, encoded: int = 128) -> None:
        super().__init__()
        self.encoded = encoded
        self.own = nn.Sequential(nn.Linear(VEHICLE_AHEAD, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU())
        self.each = nn.Sequential(nn.Linear(PEDESTRIAN_AHEAD, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU())
        self.query = nn.Linear(width, HEADS * width)
        self.joined = nn.Sequential(nn.Linear((HEADS + 2) * width, encoded), nn.ReLU())

    def forward(self, seen: Seen) -> Float[Tensor, "row encoded"]:
        """Return the code of the observation in each row, without units; see `crowdbench.networks.features_ahead`."""
        vehicle, pedestrians, mask = seen
        own = self.own(vehicle / vehicle.new_tensor(VEHICLE_SCALE))
        each = self.each(pedestrians / pedestrians.new_tensor(PEDESTRIAN_SCALE)) * mask[..., None]
        query = self.query(own).unflatten(1, (HEADS, -1))
        weight = attention_weights(query @ each.mT / query.shape[2] ** 0.5, mask[:, None])
        # ReLU makes all codes 0 or more, so that the zeros of unseen pedestrians never exceed other codes.
        return self.joined(torch.cat([own, (weight @ each).flatten(1), each.amax(dim=1)], dim=1))
