"""Encodes who is around by attention from the vehicle to the pedestrians (Liu et al. 2023)."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

from crowdbench.networks.features import VEHICLE_FEATURES
from crowdbench.networks.features_ahead import MOTION, PEDESTRIAN_AHEAD, RAYS, REACH, STEPS, VEHICLE_AHEAD
from crowdbench.networks.policy import SCALE, Encoder, Seen

HEADS = 4
"""Heads of the attention."""

MEMORY = 64
"""Numbers that a policy keeps from step to step."""

VEHICLE_SCALE = [SCALE, *[1.0] * (VEHICLE_FEATURES - 1 + MOTION), *[SCALE] * 4, *[REACH] * RAYS]
PEDESTRIAN_SCALE = [SCALE, SCALE, *[1.0] * 4, SCALE, 1.0, *[SCALE] * (2 * STEPS), REACH, 1.0]
"""Divisors of what is shown, so that inputs are of the order of 1."""


class AttentionEncoder(Encoder):
    """Encoder of the vehicle, walls and any number of pedestrians, whose order does not matter.

    The vehicle alone attends, in several heads (Vaswani et al. 2017). Its queries are compared with the codes of the
    pedestrians themselves: a matrix of keys would only be multiplied with that of the queries.

    Differs from Liu et al. because pedestrians do not attend to each other, which costs most of the time.

    Args:
        width: Numbers per pedestrian inside the network.
        encoded: Numbers that come out.
    """

    def __init__(self, width: int = 64, encoded: int = 128) -> None:
        super().__init__()
        self.encoded = encoded
        self.own = nn.Sequential(nn.Linear(VEHICLE_AHEAD, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU())
        self.each = nn.Sequential(nn.Linear(PEDESTRIAN_AHEAD, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU())
        self.query = nn.Linear(width, HEADS * width)
        self.joined = nn.Sequential(nn.Linear((HEADS + 2) * width, encoded), nn.ReLU())

    def forward(self, seen: Seen) -> Float[Tensor, "row encoded"]:
        """Return the code of what is seen in each row, without units; see `crowdbench.networks.features_ahead`."""
        vehicle, pedestrians, mask = seen
        own = self.own(vehicle / vehicle.new_tensor(VEHICLE_SCALE))
        each = self.each(pedestrians / pedestrians.new_tensor(PEDESTRIAN_SCALE)) * mask[..., None]
        query = self.query(own).unflatten(1, (HEADS, -1))
        score = (query @ each.mT / query.shape[2] ** 0.5).masked_fill(~mask[:, None], -torch.inf)
        # Without any pedestrian there is nothing to weight, and softmax would be undefined.
        weight = torch.softmax(score.masked_fill(~mask.any(dim=1)[:, None, None], 0.0), dim=2)
        # ReLU makes what is encoded 0 or more, so that 0 for those who are not seen is never a maximum of others.
        return self.joined(torch.cat([own, (weight @ each).flatten(1), each.amax(dim=1)], dim=1))
