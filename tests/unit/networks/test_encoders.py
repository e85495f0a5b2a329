"""Encoders in users' files: policies are trained and drive with them, and broken ones are told so."""

import json

import pytest
import torch
import trainings

from crowdbench.catalog import load_planner
from crowdbench.networks.encoders import POLICIES, make_policy
from crowdbench.train import ppo
from crowdbench.train.config import PPOConfig
from crowdbench.utils.errors import InputError

torch.set_num_threads(1)

MEAN = '''
import torch
from torch import nn
from crowdbench import Encoder


class Mean(Encoder):
    """Who is there on average."""

    encoded = 16

    def __init__(self):
        super().__init__()
        self.each, self.own = nn.LazyLinear(16), nn.LazyLinear(16)

    def forward(self, seen):
        number = seen.mask.sum(dim=1, keepdim=True).clamp(min=1)
        mean = (self.each(seen.pedestrians) * seen.mask[..., None]).sum(dim=1) / number
        return torch.tanh(self.own(seen.vehicle) + mean)


encoder = Mean
'''


@pytest.fixture
def mine(tmp_path):
    (tmp_path / "mine.py").write_text(MEAN)
    return str(tmp_path / "mine.py")


@pytest.mark.slow
@pytest.mark.parametrize("network", POLICIES)
def test_a_policy_is_trained_and_drives_with_an_encoder_of_ones_own(network, mine, tmp_path, monkeypatch):
    trainings.shorten(monkeypatch, ppo, 4, CASES=16, CHUNK=2, VALIDATIONS=1)
    sizes = {"worlds": 8, "steps": 16, "segments": 4}
    config = PPOConfig(network=network, overrides={"time_limit": 4.0}, seed=7, steps=100, ppo=sizes, encoder=mine)
    run = trainings.train(config, tmp_path / "a")
    weights = run.finish(trainings.ignore)
    card = json.loads(weights.with_suffix(".json").read_text())
    assert list(card["training"]["encoder_files"]) == ["mine.py"]
    assert f"--encoder {mine}" in card["command"]
    planner = load_planner("ppo", {"weights": str(weights), "encoder": mine})
    assert type(planner.policy.encoder).__name__ == "Mean"
    with pytest.raises(InputError, match=r"trained with the encoder mine\.py: the option encoder must be"):
        load_planner("ppo", {"weights": str(weights)})
    (tmp_path / "mine.py").write_text(MEAN + "# otherwise\n")
    with pytest.raises(InputError, match=r"trained with the encoder mine\.py"):
        load_planner("ppo", {"weights": str(weights), "encoder": mine})
    with pytest.raises(InputError, match="trained without an encoder file"):
        load_planner("ppo", {"encoder": mine})


@pytest.mark.parametrize(
    ("was", "becomes", "sentence"),
    [
        ("encoded = 16", "encoded = 8", r"gave \[3, 16\] for 3 rows, but must give \[3, 8\]"),
        ("torch.tanh(", "str(", "gave str for 3 rows"),
        (".clamp(min=1)", "", "numbers that are not finite, as where nobody is seen"),
        ("torch.tanh(", "torch.tan_h(", "the encoder mine raised AttributeError"),
        ("encoder = Mean", "", r"mine\.py defines no function encoder"),
    ],
)
def test_a_broken_encoder_gets_one_sentence(was, becomes, sentence, mine, tmp_path):
    (tmp_path / "mine.py").write_text(MEAN.replace(was, becomes))
    with pytest.raises(InputError, match=sentence):
        make_policy("ppo", mine)


def test_an_encoder_is_a_file():
    with pytest.raises(InputError, match=r"encoder is 'mean', but must be a file: \./mine\.py"):
        make_policy("ppo", "mean")
