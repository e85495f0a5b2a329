import dataclasses

import numpy as np
import pytest
import torch
import trainings

from crowdbench import InputError, load_network, load_scenario
from crowdbench.core.dynamics.dynamics import speeds_and_headings
from crowdbench.networks.card import headline
from crowdbench.networks.value import NETWORKS
from crowdbench.networks.weights import read_card, weights_digest
from crowdbench.planners.kce import Limits
from crowdbench.planners.lookahead import ValuePlanner
from crowdbench.predict import ConstantVelocity
from crowdbench.sim.sensor import observe
from crowdbench.train import driving, value
from crowdbench.train.checkpoint import CHECKPOINT
from crowdbench.train.config import ValueConfig
from crowdbench.train.runner import Finished, Runner
from crowdbench.train.value import EpsilonGreedy, ValueTraining


@pytest.fixture(autouse=True)
def small(monkeypatch):
    """A training of seconds."""
    sizes = {"DEMONSTRATIONS": 30, "ROUND": 10, "VALIDATIONS": 4, "IMITATION_EPOCHS": 1, "REPLAY_RATIO": 4}
    trainings.shorten(monkeypatch, value, 5, **sizes)


# Episodes are short, because a network that has hardly been trained drives to the end of the time.
CONFIG = ValueConfig(network="cadrl", overrides={"pedestrians.number": [1, 3], "time_limit": 10.0}, seed=7, episodes=40)


@pytest.mark.slow
@pytest.mark.parametrize(
    "options",
    [
        {"network": "lstm_rl"},
        {"network": "sarl", "max_turn": 1.0, "max_velocity_change": 0.8, "validation": "circle_crossing_5"},
    ],
    ids=lambda options: options["network"],
)
def test_a_resumed_training_ends_in_the_same_weights(options, tmp_path):
    config = dataclasses.replace(CONFIG, episodes=20, **options)
    whole = trainings.train(config, tmp_path / "whole").training
    trainings.kill(config, tmp_path / "killed", 2)
    resumed = trainings.resume(tmp_path / "killed").training
    assert resumed.limits == whole.limits
    for part in ("network", "current"):
        assert weights_digest(getattr(resumed, part)) == weights_digest(getattr(whole, part))
    assert weights_digest(resumed.best()[1]) == weights_digest(whole.best()[1])
    assert trainings.untimed(resumed) == trainings.untimed(whole)


@pytest.mark.slow
def test_another_seed_is_another_network(tmp_path):
    configs = [dataclasses.replace(CONFIG, seed=seed, episodes=10) for seed in (0, 1)]
    digests = [
        weights_digest(trainings.train(config, tmp_path / str(config.seed)).training.network) for config in configs
    ]
    assert digests[0] != digests[1]


def test_a_card_looks_at_test_cases_only_where_that_is_asked_for(tmp_path):
    cards = {}
    for card in ("val", "test"):
        training = trainings.start(dataclasses.replace(CONFIG, card=card))
        training.validate()
        cards[card] = {"network": "cadrl", **training.card(trainings.ignore)}
        measured = {split: figure["metrics"]["success_rate"]["n"] for split, figure in cards[card]["figures"].items()}
        assert measured == {split: len(cases) for split, cases in training.card_cases.items()}
    assert list(cards["val"]["figures"]) == ["validation"]
    assert list(cards["test"]["figures"]) == ["validation", "test"]
    assert headline(cards["val"]).endswith("success on validation cases")
    assert headline(cards["test"]).endswith("success on test cases")


@pytest.mark.slow
def test_a_finished_training_leaves_weights_card_and_curves(tmp_path):
    running = trainings.train(dataclasses.replace(CONFIG, card="test"), tmp_path / "run")
    path = running.finish(trainings.ignore)
    assert weights_digest(load_network("cadrl", str(path))) == weights_digest(running.training.best()[1])
    card = read_card(path)
    assert card["command"] == (
        "crowdbench train cadrl --scenario circle_crossing_mixed --set 'pedestrians.number=[1, 3]' "
        "--set time_limit=10.0 --card test --predictor oracle --seed 7 --episodes 40"
    )
    assert card["figures"]["test"]["cases"] == "test:0:5"
    assert card["figures"]["test"]["metrics"]["success_rate"]["n"] == 5
    lines = (tmp_path / "run" / "curve.csv").read_text().splitlines()
    assert len(lines) == 1 + len(running.training.curve)
    assert {"loss", "success", "navigation_time_or_limit"} <= {*lines[0].split(",")}
    assert {file.name.partition(".out")[0] for file in (tmp_path / "run").iterdir()} == {
        "events",
        "weights.safetensors",
        "weights.json",
        "weights.md",
        "curve.csv",
    }
    text = (tmp_path / "run" / "weights.md").read_text()
    assert (
        f"| checkpoint | chosen at episode {running.training.best()[0]['episodes']} of 40, on val:0:5 of circle_"
        in text
    )
    assert "| test test:0:5 |" in text
    with pytest.raises(Finished, match="is finished: its weights are"):
        Runner.resume(tmp_path / "run", "cpu")


def test_a_training_that_stops_before_its_first_validation_begins_again_where_it_is_resumed(tmp_path, monkeypatch):
    def fail(*arguments):
        raise trainings.Killed

    monkeypatch.setattr(ValueTraining, "imitate", fail)
    with pytest.raises(trainings.Killed):
        list(Runner.start(CONFIG, tmp_path / "run", "cpu").train())
    monkeypatch.undo()
    assert Runner.resume(tmp_path / "run", "cpu").training.curve == []


def test_a_network_learns_in_training_mode_after_it_has_driven():
    # On a GPU an LSTM has no gradients otherwise.
    training, modes = trainings.start(dataclasses.replace(CONFIG, network="lstm_rl")), []

    def note(network, states):
        if torch.is_grad_enabled():
            modes.append(network.training)

    training.network.register_forward_pre_hook(note)
    training.improve()
    assert modes
    assert all(modes)


@pytest.mark.slow
def test_minutes_end_a_training(tmp_path):
    config = dataclasses.replace(CONFIG, minutes=0.02, episodes=10**9)
    running = trainings.train(config, tmp_path / "run")
    assert running.training.progress == 1.0
    assert running.training.seconds >= 1.2


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"predictor": "crystal_ball"}, "no predictor is called 'crystal_ball'"),
        ({"scenario": "nowhere"}, "no scenario is called 'nowhere'"),
        ({"validation": "circle_crossing_5,nowhere"}, "no scenario is called 'nowhere'"),
        ({"validation": "circle_crossing_5,fleet_4"}, "fleet_4 has 4 vehicles, but a training of cadrl drives one"),
        ({"max_turn": 4.0}, "max_turn is 4.0, but must be pi at most"),
        ({"max_velocity_change": 0.0}, "--max-velocity-change is 0.0, but must be a number above 0"),
    ],
)
def test_what_does_not_exist_is_refused_and_nothing_is_left(change, message, tmp_path):
    with pytest.raises(InputError, match=message):
        Runner.start(dataclasses.replace(CONFIG, **change), tmp_path / "run", "cpu")
    assert not (tmp_path / "run").exists()


def test_a_file_that_is_no_checkpoint_cannot_be_resumed(tmp_path):
    (tmp_path / CHECKPOINT).write_bytes(b"something else, and not short")
    with pytest.raises(InputError, match="cannot be continued: it is damaged"):
        Runner.resume(tmp_path, "cpu")


def test_a_checkpoint_of_another_network_is_refused(tmp_path, monkeypatch):
    trainings.kill(CONFIG, tmp_path / "run", 1)
    monkeypatch.setitem(NETWORKS, "cadrl", NETWORKS["sarl"])
    with pytest.raises(InputError, match=r"cannot be continued: it is damaged, or of another version"):
        Runner.resume(tmp_path / "run", "cpu")


def observed(worlds):
    """The start of so many validation cases."""
    return observe(load_scenario("circle_crossing_5").draw("val", np.arange(worlds)))


@pytest.mark.slow
def test_exploration_takes_its_share_of_commands_and_repeats_in_any_batch():
    planner = ValuePlanner(ConstantVelocity(), NETWORKS["cadrl"]())
    obs = observed(400)
    greedy = planner.plan(obs)
    assert np.array_equal(EpsilonGreedy(planner, 0.0, 0).plan(obs), greedy)
    exploring = EpsilonGreedy(planner, 0.3, 0)
    commands = exploring.plan(obs)
    random = (commands != greedy).any(axis=1)
    assert 0.2 < random.mean() < 0.4
    assert np.array_equal(
        exploring.plan(obs.take(slice(100, 200)))[random[100:200]], commands[100:200][random[100:200]]
    )
    assert not np.array_equal(EpsilonGreedy(planner, 0.3, 1).plan(obs)[random], commands[random])
    # All of the 81 commands come up: 400 random ones of 81 leave one in a hundred out.
    everything = EpsilonGreedy(planner, 1.0, 0).plan(obs).round(6)
    assert 75 <= len(np.unique(everything, axis=0)) <= 81


def test_what_exploring_skips_is_what_planning_gives():
    planner = ValuePlanner(ConstantVelocity(), NETWORKS["cadrl"]())
    obs = observed(50)
    commands = EpsilonGreedy(planner, 0.5, 3).plan(obs)
    same = np.isclose(commands, planner.plan(obs), atol=1e-6).all(axis=1)
    legal = speeds_and_headings(obs.vehicle.preferred_speed)
    assert same.sum() >= 15
    assert (np.abs(commands[:, None] - legal).max(axis=2).min(axis=1) < 1e-12).all()


@pytest.mark.slow
def test_random_commands_are_within_the_limits_and_evenly_spread_over_them():
    limits = Limits(max_velocity_change=0.5)
    planner = ValuePlanner(ConstantVelocity(), NETWORKS["cadrl"](), limits=limits)
    obs = observed(2000)
    velocity = np.tile([[0.6, 0.0]], (2000, 1))
    obs = dataclasses.replace(obs, vehicle=dataclasses.replace(obs.vehicle, velocity=velocity))
    commands = EpsilonGreedy(planner, 1.0, 0).plan(obs)
    assert limits.allow(velocity, commands[:, None], obs.dt).all()
    offered = planner.commands(obs.vehicle, obs.dt)[:1]
    allowed = offered[0][limits.allow(velocity[:1], offered, obs.dt)[0]]
    assert np.array_equal(offered[0, -1], limits.brake(velocity[:1], obs.dt)[0])
    share = [np.isclose(commands, each, atol=1e-12).all(axis=1).mean() for each in allowed]
    assert len(allowed) > 10
    assert sum(share) == pytest.approx(1.0)
    assert max(share) < 2 / len(allowed)
    assert min(share) > 0.5 / len(allowed)


def validated(success, seconds):
    """A point of a training curve."""
    return {"success": success, "navigation_time_or_limit": seconds}


@pytest.mark.parametrize(
    ("curve", "expected"),
    [
        ([(0.90, 9.0), (0.99, 12.0), (0.97, 11.0)], 1),
        ([(0.99, 12.0), (0.985, 11.5), (0.99, 11.8)], 1),
        # One case of 200 less is noise, three are not.
        ([(1.0, 12.0), (0.995, 11.5)], 1),
        ([(1.0, 12.0), (0.985, 9.5)], 0),
        ([(0.9, 10.0), (0.9, 10.0)], 1),
        # The second is within noise of the first, but not of the third.
        ([(0.975, 11.0), (0.965, 10.0), (1.0, 12.0)], 2),
    ],
)
def test_a_checkpoint_is_chosen_by_success_within_noise_and_then_by_time(curve, expected):
    points = [validated(*point) for point in curve]
    assert driving.choose_point(points, 200) is points[expected]


@pytest.mark.slow
def test_a_training_within_limits_drives_and_validates_within_them_in_the_scenarios_that_are_named(tmp_path):
    config = dataclasses.replace(
        CONFIG, max_velocity_change=0.6, max_turn=2.0, validation="circle_crossing_5,square_crossing_5", episodes=10
    )
    running = Runner.start(config, tmp_path / "run", "cpu")
    driven = running.training._drive()
    change = np.linalg.norm(np.diff(driven.velocity[:, :, 0], axis=1), axis=-1)
    assert np.nanmax(change) <= 0.6 + 1e-9
    assert np.nanmax(change) > 0.5
    list(running.train())
    card = read_card(running.finish(trainings.ignore))
    assert card["training"]["limits"] == {"max_turn": 2.0, "max_velocity_change": 0.6}
    assert card["training"]["validation"] == {
        "scenarios": ["circle_crossing_5", "square_crossing_5"], "cases": "val:0:5",
    }  # fmt: skip
    assert (
        "--validation circle_crossing_5,square_crossing_5 --predictor oracle --max-turn 2.0 --max-velocity-change 0.6"
        in card["command"]
    )
    assert config.usage == (
        "run --planner cadrl --option 'limits={max_acceleration=inf, max_turn=2.0, max_velocity_change=0.6}'"
    )
    text = (tmp_path / "run" / "weights.md").read_text()
    assert "| limits | max_turn 2, max_velocity_change 0.6 |" in text
    assert "on val:0:5 of circle_crossing_5 and of square_crossing_5 |" in text


def test_no_case_that_chooses_a_checkpoint_is_on_the_card():
    chosen_by = set(driving.VALIDATION_CASES.indices)
    on_cards = [cases for cases in driving.CARD_CASES.values() if cases.split == "val"]
    assert on_cards
    assert all(chosen_by.isdisjoint(cases.indices) for cases in on_cards)
