import json
import os

import pytest
import torch
from safetensors.torch import save_file

from crowdbench import InputError, load_network, load_predictor
from crowdbench.networks.card import headline, markdown
from crowdbench.networks.social_gan import Generator
from crowdbench.networks.value import NETWORKS
from crowdbench.networks.weights import built_in, read_card, save_network, weights_digest

FIGURES = {
    f"{name}_rate": {"mean": 0.5, "low": 0.4, "high": 0.6, "n": 10} for name in ("success", "collision", "timeout")
} | {"navigation_time": {"mean": 10.0, "low": 9.0, "high": 11.0, "n": 5}}
CARD = {
    "command": "crowdbench train",
    "training": {
        "scenario": {"name": "circle", "digest": "0", "pedestrians": {"number": [1, 10]}},
        "predictor": "oracle",
        "limits": {},
        "validation": {"scenarios": ["circle"], "cases": "val:0:200"},
        "seed": 0,
        "episodes": 100,
        "kept_after_episodes": 100,
        "minutes": 1.0,
    },
    "figures": {"test": {"cases": "test:0:10", "metrics": FIGURES}},
    "commit": None,
    "machine": "a machine",
    "versions": {"torch": "2"},
    "data": "none",
    "licence": "MIT",
}


@pytest.fixture
def saved(tmp_path):
    path = tmp_path / "mine.safetensors"
    save_network(NETWORKS["sarl"](), "sarl", path, CARD)
    return path


@pytest.mark.parametrize("name", NETWORKS)
def test_weights_come_back_as_they_were(name, tmp_path):
    network = NETWORKS[name]()
    save_network(network, name, tmp_path / "mine.safetensors", CARD)
    assert weights_digest(load_network(name, str(tmp_path / "mine.safetensors"))) == weights_digest(network)
    assert weights_digest(NETWORKS[name]()) != weights_digest(network)


def test_the_card_is_rendered_for_people(saved):
    text = markdown(read_card(saved))
    assert "circle, 1 to 10 pedestrians" in text
    assert "| test test:0:10 | 50.0 % (40.0 to 60.0) |" in text


def refused(path, network="sarl", device="cpu"):
    with pytest.raises(InputError) as error:
        load_network(network, str(path), device)
    return str(error.value)


def test_altered_weights_are_refused(saved):
    content = bytearray(saved.read_bytes())
    content[-1] ^= 1
    saved.write_bytes(content)
    assert refused(saved).endswith("are not those that their card describes: their sha256 differs")


def test_missing_weights_are_refused(tmp_path):
    assert "cannot be read: No such file" in refused(tmp_path / "none.safetensors")


def test_weights_without_a_card_are_refused(saved):
    saved.with_suffix(".json").unlink()
    assert "need their card mine.json beside them" in refused(saved)


def test_a_headline_counts_every_other_scenario_once_and_names_the_one_that_was_measured():
    cards = {path.stem: headline(read_card(path)) for path in built_in()}
    # Both list scenarios several times, the first one among them.
    assert "in fleet_4, 12 pedestrians, and 1 more scenario: " in cards["ippo"]
    assert "pedestrians, and 9 more scenarios: " in cards["ppo_lidar"]
    assert cards["ippo"].endswith("success on validation cases of fleet_4")


@pytest.mark.parametrize(
    "text",
    ["{", "[" * 100_000, '{"network": "sarl"}'],
    ids=["cut", "deep", "no sha256"],
)
def test_a_card_that_is_none_is_refused(saved, text):
    saved.with_suffix(".json").write_text(text)
    assert str(saved.with_suffix(".json")) in refused(saved)


def test_weights_of_another_network_are_refused(saved):
    assert refused(saved, "cadrl").endswith("are of the network sarl, but must be of cadrl")


@pytest.mark.parametrize("suffix", [".safetensors", ".json"])
def test_a_pipe_is_not_waited_for(suffix, saved):
    path = saved.with_suffix(suffix)
    path.unlink()
    os.mkfifo(path)
    assert refused(saved).endswith("it is not a regular file")


def test_weights_that_are_not_finite_are_refused(tmp_path):
    network = NETWORKS["sarl"]()
    name, weights = next(iter(network.named_parameters()))
    with torch.no_grad():
        weights.view(-1)[0] = torch.nan
    save_network(network, "sarl", tmp_path / "mine.safetensors", CARD)
    assert f"have numbers in {name} that are not finite" in refused(tmp_path / "mine.safetensors")


def test_a_device_without_values_is_refused(saved):
    assert "cannot be loaded on meta" in refused(saved, device="meta")
    assert refused(saved, device="gpu") == "torch knows no device 'gpu': give cpu or cuda"


def test_foreign_tensors_are_refused_in_one_line(saved):
    card = json.loads(saved.with_suffix(".json").read_text())
    save_file({"foreign": torch.zeros(3)}, saved)
    import hashlib

    card["sha256"] = hashlib.sha256(saved.read_bytes()).hexdigest()
    saved.with_suffix(".json").write_text(json.dumps(card))
    message = refused(saved)
    assert "cannot be loaded" in message
    assert "\n" not in message


def test_a_pickle_is_never_opened(saved):
    class Trap:
        def __reduce__(self):
            return pytest.fail, ("it was unpickled",)

    import hashlib
    import pickle

    saved.write_bytes(pickle.dumps(Trap()))
    card = json.loads(saved.with_suffix(".json").read_text())
    card["sha256"] = hashlib.sha256(saved.read_bytes()).hexdigest()
    saved.with_suffix(".json").write_text(json.dumps(card))
    assert "cannot be loaded" in refused(saved)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"weights": "sarl"}, "are of the network sarl, but must be of sgan"),
        ({"weights": "mine"}, "no file of weights is called 'mine'; there are"),
        ({"modes": 0}, "modes is 0, but must be a whole number, 1 or more"),
    ],
)
def test_a_social_gan_that_cannot_be_is_refused(options, message):
    with pytest.raises(InputError, match=message):
        load_predictor("sgan", options)


def test_social_gans_that_come_along_say_what_they_were_trained_on():
    real, simulated = (load_predictor(name) for name in ("sgan", "sgan_simulated"))
    assert real.about["dt"] == simulated.about["dt"] == 0.25
    assert real.about["scenes"] == ["eth", "hotel", "univ", "zara1", "zara2"]
    assert simulated.about["scenes"] == []
    assert real.facts != simulated.facts


def test_a_card_that_does_not_say_where_a_social_gan_was_trained_is_refused(tmp_path):
    save_network(Generator(), "sgan", tmp_path / "mine.safetensors", CARD)
    with pytest.raises(InputError, match="must say of the training: "):
        load_predictor("sgan", {"weights": str(tmp_path / "mine.safetensors")})


@pytest.mark.parametrize(
    ("training", "message"),
    [
        ({"dt": 0}, "must say of the training: dt, seconds above 0 and up to 60"),
        ({"dt": float("nan")}, "must say of the training: dt, seconds"),
        ({"scenes": "eth"}, "must say of the training: scenes, a list of names"),
        ({"pooling": "yes"}, "must say of the training: pooling, true or false"),
    ],
)
def test_a_card_of_a_social_gan_with_a_wrong_value_is_refused(training, message, tmp_path):
    card = CARD | {"training": {"dt": 0.4, "scenes": [], "pooling": False} | training}
    save_network(Generator(), "sgan", tmp_path / "mine.safetensors", card)
    with pytest.raises(InputError, match=message):
        load_predictor("sgan", {"weights": str(tmp_path / "mine.safetensors")})
