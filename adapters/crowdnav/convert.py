"""Convert a value network trained by CrowdNav or a fork of it, `rl_model.pth`, into weights of crowdbench.

    python adapters/crowdnav/convert.py CrowdNav/crowd_nav/data/output/rl_model.pth mine.safetensors
    crowdbench run --planner sarl --option weights=mine.safetensors

CADRL, LSTM-RL without an interaction module, and SARL with its global state, all without occupancy maps.
"""

from __future__ import annotations

import hashlib
import io
from pathlib import Path

import torch
from torch import Tensor

from crowdbench import InputError
from crowdbench.cli import help_from_docstring, main
from crowdbench.networks import NETWORKS, WEIGHTS_SUFFIX, ValueNetwork, save_network
from crowdbench.utils import command

LAYERS = {
    "sarl": {"mlp1": "embedding", "mlp2": "features", "attention": "attention", "mlp3": "value"},
    "lstm_rl": {"lstm": "lstm", "mlp": "value"},
    "cadrl": {"value_network": "pair"},
}
"""Groups of layers of each network: their names in CrowdNav, and their names in crowdbench."""

ATTENTION = {
    f"{theirs}.{part}": f"{ours}.{part}"
    for theirs, ours in (("0", "attention_own"), ("2", "attention.0"), ("4", "attention.2"))
    for part in ("weight", "bias")
}
"""SARL's attention layers. In the first, columns 0 to 99 multiply an embedding, columns 100 to 199 the mean of all."""


def read_network(content: bytes, name: str) -> ValueNetwork:
    """Return the value network in a file of CrowdNav.

    Args:
        content: The content of `rl_model.pth`. Only tensors are unpickled.
        name: The name of the file, for errors.

    Raises:
        InputError: The file contains no weights, or its layers belong to none of the three networks.
    """
    try:
        found = torch.load(io.BytesIO(content), "cpu", weights_only=True)
        tensors: dict[str, Tensor] = {str(key): torch.as_tensor(tensor) for key, tensor in found.items()}
    except Exception:  # torch raises many kinds of exceptions, and advises against `weights_only`
        right = "what torch.save(network.state_dict(), file) writes"
        raise InputError(f"{name} cannot be read, or holds something other than tensors: give {right}") from None
    groups = {key.partition(".")[0] for key in tensors}
    kind = next((kind for kind, layers in LAYERS.items() if groups == set(layers)), None)
    if kind is None:
        known = "; ".join(f"{', '.join(layers)} ({kind})" for kind, layers in LAYERS.items())
        raise InputError(f"{name} has the layers {', '.join(sorted(groups))}, but must have one of these sets: {known}")
    network, state = NETWORKS[kind](), {}
    try:
        for key, tensor in tensors.items():
            group, _, layer = key.partition(".")
            renamed = ATTENTION[layer] if group == "attention" else f"{LAYERS[kind][group]}.{layer}"
            state[renamed] = tensor
        if kind == "sarl":
            own, mean = torch.split(state["attention_own.weight"], 100, dim=1)
            state |= {"attention_own.weight": own, "attention_mean.weight": mean}
        network.load_state_dict(state)
    except (KeyError, ValueError, RuntimeError) as error:
        reason = " ".join(str(error).split())[:300]
        raise InputError(f"the layers of {name} do not fit {kind} as CrowdNav configures it: {reason}") from None
    return network


@help_from_docstring
def convert(model: Path, out: Path) -> None:
    """Write the weights of CrowdNav's value network as a safetensors file, and their card beside it.

    Args:
        model: The file rl_model.pth of CrowdNav or of a fork.
        out: The file of weights to write, which ends in .safetensors.
    """
    if out.suffix != WEIGHTS_SUFFIX:
        raise InputError(f"{out} must end in {WEIGHTS_SUFFIX}")
    if out.is_dir() or not out.parent.is_dir():
        raise InputError(f"{out} cannot be written: name a file in a folder that exists")
    try:
        content = model.read_bytes()
    except OSError as error:
        raise InputError(f"{model} cannot be read: {error.strerror}") from None
    network = read_network(content, model.name)
    source = {"file": model.name, "sha256": hashlib.sha256(content).hexdigest()}
    save_network(network, network.name, out, {"converted_from": source})
    run = command("run", "--planner", network.name, "--option", f"weights={out}")
    print(f"{out} has the weights of {network.name}: {run}")


if __name__ == "__main__":
    main(convert)
