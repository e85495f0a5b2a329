"""Value networks in CrowdNav's layout become weights of crowdbench with the same values."""

import itertools
import json
import os
from pathlib import Path

import numpy as np
import pytest
import torch
from helpers import drive
from joint_states import scenes
from torch import nn
from typer.testing import CliRunner

from crowdbench.catalog import load_planner
from crowdbench.cli.app import app, build_script
from crowdbench.networks.joint_state import DISTANCE, VEHICLE, joint_states
from crowdbench.networks.value import load_network
from crowdbench.plugins.kind import load_module

adapter = load_module(Path(__file__).parents[2] / "adapters" / "crowdnav" / "convert.py")
KINDS = list(adapter.LAYERS)


def layers(*sizes, last=False):
    """CrowdNav's `mlp`."""
    found = []
    for inputs, outputs in itertools.pairwise(sizes):
        found += [nn.Linear(inputs, outputs), nn.ReLU()]
    return nn.Sequential(*(found if last else found[:-1]))


def theirs(kind, seed=0):
    """The layers of a network of CrowdNav, with its names and sizes."""
    torch.manual_seed(seed)
    parts = {
        "sarl": lambda: {
            "mlp1": layers(13, 150, 100, last=True),
            "mlp2": layers(100, 100, 50),
            "attention": layers(200, 100, 100, 1),
            "mlp3": layers(56, 150, 100, 100, 1),
        },
        "lstm_rl": lambda: {"mlp": layers(56, 150, 100, 100, 1), "lstm": nn.LSTM(13, 50, batch_first=True)},
        "cadrl": lambda: {"value_network": layers(13, 150, 100, 100, 1)},
    }
    return nn.ModuleDict(parts[kind]())


def value_of(net, kind, state):
    """What CrowdNav's network makes of the joint states `[world, person, 13]`, the farthest person first."""
    own = state[:, 0, :VEHICLE]
    if kind == "cadrl":
        return net["value_network"](state)[..., 0].min(dim=1).values
    if kind == "lstm_rl":
        return net["mlp"](torch.cat([own, net["lstm"](state)[1][0][0]], dim=1))[:, 0]
    embedded = net["mlp1"](state)
    mean = embedded.mean(dim=1, keepdim=True).expand_as(embedded)
    scores = net["attention"](torch.cat([embedded, mean], dim=2))
    weighted = (scores.exp() / scores.exp().sum(dim=1, keepdim=True) * net["mlp2"](embedded)).sum(dim=1)
    return net["mlp3"](torch.cat([own, weighted], dim=1))[:, 0]


def convert(*arguments):
    return CliRunner().invoke(build_script(adapter.convert), list(map(str, arguments)))


def converted(kind, folder):
    torch.save(theirs(kind).state_dict(), folder / "rl_model.pth")
    done = convert(folder / "rl_model.pth", folder / "mine.safetensors")
    assert done.exit_code == 0, done.output
    return folder / "mine.safetensors"


@pytest.mark.parametrize("kind", KINDS)
def test_a_converted_network_has_the_values_of_crowdnavs(kind, tmp_path):
    arguments = scenes(np.random.default_rng(0), (40,), 5)
    arguments["present"][:] = True
    state = torch.from_numpy(joint_states(**arguments)).float()
    state = state.gather(1, state[..., DISTANCE].argsort(dim=1, descending=True)[..., None].expand_as(state))
    found = load_network(kind, str(converted(kind, tmp_path)))
    with torch.no_grad():
        expected = value_of(theirs(kind), kind, state)
        assert expected.std() > 1e-4
        np.testing.assert_allclose(found(state, torch.ones(40, 5, dtype=torch.bool)), expected, atol=1e-6)


@pytest.mark.parametrize("kind", [KINDS[0], *(pytest.param(kind, marks=pytest.mark.slow) for kind in KINDS[1:])])
def test_a_converted_network_drives(kind, tmp_path):
    file = converted(kind, tmp_path)
    options = ["--planner", kind, "--option", f"weights={file}", "--cases", "val:2", "--set", "time_limit=2"]
    done = CliRunner().invoke(app, ["run", *options, "--out", str(tmp_path / "run"), "--record", "none"])
    assert done.exit_code == 0, done.output
    planner = load_planner(kind, {"weights": str(file)})
    shipped = load_planner(kind)
    assert not np.array_equal(drive(planner, "2").command[:, 0], drive(shipped, "2").command[:, 0])
    card = json.loads(file.with_suffix(".json").read_text())
    assert card["network"] == kind
    assert card["converted_from"]["file"] == "rl_model.pth"


@pytest.mark.parametrize("kind", KINDS)
def test_a_published_network_comes_back_as_it_is_here(kind, shared, tmp_path):
    file = shared / "networks" / f"hybrid_scenario__{kind}_on_sfm.safetensors"
    state = load_network(kind, str(file)).state_dict()
    if kind == "sarl":
        state["attention_own.weight"] = torch.cat(
            [state["attention_own.weight"], state.pop("attention_mean.weight")], 1
        )
    back = {ours: name for name, ours in adapter.ATTENTION.items()}
    groups = {ours: name for name, ours in adapter.LAYERS[kind].items()}

    def name(key):
        group, _, layer = key.partition(".")
        return f"attention.{back[key]}" if key in back and kind == "sarl" else f"{groups[group]}.{layer}"

    torch.save({name(key): tensor for key, tensor in state.items()}, tmp_path / "rl_model.pth")
    assert convert(tmp_path / "rl_model.pth", tmp_path / "again.safetensors").exit_code == 0
    assert (tmp_path / "again.safetensors").read_bytes() == file.read_bytes()


def with_map():
    """SARL with an occupancy map."""
    return theirs("sarl").state_dict() | {"mlp1.0.weight": torch.zeros(150, 61)}


def without_global_state():
    return theirs("sarl").state_dict() | {"attention.0.weight": torch.zeros(100, 100)}


REFUSED = {
    "an occupancy map": (
        with_map,
        "do not fit sarl as CrowdNav configures it: .* size mismatch for embedding.0.weight",
    ),
    "no global state": (without_global_state, "do not fit sarl as CrowdNav configures it"),
    "other layers": (lambda: {"policy.0.weight": torch.zeros(2, 2)}, "has the layers policy, but must have one of"),
    "an interaction module": (
        lambda: theirs("lstm_rl").state_dict() | {"mlp1.0.weight": torch.zeros(2, 2)},
        r"has the layers lstm, mlp, mlp1, but must have one of these sets: .* lstm, mlp \(lstm_rl\)",
    ),
    "code": (lambda: os.system, "holds something other than tensors: give what torch.save"),
    "numbered layers": (lambda: {0: torch.zeros(1)}, "has the layers 0, but must have one of"),
    "a list": (lambda: [torch.zeros(1)], "holds something other than tensors"),
    "no tensors": (lambda: {"model": {"weight": torch.zeros(1)}}, "holds something other than tensors"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_other_files_get_one_sentence(name, tmp_path):
    make, sentence = REFUSED[name]
    torch.save(make(), tmp_path / "rl_model.pth")
    done = convert(tmp_path / "rl_model.pth", tmp_path / "mine.safetensors")
    assert done.exit_code == 1
    with pytest.raises(type(done.exception), match=sentence) as error:
        raise done.exception
    assert "\n" not in str(error.value)
    assert not (tmp_path / "mine.safetensors").exists()


def test_a_missing_file_and_another_suffix_get_one_sentence(tmp_path):
    assert "absent.pth cannot be read" in str(convert(tmp_path / "absent.pth", tmp_path / "a.safetensors").exception)
    (tmp_path / "folder").mkdir()
    assert "cannot be read: Is a dir" in str(convert(tmp_path / "folder", tmp_path / "a.safetensors").exception)
    (tmp_path / "empty.pth").write_text("")
    assert "empty.pth cannot be read" in str(convert(tmp_path / "empty.pth", tmp_path / "a.safetensors").exception)
    torch.save(theirs("sarl").state_dict(), tmp_path / "rl_model.pth")
    (tmp_path / "folder.safetensors").mkdir()
    for out in ("folder.safetensors", "no/a.safetensors"):
        assert "cannot be written: name a file" in str(convert(tmp_path / "rl_model.pth", tmp_path / out).exception)
    assert not list(tmp_path.glob("*.json"))
    assert "must end in .safetensors" in str(convert(tmp_path / "absent.pth", tmp_path / "a.pth").exception)
