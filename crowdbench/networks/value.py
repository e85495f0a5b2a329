"""The value networks: from the joint states of the vehicle with all pedestrians to the value of the state.

All are called as `network(joint [..., pedestrian, 13], present [..., pedestrian]) -> [...]`. Absent pedestrians have no
influence. If no pedestrian is present, the value has a closed form, and no network is used.
"""

from __future__ import annotations

import abc
import itertools
import math
from collections.abc import Iterable
from typing import cast

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from crowdbench.core.reward import DISCOUNT, SUCCESS
from crowdbench.networks.joint_state import DISTANCE, SIZE, VEHICLE
from crowdbench.networks.weights import load_into, read_card, training_dt, weights_file
from crowdbench.utils.errors import InputError, find_named
from crowdbench.utils.resources import keep_freed_memory

Joint = Float[Tensor, "*batch pedestrian 13"]
Present = Bool[Tensor, "*batch pedestrian"]
Values = Float[Tensor, "*batch"]
JointBatch = Float[Tensor, "batch pedestrian 13"]
PresentBatch = Bool[Tensor, "batch pedestrian"]
ValueAndAttention = tuple[Float[Tensor, "batch"], Float[Tensor, "batch pedestrian"]]


HAS_ONEDNN = bool(torch._C._has_mkldnn) and hasattr(torch.ops.mkldnn, "_linear_pointwise")
"""True if PyTorch includes oneDNN, and its operation for a linear layer with a ReLU."""

keep_freed_memory()


def linear(layer: nn.Linear, x: Float[Tensor, "*batch in"], rectify: bool = False) -> Float[Tensor, "*batch out"]:
    """Return the output of a linear layer, with a ReLU after it if `rectify` is True.

    Under `torch.inference_mode`, on a CPU and in float32, both are one operation of oneDNN. On an AMD processor it
    takes half the time of PyTorch's default, which is MKL. Results are equal except for rounding errors.
    """
    is_plain = x.device.type == "cpu" and x.dtype == torch.float32 and not torch.is_autocast_enabled("cpu")
    if HAS_ONEDNN and is_plain and torch.is_inference_mode_enabled():
        after = "relu" if rectify else "none"
        product: Tensor = torch.ops.mkldnn._linear_pointwise(x, layer.weight, layer.bias, after, [], "")
        return product
    result: Tensor = layer(x)
    return result.relu_() if rectify else result


class Perceptron(nn.Sequential):
    """Linear layers with ReLU between them; see `perceptron`."""

    def forward(self, x: Float[Tensor, "*batch in"]) -> Float[Tensor, "*batch out"]:
        """Return the output of the last layer."""
        layers = list(self)
        for index in range(0, len(layers), 2):
            x = linear(cast("nn.Linear", layers[index]), x, rectify=index + 1 < len(layers))
        return x


def perceptron(*sizes: int, last: bool = False) -> Perceptron:
    """Return linear layers with ReLU between them.

    Args:
        sizes: The size of the input and of every layer.
        last: True if there is a ReLU after the last layer too.
    """
    layers: list[nn.Module] = []
    for inputs, outputs in itertools.pairwise(sizes):
        layers += [nn.Linear(inputs, outputs), nn.ReLU(inplace=True)]
    return Perceptron(*(layers if last else layers[:-1]))


class ValueNetwork(nn.Module, abc.ABC):
    """A value network. A subclass has a `name` and the method `crowd`."""

    name: str
    """The name of the network on the cards of its weights."""

    trained_dt: float | None = None
    """The length of a step in seconds that its weights were trained with; None if they are not trained."""

    def forward(self, joint: Joint, present: Present) -> Values:
        """Return the value of each state.

        Args:
            present: Which pedestrians are present.

        Returns:
            The expected discounted sum of rewards.
        """
        return self.attend(joint, present)[0]

    def attend(self, joint: Joint, present: Present) -> tuple[Values, Float[Tensor, "*batch pedestrian"]]:
        """Return the value of each state, and the attention to each pedestrian.

        Args:
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


@torch.inference_mode()
def evaluate(
    network: ValueNetwork,
    joint: Float[np.ndarray, "*batch pedestrian 13"],
    present: Bool[np.ndarray, "*batch pedestrian"],
) -> tuple[Float[np.ndarray, "*batch"], Float[np.ndarray, "*batch pedestrian"]]:
    """Return a network's values and attention.

    Args:
        present: Which pedestrians are present.

    Returns:
        The output of `ValueNetwork.attend`, as float64.

    Raises:
        InputError: A value is not finite.
    """
    device, batch = next(network.parameters()).device, present.shape[:-1]
    states, those_present = _fill_up(joint.reshape(-1, *joint.shape[-2:]), present.reshape(-1, present.shape[-1]))
    value, attention = network.attend(torch.from_numpy(states).to(device), torch.from_numpy(those_present).to(device))
    number = math.prod(batch)
    values = value[:number].double().cpu().numpy().reshape(batch)
    if not np.isfinite(values).all():
        raise InputError(
            f"the value network {network.name} gave a value of {values[~np.isfinite(values)][0]}, but values must be "
            "finite: its weights or the predicted positions are too large"
        )
    return values, attention[:number].double().cpu().numpy().reshape(present.shape)


def _fill_up(
    joint: Float[np.ndarray, "batch pedestrian 13"], present: Bool[np.ndarray, "batch pedestrian"]
) -> tuple[Float[np.ndarray, "filled pedestrian 13"], Bool[np.ndarray, "filled pedestrian"]]:
    """Return the states padded with zeros, so that the numbers of states and of present pedestrians are round.

    OneDNN compiles a matrix product for each new number of rows, which takes longer than the product.
    """
    states, pedestrians = present.shape
    if present.all():
        filled = _round_up(states)
        present_too = np.ones((filled, pedestrians), bool)
    else:
        more = _round_up(seen := int(present.sum())) - seen
        filled = _round_up(states + -(-more // pedestrians))
        present_too = np.zeros((filled, pedestrians), bool)
        present_too[:states] = present
        present_too[states:].reshape(-1)[:more] = True
    joint_too = np.zeros((filled, *joint.shape[1:]), joint.dtype)
    joint_too[:states] = joint
    return joint_too, present_too


def _round_up(number: int) -> int:
    """Return the next number whose binary digits after the first four are 0."""
    unit = 1 << max(number.bit_length() - 4, 0)
    return -(-number // unit) * unit
