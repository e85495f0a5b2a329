"""Encodes who is around by attention: among the pedestrians, and from the vehicle to them (Liu et al. 2023)."""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn.functional import scaled_dot_product_attention

from crowdbench.networks.features_ahead import PEDESTRIAN_AHEAD, REACH, STEPS, VEHICLE_AHEAD, WALLS
from crowdbench.networks.policy import SCALE, Encoder, Seen

HEADS = 4
"""Heads of each attention."""

MEMORY = 128
"""Numbers that a policy keeps from step to step."""

VEHICLE_SCALE = [SCALE, *[1.0] * 10, *[SCALE, SCALE, 1.0] * WALLS]
PEDESTRIAN_SCALE = [SCALE, SCALE, *[1.0] * 4, SCALE, 1.0, *[SCALE] * (2 * STEPS), REACH, 1.0]
"""Divisor of the input, so that it is of the order of 1."""


class Attention(nn.Module):
    """Attention of some to others, in several heads (Vaswani et al. 2017).

    Args:
        width: Numbers of each.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        self.asks, self.offers = nn.Linear(width, width), nn.Linear(width, 2 * width)
        self.joined = nn.Linear(width, width)

    def forward(
        self,
        one: Float[Tensor, "row some width"],
        other: Float[Tensor, "row others width"],
        mask: Bool[Tensor, "row others"],
    ) -> Float[Tensor, "row some width"]:
        """Attend from some pedestrians to all that exist; a row must have one."""

        def heads(tensor: Tensor) -> Tensor:
            return tensor.view(*tensor.shape[:2], HEADS, -1).transpose(1, 2)

        key, value = self.offers(other).chunk(2, dim=2)
        asked = heads(self.asks(one))
        heard = scaled_dot_product_attention(asked, heads(key), heads(value), attn_mask=mask[:, None, None])
        return self.joined(heard.transpose(1, 2).flatten(2))


class AttentionEncoder(Encoder):
    """Encodes the vehicle, walls and any number of pedestrians, whose order does not matter.

    Args:
        width: Numbers per pedestrian inside the network.
        encoded: Numbers that come out.
    """

    def __init__(self, width: int = 64, encoded: int = 128) -> None:
        super().__init__()
        self.encoded = encoded
        self.own = nn.Sequential(nn.Linear(VEHICLE_AHEAD, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU())
        self.each = nn.Sequential(nn.Linear(PEDESTRIAN_AHEAD, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU())
        self.among, self.toward = Attention(width), Attention(width)
        self.joined = nn.Sequential(nn.Linear(3 * width, encoded), nn.ReLU())

    def forward(self, seen: Seen) -> Float[Tensor, "row encoded"]:
        """The code of what is seen in each row, without units; see `crowdbench.networks.features_ahead`."""
        vehicle, pedestrians, mask = seen
        own = self.own(vehicle / vehicle.new_tensor(VEHICLE_SCALE))
        each = self.each(pedestrians / pedestrians.new_tensor(PEDESTRIAN_SCALE))
        anybody = mask.any(dim=1, keepdim=True)
        # Without anybody attention would be undefined: it goes to nobody in particular then, and is not heard.
        heard = mask | ~anybody
        each = each + self.among(each, each, heard)
        crowd = self.toward(own[:, None], each, heard)[:, 0] * anybody
        urgent = each.masked_fill(~mask[..., None], -torch.inf).amax(dim=1).masked_fill(~anybody, 0.0)
        return self.joined(torch.cat([own, crowd, urgent], dim=1))
