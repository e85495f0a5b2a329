"""The value networks: from the joint states of the vehicle with all pedestrians to the value of the state.

All are called as `network(joint [..., pedestrian, 13], present [..., pedestrian]) -> [...]`. Absent pedestrians have no
influence. If no pedestrian is present, the value has a closed form, and no network is used.
"""

from __future__ import annotations

import abc
from collections.abc import Iterable
from typing import cast

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from crowdbench.core.reward import DISCOUNT, SUCCESS
from crowdbench.networks.joint_state import DISTANCE, SIZE, VEHICLE
from crowdbench.networks.layers import linear, perceptron
from crowdbench.networks.weights import load_into, read_card, training_dt, weights_file
from crowdbench.utils.errors import find_named
from crowdbench.utils.resources import keep_freed_memory

Joint = Float[Tensor, "*batch pedestrian 13"]
Present = Bool[Tensor, "*batch pedestrian"]
Values = Float[Tensor, "*batch"]
JointBatch = Float[Tensor, "batch pedestrian 13"]
PresentBatch = Bool[Tensor, "batch pedestrian"]
ValueAndAttention = tuple[Float[Tensor, "batch"], Float[Tensor, "batch pedestrian"]]


keep_freed_memory()


class ValueNetwork(nn.Module, abc.ABC):
    """A value network. A subclass has a `name` and the method `crowd`."""

    name: str
    """The name of the network on the cards of its weights."""

    trained_dt: float | None = None
    """The length of a step in seconds that its weights were trained with; None if they are not trained."""

    def forward(self, joint: Joint, present: Present) -> Values:
        """Return the value of each state.

        Args:
            joint: The joint states.
            present: Which pedestrians are present.

        Returns:
            The expected discounted sum of rewards.
        """
        return self.attend(joint, present)[0]

    def attend(self, joint: Joint, present: Present) -> tuple[Values, Float[Tensor, "*batch pedestrian"]]:
        """Return the value of each state, and the attention to each pedestrian.

        Args:
            joint: The joint states.
            present: Which pedestrians are present.

        Returns:
            The values, and attention weights. The weights of a state sum to 1; without pedestrians they are 0.
        """
        batch = present.shape[:-1]
        joint, present = joint.reshape(-1, *joint.shape[-2:]), present.reshape(-1, present.shape[-1])
        value, attention = self.crowd(joint, present)
        any_present = present.any(-1)
        if not any_present.all():
            value = torch.where(any_present, value, alone(joint))
        return value.reshape(batch), attention.reshape(*batch, attention.shape[-1])

    @abc.abstractmethod
    def crowd(self, joint: JointBatch, present: PresentBatch) -> ValueAndAttention:
        """Return the same as `attend`, for one batch axis. The value of a state without pedestrians is not used.

        Args:
            joint: The joint states.
            present: Which pedestrians are present.

        Returns:
            The values, and the attention weights.
        """


def alone(joint: JointBatch) -> Float[Tensor, "batch"]:
    """Return the value of a state without pedestrians: the reward of success, discounted over the straight path to the
    goal."""
    distance, radius = joint[:, 0, 0], joint[:, 0, 3]
    return SUCCESS * DISCOUNT ** (distance - radius).clamp(min=0.0)


class CADRL(ValueNetwork):
    """CADRL (Chen et al. 2017), as in CrowdNav: the smallest of the values with every single pedestrian."""

    name = "cadrl"

    def __init__(self) -> None:
        super().__init__()
        self.pair = perceptron(SIZE, 150, 100, 100, 1)

    def crowd(self, joint: JointBatch, present: PresentBatch) -> ValueAndAttention:
        """See `ValueNetwork`. The pedestrian with the smallest value has the weight 1."""
        pairs = _scatter(self.pair(_gather(joint, present))[:, 0], present, float("inf"))
        value, chosen = pairs.min(-1)
        return value, nn.functional.one_hot(chosen, present.shape[-1]) * present.to(pairs)


class LSTMRL(ValueNetwork):
    """LSTM-RL (Everett et al. 2018), as in CrowdNav: an LSTM over the pedestrians, the farthest first."""

    name = "lstm_rl"

    def __init__(self) -> None:
        super().__init__()
        self.lstm = nn.LSTM(SIZE, 50, batch_first=True)
        self.value = perceptron(VEHICLE + 50, 150, 100, 100, 1)

    def crowd(self, joint: JointBatch, present: PresentBatch) -> ValueAndAttention:
        """See `ValueNetwork`. The network has no attention: all pedestrians have the same weight."""
        far_first = torch.where(present, -joint[..., DISTANCE], float("inf")).argsort(dim=-1)
        self.lstm.flatten_parameters()  # else cuDNN warns if the network is a copy of another
        states, _ = self.lstm(joint.gather(1, far_first[..., None].expand_as(joint)))
        number = present.sum(-1)
        last = states[torch.arange(len(states), device=states.device), (number - 1).clamp(min=0)]
        value = self.value(torch.cat([joint[:, 0, :VEHICLE], last], -1))[:, 0]
        return value, present / number.clamp(min=1)[:, None]


class SARL(ValueNetwork):
    """SARL (Chen et al. 2019, equations 4 to 9): self-attention over the pedestrians."""

    name = "sarl"

    def __init__(self) -> None:
        super().__init__()
        self.embedding = perceptron(SIZE, 150, 100, last=True)
        self.features = perceptron(100, 100, 50)
        # The input of the attention is a pedestrian's embedding joined with the mean over all pedestrians. Its first
        # layer is split in two, so that the product with the mean is computed once for all pedestrians.
        self.attention_own = nn.Linear(100, 100)
        self.attention_mean = nn.Linear(100, 100, bias=False)
        self.attention = perceptron(100, 100, 1)
        self.value = perceptron(VEHICLE + 50, 150, 100, 100, 1)

    def crowd(self, joint: JointBatch, present: PresentBatch) -> ValueAndAttention:
        """See `ValueNetwork`."""
        embedding = self.embedding(_gather(joint, present))
        number = present.sum(-1)
        mean = _scatter(embedding, present).sum(1) / number.clamp(min=1)[:, None]
        mean_part = linear(self.attention_mean, mean).repeat_interleave(number, dim=0)
        scores = self.attention((linear(self.attention_own, embedding) + mean_part).relu_())[:, 0]
        # Without pedestrians, the softmax is NaN.
        attention = _scatter(scores, present, float("-inf")).softmax(-1).nan_to_num(0.0)
        # The last layer of the features is linear, and the weights sum to 1: it can be applied to the weighted sum.
        hidden, _, last = cast("Iterable[nn.Linear]", self.features)
        features = _scatter(linear(hidden, embedding, rectify=True), present)
        crowd = linear(last, (features * attention[..., None]).sum(1))
        value = self.value(torch.cat([joint[:, 0, :VEHICLE], crowd], -1))[:, 0]
        return value, attention


NETWORKS: dict[str, type[ValueNetwork]] = {network.name: network for network in (CADRL, LSTMRL, SARL)}
"""The value networks by name. `crowdbench.train.config` has their training methods."""


def _gather(everybody: Float[Tensor, "batch pedestrian k"], present: PresentBatch) -> Float[Tensor, "present k"]:
    """Return the rows of the pedestrians that are present; a view if all are."""
    return everybody.flatten(0, 1) if present.all() else everybody[present]


def _scatter(rows: Float[Tensor, "present *k"], present: PresentBatch, absent: float = 0.0) -> Tensor:
    """Return the inverse of `_gather`: `[batch, pedestrian, *k]`, with the value `absent` for absent pedestrians."""
    if len(rows) == present.numel():
        return rows.reshape(*present.shape, *rows.shape[1:])
    everybody = rows.new_full((*present.shape, *rows.shape[1:]), absent)
    everybody[present] = rows
    return everybody


def load_network(network: str, weights: str, device: str = "cpu") -> ValueNetwork:
    """Return a value network with trained weights.

    Args:
        network: One of `NETWORKS`.
        weights: The name of built-in weights or `file.safetensors`, with its card beside it.
        device: `cpu` or `cuda`.

    Returns:
        The network, on the device.

    Raises:
        InputError: There is no such network, or the weights do not exist, are of another network, or are not those
            that their card describes.
    """
    kind = find_named("value network", network, NETWORKS)
    path = weights_file(weights)
    loaded = load_into(kind(), network, path, device)
    loaded.trained_dt = training_dt(read_card(path))
    return loaded
