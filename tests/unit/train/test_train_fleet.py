"""Training in worlds with several vehicles."""

import dataclasses

import numpy as np
import pytest
import torch
import trainings

from crowdbench import InputError, load_scenario
from crowdbench.core.types import Outcome
from crowdbench.envs.rewards import load_reward
from crowdbench.envs.training_worlds import TrainingWorlds
from crowdbench.networks.weights import weights_digest
from crowdbench.train import ppo
from crowdbench.train.config import PPOConfig
from crowdbench.train.runner import Runner
from crowdbench.views.global_state import global_state
from crowdbench.views.view import View

SIZES = {"worlds": 8, "steps": 16, "segments": 4, "epochs": 2}
CONFIG = PPOConfig(
    network="ppo_attention",
    scenario="fleet_4",
    overrides={"pedestrians.number": 2},
    seed=7,
    steps=400,
    ppo={**SIZES, "critic": "state"},
)


@pytest.fixture(autouse=True)
def small(monkeypatch):
    """A training of seconds."""
    trainings.shorten(monkeypatch, ppo, 4, CASES=4, CHUNK=2, VALIDATIONS=2)


def test_a_world_starts_again_when_all_its_vehicles_have_ended():
    scenario = load_scenario("fleet_4", {"pedestrians.number": 2})
    worlds = TrainingWorlds(8, View(scenario, action="velocity"), load_reward("progress"), cases=4)
    worlds.seed(0)
    worlds.start()
    ended, waited, restarts = np.zeros(8, bool), 0, 0
    for _ in range(120):
        before = worlds.worlds
        step, reward, _, _, acts = worlds.step(before.goal[:, 0] - before.position[:, 0])
        np.testing.assert_array_equal(acts, ~ended)
        assert (reward[~acts] == 0.0).all()
        waited += int((~acts).sum())
        ended |= step.outcome != Outcome.RUNNING
        whole = ended.reshape(2, 4).all(axis=1).repeat(4)
        np.testing.assert_array_equal(worlds.worlds.step == 0, whole)
        restarts += int(whole.sum()) // 4
        ended &= ~whole
        # The rows of a world are one case, each with another vehicle first.
        assert (np.ptp(worlds.worlds.case.reshape(2, 4), axis=1) == 0).all()
        position = worlds.worlds.position
        np.testing.assert_array_equal(position[::4, 1:4], position[:, 0].reshape(2, 4, 2)[:, 1:])
    assert waited > 50
    assert restarts > 2


def test_a_validation_takes_worlds_with_different_numbers_of_vehicles(tmp_path):
    config = dataclasses.replace(CONFIG, validation="fleet_4,fleet_door_3", overrides={})
    training = Runner.start(config, tmp_path / "run", "cpu").training
    training.validate(steps=0)
    assert 0.0 <= training.curve[0]["success"] <= 1.0


def test_rows_that_do_not_fill_a_world_are_refused(tmp_path):
    config = dataclasses.replace(CONFIG, ppo={**SIZES, "worlds": 6})
    with pytest.raises(
        InputError, match=r"^fleet_4 has 4 vehicles in a world, but the training drives 6 there: .* of 4$"
    ):
        Runner.start(config, tmp_path / "run", "cpu")


@pytest.mark.slow
def test_the_critic_knows_the_state_of_the_world(tmp_path):
    training = Runner.start(CONFIG, tmp_path / "run", "cpu").training
    training.train_until(0.1)
    state = global_state(training.worlds[0].worlds.worlds) / ppo.SCALE
    np.testing.assert_allclose(training.state.numpy(), state, rtol=1e-6)
    known, nothing = training.state, torch.zeros_like(training.state)
    values = [training.network(training.seen, part, training.memory, training.begins)[1] for part in (known, nothing)]
    assert not torch.equal(*values)


@pytest.mark.parametrize("critic", [pytest.param("own", marks=pytest.mark.slow), "state"])
def test_steps_of_vehicles_that_wait_teach_nothing(critic, tmp_path):
    """Another action, observation, advantage and target in them give the same gradient."""
    config = dataclasses.replace(CONFIG, ppo={**SIZES, "critic": critic})
    training = Runner.start(config, tmp_path / "run", "cpu").training
    training.train_until(0.1)
    for _ in range(40):
        experience = training._collect()
        if not experience.acts.all():
            break
    waits = ~experience.acts
    changed = experience._replace(
        action=torch.where(waits[..., None], 9.0, experience.action),
        advantage=torch.where(waits, 9.0, experience.advantage),
        target=torch.where(waits, 9.0, experience.target),
    )
    digests = []
    network = {name: part.clone() for name, part in training.network.state_dict().items()}
    for given in (experience, changed):
        training.network.load_state_dict(network)
        training.optimizer.state.clear()
        training._optimize(given, torch.arange(8))
        digests.append(weights_digest(training.network))
    assert digests[0] == digests[1]
    taught = experience.advantage[experience.acts]
    assert abs(float(taught.mean())) < 1e-5
    assert abs(float(taught.std()) - 1.0) < 1e-3


@pytest.mark.slow
def test_a_resumed_training_ends_in_the_same_policy(tmp_path):
    whole = trainings.train(CONFIG, tmp_path / "whole").training
    trainings.kill(CONFIG, tmp_path / "killed", 1)
    again = trainings.resume(tmp_path / "killed").training
    assert weights_digest(again.current) == weights_digest(whole.current)
