"""Evaluates value networks on arrays, with numbers of rows for which matrix products are compiled already."""

from __future__ import annotations

import math

import numpy as np
import torch
from jaxtyping import Bool, Float

from crowdbench.networks.value import ValueNetwork
from crowdbench.utils.errors import InputError


@torch.inference_mode()
def evaluate(
    network: ValueNetwork,
    joint: Float[np.ndarray, "*batch pedestrian 13"],
    present: Bool[np.ndarray, "*batch pedestrian"],
) -> tuple[Float[np.ndarray, "*batch"], Float[np.ndarray, "*batch pedestrian"]]:
    """Return a network's values and attention.

    Args:
        network: The network.
        joint: The joint states.
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
        count = int(present.sum())
        added = _round_up(count) - count
        filled = _round_up(states + math.ceil(added / pedestrians))
        present_too = np.zeros((filled, pedestrians), bool)
        present_too[:states] = present
        present_too[states:].reshape(-1)[:added] = True
    joint_too = np.zeros((filled, *joint.shape[1:]), joint.dtype)
    joint_too[:states] = joint
    return joint_too, present_too


def _round_up(number: int) -> int:
    """Return the next number whose binary digits after the first four are 0."""
    unit = 1 << max(number.bit_length() - 4, 0)
    return math.ceil(number / unit) * unit
