"""Trained weights on disk: a safetensors file, and a card beside it with the origin of the weights.

The card is JSON: `network`, the `sha256` of the weights file, the conditions of the training, and the measured results.
No pickle is ever opened, because that would run code from the file.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import torch
from safetensors import SafetensorError
from safetensors.torch import load, save
from torch import nn

from crowdbench.plugins.kind import ROOT
from crowdbench.utils.errors import InputError, find_named, is_number
from crowdbench.utils.files import read_json, read_regular, write_whole

WEIGHTS = ROOT / "agents" / "weights"
"""The folder of the built-in weights."""

WEIGHTS_SUFFIX = ".safetensors"
"""The suffix of files of weights."""

Network = TypeVar("Network", bound=nn.Module)


def built_in() -> list[Path]:
    """Return the files of the built-in weights, ordered by name."""
    return sorted(WEIGHTS.glob(f"*{WEIGHTS_SUFFIX}"))


def weights_file(weights: str) -> Path:
    """Return the file of the built-in weights of that name; a path that ends in `.safetensors` is returned unchanged.

    Raises InputError if no weights have that name.
    """
    if weights.endswith(WEIGHTS_SUFFIX):
        return Path(weights)
    known = {path.stem: path for path in built_in()}
    return find_named("file of weights", weights, known, WEIGHTS_SUFFIX)


def save_network(network: nn.Module, name: str, path: Path, card: Mapping[str, Any]) -> dict[str, Any]:
    """Write weights, and their card beside them. The weights are written last, so that they never exist without a card.

    Args:
        path: The file of the weights, which ends in .safetensors.
        card: Contents of the card, without the name of the network and the sha256 of the file.

    Raises:
        OSError: One of the files cannot be written.
    """
    content = save({key: tensor.detach().cpu().contiguous() for key, tensor in network.state_dict().items()})
    about = {"network": name, "sha256": hashlib.sha256(content).hexdigest(), **card}
    with write_whole(path.with_suffix(".json")) as partial:
        partial.write_text(json.dumps(about, indent=2) + "\n", encoding="utf-8")
    with write_whole(path) as partial:
        partial.write_bytes(content)
    return about


def read_card(path: Path) -> dict[str, Any]:
    """Return the card of the weights at `path`. Raises InputError if the card does not exist or is invalid."""
    card = path.with_suffix(".json")
    try:
        table = read_json(card)
    except OSError as error:
        raise InputError(f"the weights {path} need their card {card.name} beside them: {error.strerror}") from None
    if not isinstance(table, dict) or not all(isinstance(table.get(key), str) for key in ("network", "sha256")):
        raise InputError(f"{card} is not a card of weights: it must name their network and their sha256")
    if not isinstance(table.get("training", {}), dict):
        raise InputError(f"{card} is not a card of weights: its training must be a table")
    return table


def training_dt(card: Mapping[str, Any]) -> float:
    """Return the length of a step in seconds in the scenario on a card; 0.25 if the card contains none."""
    scenario = card.get("training", {}).get("scenario")
    dt = scenario.get("dt") if isinstance(scenario, dict) else None
    return float(dt) if dt is not None and is_number(dt) else 0.25


def load_into(network: Network, name: str, path: Path, device: str = "cpu") -> Network:
    """Load the weights in a file into a network.

    Args:
        network: The network, with any weights.
        name: The name of the network, which the card must have too.
        path: The file of the weights.
        device: `cpu` or `cuda`.

    Returns:
        The same network, on the device.

    Raises:
        InputError: The weights are missing, altered, of another network, not finite, or not weights; or there is no
            such device.
    """
    try:
        content = read_regular(path)
    except OSError as error:
        raise InputError(f"the weights {path} cannot be read: {error.strerror}") from None
    card = read_card(path)
    if card["network"] != name:
        raise InputError(f"the weights {path} are of the network {card['network']}, but must be of {name}")
    if hashlib.sha256(content).hexdigest() != card["sha256"]:
        raise InputError(f"the weights {path} are not those that their card describes: their sha256 differs")
    try:
        place = torch.device(device)
    except RuntimeError:  # torch lists all its devices
        raise InputError(f"torch knows no device {device!r}: give cpu or cuda") from None
    try:
        tensors = load(content)
        network.load_state_dict(tensors)
        moved = network.to(place)
        next(moved.parameters()).cpu()  # the device `meta` has no values to compute with
    except (SafetensorError, RuntimeError, AssertionError) as error:
        # torch lists all missing and unexpected tensors, one per line.
        reason = " ".join(str(error).split())[:200]
        raise InputError(f"the weights {path} cannot be loaded on {device}: {reason}") from None
    for key, tensor in tensors.items():
        if not tensor.isfinite().all():
            raise InputError(f"the weights {path} have numbers in {key} that are not finite: train them again")
    return moved


def weights_digest(network: nn.Module) -> str:
    """Return twelve hexadecimal digits that change with the weights."""
    sha = hashlib.sha256()
    for tensor in network.state_dict().values():
        sha.update(tensor.detach().cpu().contiguous().numpy().tobytes())
    return sha.hexdigest()[:12]
