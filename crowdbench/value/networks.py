"""The value networks: joint states of a crowd to one number.

All are called as `network(joint [..., pedestrian, 13], present [..., pedestrian]) -> [...]`. An absent pedestrian
changes nothing, and where nobody is present the value is known without a network.
"""

from __future__ import annotations

import abc
import itertools

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from crowdbench.reward import DISCOUNT, SUCCESS
from crowdbench.value.joint_state import DISTANCE, SIZE, VEHICLE
from crowdbench.weights.store import load_into, weights_file

Joint = Float[Tensor, "*batch pedestrian 13"]
Present = Bool[Tensor, "*batch pedestrian"]


def perceptron(*sizes: int, last: bool = False) -> nn.Sequential:
    """Linear layers of these sizes with rectifiers between them, and one after the last if `last`."""
    layers: list[nn.Module] = []
    for inputs, outputs in itertools.pairwise(sizes):
        layers += [nn.Linear(inputs, outputs), nn.ReLU(inplace=True)]
    return nn.Sequential(*(layers if last else layers[:-1]))


class ValueNetwork(nn.Module, abc.ABC):
    """A value network: fill `crowd`. `name` is what files of its weights call it."""

    name: str

    def forward(self, joint: Joint, present: Present) -> Float[Tensor, "*batch"]:
        """The value of each state."""
        return self.attend(joint, present)[0]

    def attend(
        self, joint: Joint, present: Present
    ) -> tuple[Float[Tensor, "*batch"], Float[Tensor, "*batch pedestrian"]]:
        """The value of each state and each pedestrian's share in it, which sum to 1, or 0 among nobody."""
        batch = present.shape[:-1]
        joint, present = joint.reshape(-1, *joint.shape[-2:]), present.reshape(-1, present.shape[-1])
        value, attention = self.crowd(joint, present)
        accompanied = present.any(-1)
        if not accompanied.all():
            value = torch.where(accompanied, value, alone(joint))
        return value.reshape(batch), attention.reshape(*batch, attention.shape[-1])

    @abc.abstractmethod
    def crowd(
        self, joint: Float[Tensor, "batch pedestrian 13"], present: Bool[Tensor, "batch pedestrian"]
    ) -> tuple[Float[Tensor, "batch"], Float[Tensor, "batch pedestrian"]]:
        """Value and attention; whatever value where nobody is present."""


def alone(joint: Float[Tensor, "batch pedestrian 13"]) -> Float[Tensor, "batch"]:
    """The value where nobody is in the way: the reward for arriving, discounted over the straight way."""
    distance, radius = joint[:, 0, 0], joint[:, 0, 3]
    return SUCCESS * DISCOUNT ** (distance - radius).clamp(min=0.0)


class CADRL(ValueNetwork):
    """Chen et al. 2017 as in CrowdNav: the value of a crowd is the smallest over its pedestrians, taken one by one."""

    name = "cadrl"

    def __init__(self) -> None:
        super().__init__()
        self.pair = perceptron(SIZE, 150, 100, 100, 1)

    def crowd(
        self, joint: Float[Tensor, "batch pedestrian 13"], present: Bool[Tensor, "batch pedestrian"]
    ) -> tuple[Float[Tensor, "batch"], Float[Tensor, "batch pedestrian"]]:
        """See `ValueNetwork`. All attention is on the pedestrian whose value it is."""
        pairs = _spread(self.pair(_gathered(joint, present))[:, 0], present, float("inf"))
        value, who = pairs.min(-1)
        return value, nn.functional.one_hot(who, present.shape[-1]) * present.to(pairs)


class LSTMRL(ValueNetwork):
    """Everett et al. 2018 as in CrowdNav: an LSTM over the pedestrians, the farthest first."""

    name = "lstm_rl"

    def __init__(self) -> None:
        super().__init__()
        self.lstm = nn.LSTM(SIZE, 50, batch_first=True)
        self.value = perceptron(VEHICLE + 50, 150, 100, 100, 1)

    def crowd(
        self, joint: Float[Tensor, "batch pedestrian 13"], present: Bool[Tensor, "batch pedestrian"]
    ) -> tuple[Float[Tensor, "batch"], Float[Tensor, "batch pedestrian"]]:
        """See `ValueNetwork`. It has no attention: everybody's share is the same."""
        far_first = torch.where(present, -joint[..., DISTANCE], float("inf")).argsort(dim=-1)
        states, _ = self.lstm(joint.gather(1, far_first[..., None].expand_as(joint)))
        number = present.sum(-1)
        last = states[torch.arange(len(states), device=states.device), (number - 1).clamp(min=0)]
        value = self.value(torch.cat([joint[:, 0, :VEHICLE], last], -1))[:, 0]
        return value, present / number.clamp(min=1)[:, None]


class SARL(ValueNetwork):
    """Chen et al. 2019, equations 4 to 9: self-attention over the pedestrians."""

    name = "sarl"

    def __init__(self) -> None:
        super().__init__()
        self.embedding = perceptron(SIZE, 150, 100, last=True)
        self.features = perceptron(100, 100, 50)
        # The first layer of the attention sees a pedestrian's embedding joined with the crowd's mean. The mean's
        # half of it is the same for all pedestrians: it is multiplied once.
        self.attention_own = nn.Linear(100, 100)
        self.attention_mean = nn.Linear(100, 100, bias=False)
        self.attention = perceptron(100, 100, 1)
        self.value = perceptron(VEHICLE + 50, 150, 100, 100, 1)

    def crowd(
        self, joint: Float[Tensor, "batch pedestrian 13"], present: Bool[Tensor, "batch pedestrian"]
    ) -> tuple[Float[Tensor, "batch"], Float[Tensor, "batch pedestrian"]]:
        """See `ValueNetwork`."""
        embedding = self.embedding(_gathered(joint, present))
        number = present.sum(-1)
        mean = _spread(embedding, present).sum(1) / number.clamp(min=1)[:, None]
        mean_part = self.attention_mean(mean).repeat_interleave(number, dim=0)
        scores = self.attention((self.attention_own(embedding) + mean_part).relu_())[:, 0]
        # Where nobody is present, a softmax over nothing would be NaN.
        attention = _spread(scores, present, float("-inf")).softmax(-1).nan_to_num(0.0)
        # The features' last layer is linear: it is applied once, to the weighted sum.
        hidden, rectify, last = self.features
        crowd = last((_spread(rectify(hidden(embedding)), present) * attention[..., None]).sum(1))
        value = self.value(torch.cat([joint[:, 0, :VEHICLE], crowd], -1))[:, 0]
        return value, attention


NETWORKS: dict[str, type[ValueNetwork]] = {network.name: network for network in (CADRL, LSTMRL, SARL)}


def _gathered(
    places: Float[Tensor, "batch pedestrian k"], present: Bool[Tensor, "batch pedestrian"]
) -> Float[Tensor, "present k"]:
    """The rows of those present; a view where all are."""
    return places.flatten(0, 1) if present.all() else places[present]


def _spread(
    rows: Float[Tensor, "present *k"], present: Bool[Tensor, "batch pedestrian"], absent: float = 0.0
) -> Tensor:
    """The rows of those present, in the places of a batch whose other places are `absent`: [batch, pedestrian, *k]."""
    if len(rows) == present.numel():
        return rows.reshape(*present.shape, *rows.shape[1:])
    places = rows.new_full((*present.shape, *rows.shape[1:]), absent)
    places[present] = rows
    return places


def load_network(network: str, weights: str, device: str = "cpu") -> ValueNetwork:
    """A value network with trained weights.

    Args:
        network: One of `NETWORKS`.
        weights: The name of built-in weights or `file.safetensors`, with its card beside it.
        device: `cpu` or `cuda`.

    Returns:
        The network, on the device.

    Raises:
        InputError: The weights do not exist, are of another network, or are not those that their card describes.
    """
    return load_into(NETWORKS[network](), network, weights_file(weights), device)
