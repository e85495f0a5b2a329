import dataclasses
import re

import numpy as np
import pytest
import torch
import trainings
from typer.testing import CliRunner

from crowdbench import InputError, load_predictor, load_scenario
from crowdbench.cli.app import build_script
from crowdbench.core.types import HISTORY
from crowdbench.networks.weights import read_card, weights_digest
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.tracks.recorded_tracks import FRAME_STEP
from crowdbench.train.config import SCENARIO, make_config
from studies.social_gan import samples, train
from studies.social_gan import training as social_gan
from studies.social_gan.config import METHODS, SocialGANConfig
from studies.social_gan.samples import from_scenario
from studies.social_gan.training import cross_entropy, non_saturating_loss, variety_loss


@pytest.fixture(autouse=True)
def small(monkeypatch):
    """A training of seconds."""
    monkeypatch.setattr(social_gan, "VALIDATIONS", 4)
    monkeypatch.setattr(samples, "TRAINING_CASES", Cases("train", 0, 10))
    monkeypatch.setattr(samples, "VALIDATION_CASES", Cases("val", 0, 5))


CONFIG = SocialGANConfig(network="sgan", scenario="circle_crossing_5", seed=3, epochs=4)
TRACKS = dataclasses.replace(CONFIG, scenario=SCENARIO)


@pytest.fixture
def recordings(tmp_path):
    """Two recordings of three pedestrians who wander, in a folder."""
    folder = tmp_path / "tracks"
    folder.mkdir()
    for name in ("biwi_eth", "biwi_hotel"):
        path = np.random.default_rng(len(name)).normal(0.4, 0.1, size=(120, 3, 2)).cumsum(axis=0)
        lines = [f"{t * FRAME_STEP}\t{p}\t{x}\t{y}" for t, row in enumerate(path) for p, (x, y) in enumerate(row)]
        (folder / f"{name}.txt").write_text("\n".join(lines))
    return folder


@pytest.mark.slow
def test_a_resumed_training_ends_in_the_same_weights(tmp_path):
    whole = trainings.train(CONFIG, tmp_path / "whole").training
    trainings.kill(CONFIG, tmp_path / "killed", 2)
    resumed = trainings.resume(tmp_path / "killed", METHODS).training
    for part in ("generator", "discriminator", "average", "validated"):
        assert weights_digest(getattr(resumed, part)) == weights_digest(getattr(whole, part))


@pytest.mark.slow
@pytest.mark.parametrize("pooling", [False, True])
def test_training_lessens_the_error_and_what_is_kept_is_the_best(pooling, monkeypatch):
    monkeypatch.setattr(social_gan, "VALIDATIONS", 20)
    config = dataclasses.replace(CONFIG, pooling=pooling, epochs=20)
    training = trainings.start(config)
    list(training.learn())
    assert training.curve[-1]["loss"] < 0.8 * training.curve[0]["loss"]
    assert training.best()[0]["ade"] == min(point["ade"] for point in training.curve)


@pytest.mark.slow
def test_a_finished_training_is_a_predictor_that_knows_where_it_was_trained(recordings, tmp_path):
    config = dataclasses.replace(TRACKS, data=str(recordings), held_out="hotel", dt=0.25)
    running = trainings.train(config, tmp_path / "run")
    path = running.finish(trainings.ignore)
    card = read_card(path)
    assert card["command"] == (
        "python studies/social_gan/train.py --data tracks --dt 0.25 --held-out hotel --seed 3 --epochs 4"
    )
    assert card["training"]["scenes"] == ["eth"]
    assert card["figures"]["validation"]["ade"] == running.training.best()[0]["ade"]
    assert "| scene held out | hotel |" in path.with_suffix(".md").read_text()
    made = load_predictor("sgan", {"weights": str(path), "modes": 2})
    assert made.for_held_out_scene("hotel") is made
    with pytest.raises(InputError, match="were trained on eth"):
        made.for_held_out_scene("eth")


@pytest.mark.slow
def test_the_held_out_scene_is_in_no_sample(recordings):
    both = trainings.start(dataclasses.replace(TRACKS, data=str(recordings)))
    one = trainings.start(dataclasses.replace(TRACKS, data=str(recordings), held_out="eth"))
    assert len(both.training) == 2 * len(one.training) > 0
    assert len(both.validation) == 2 * len(one.validation) > 0


def test_recordings_that_are_too_short_are_refused(tmp_path):
    (tmp_path / "short.txt").write_text("\n".join(f"{10 * t} {p} 0 0" for t in range(10) for p in range(2)))
    with pytest.raises(InputError, match="no window of 16 consecutive steps"):
        trainings.start(dataclasses.replace(TRACKS, data=str(tmp_path)))


def test_simulated_windows_are_stretches_of_walks_with_the_start_drawn_out():
    scenario = load_scenario("circle_crossing_mixed")
    found = from_scenario(scenario, Cases("train", 0, 6))
    start = scenario.draw("train", np.arange(6))
    # The first windows of each case: six steps before the start, which repeat the first one.
    first = found.position[:6, :, 0]
    moves = np.diff(first, axis=1)
    np.testing.assert_allclose(
        moves[:, : HISTORY - 2], np.repeat(moves[:, HISTORY - 2 : HISTORY - 1], HISTORY - 2, 1), atol=1e-5
    )
    assert (found.present[:6].sum(axis=1) == start.present[:, 1:].sum(axis=1)).all()
    count = found.present.sum(axis=1)
    assert np.array_equal(found.present, np.arange(found.present.shape[1]) < count[:, None])


def test_the_variety_loss_is_of_the_future_best_for_the_whole_scene():
    rng = torch.Generator().manual_seed(0)
    predicted, future = torch.randn((4, 5, 8, 2), generator=rng), torch.randn((5, 8, 2), generator=rng)
    scene = torch.tensor([0, 0, 0, 1, 1])
    total = 0.0
    for rows in ([0, 1, 2], [3, 4]):
        distance = [
            sum(
                torch.dist(predicted[m, r, : t + 1].sum(0), future[r, : t + 1].sum(0)).item() / 8
                for r in rows
                for t in range(8)
            )
            for m in range(4)
        ]
        total += min(distance)
    assert variety_loss(predicted, future, scene, 2).item() == pytest.approx(total / 5, rel=1e-5)


def test_adversarial_losses_are_cross_entropies():
    rng = torch.Generator().manual_seed(0)
    real, fake = torch.randn(50, generator=rng), torch.randn(50, generator=rng)
    ones, zeros = torch.ones(50), torch.zeros(50)
    entropy = torch.nn.functional.binary_cross_entropy_with_logits
    torch.testing.assert_close(non_saturating_loss(fake), entropy(fake, ones))
    torch.testing.assert_close(cross_entropy(real, fake), entropy(real, ones) + entropy(fake, zeros))


def run(*arguments):
    """Run the script, in this process because importing torch takes long."""
    return CliRunner().invoke(build_script(train.train), arguments, catch_exceptions=False)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--data", "eth_ucy", "--scenario", "circle_crossing_5"], "leave out --scenario and --set, or else --data"),
        (["--dt", "0.25"], "--held-out and --dt are for recorded tracks: give them with --data"),
        (["--data", "nowhere"], "there is no folder nowhere with recorded tracks"),
    ],
)
def test_a_training_that_cannot_start_says_why_in_one_sentence(arguments, message):
    with pytest.raises(InputError, match=re.escape(message)):
        run(*arguments)


@pytest.mark.slow
def test_the_script_trains_and_resumes(recordings, tmp_path):
    options = ["--data", str(recordings), "--epochs", "4"]
    done = run(*options, "--out", str(tmp_path / "run"))
    assert "use them with crowdbench check sgan --kind predictors --option weights=" in done.stdout
    config = make_config("sgan", {"data": str(recordings), "epochs": 4}, METHODS)
    trainings.kill(config, tmp_path / "killed", 1)
    with pytest.raises(InputError, match=r"go on with python studies/social_gan/train.py --resume"):
        run(*options, "--out", str(tmp_path / "killed"))
    run("--resume", str(tmp_path / "killed"))
    whole, resumed = ((tmp_path / name / "weights.safetensors").read_bytes() for name in ("run", "killed"))
    assert whole == resumed
