"""The policies that can be trained, and user-defined encoders (feature extractors) for them."""

from __future__ import annotations

from collections.abc import Callable

import torch

from crowdbench.networks.attention_encoder import MEMORY, AttentionEncoder
from crowdbench.networks.features import PEDESTRIAN_FEATURES, VEHICLE_FEATURES
from crowdbench.networks.features_ahead import PEDESTRIAN_AHEAD, VEHICLE_AHEAD
from crowdbench.networks.features_scan import VEHICLE_SCANS
from crowdbench.networks.policy import Encoder, Policy, Seen
from crowdbench.networks.scan_encoder import ScanEncoder
from crowdbench.networks.set_encoder import SetEncoder
from crowdbench.plugins.kind import Kind, file_and_function
from crowdbench.utils.errors import InputError, is_integer
from crowdbench.utils.resources import plugin_in_time

ENCODERS = Kind("encoder", "encoder", makes=Encoder)

POLICIES: dict[str, tuple[Callable[[], Encoder], int]] = {
    "ppo": (SetEncoder, 0),
    "ppo_attention": (AttentionEncoder, MEMORY),
    "ppo_lidar": (ScanEncoder, 0),
}
"""The policies that can be trained, by the name of the network on cards: the class of their encoder, and the size of
their memory."""

_INPUTS = {
    "ppo": (VEHICLE_FEATURES, PEDESTRIAN_FEATURES),
    "ppo_attention": (VEHICLE_AHEAD, PEDESTRIAN_AHEAD),
    "ppo_lidar": (VEHICLE_SCANS, PEDESTRIAN_FEATURES),
}
"""Numbers about the vehicle and about each pedestrian in the input of each policy."""


def make_policy(network: str, encoder: str | None = None) -> Policy:
    """Return a policy with new weights.

    Args:
        network: One of `POLICIES`.
        encoder: The file of an encoder that replaces the default one.

    Raises:
        InputError: There is no such encoder, or it fails.
    """
    make_encoder, remembered = POLICIES[network]
    return Policy(make_encoder() if encoder is None else _load_encoder(encoder, *_INPUTS[network]), remembered)


def _load_encoder(spec: str, of_vehicle: int, of_pedestrian: int) -> Encoder:
    """Return the encoder of a file, tested on rows of two and of one pedestrian with these numbers of features."""
    if file_and_function(spec)[0] is None:
        raise InputError(f"encoder is {spec!r}, but must be a file: ./mine.py")
    name, encoder = ENCODERS.load(spec)
    mask = torch.tensor([[False, False], [True, False], [True, True]])
    seen = Seen(torch.ones(3, of_vehicle), mask[..., None] * torch.ones(3, 2, of_pedestrian), mask)
    with plugin_in_time(f"the encoder {name} raised"), torch.no_grad():
        code, encoded = encoder(seen), encoder.encoded
        encoder(Seen(seen.vehicle, seen.pedestrians[:, :1], mask[:, :1]))
    if not is_integer(encoded) or not isinstance(code, torch.Tensor) or code.shape != (3, encoded):
        actual = list(code.shape) if isinstance(code, torch.Tensor) else type(code).__name__
        raise InputError(f"the encoder {name} gave {actual} for 3 rows, but must give [3, {encoded}], its `encoded`")
    if not code.isfinite().all():
        raise InputError(f"the encoder {name} gives numbers that are not finite, as where nobody is seen")
    return encoder
