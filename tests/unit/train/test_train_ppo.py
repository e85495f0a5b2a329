import dataclasses
import json
import shutil
from types import SimpleNamespace

import numpy as np
import pytest
import torch
import trainings

from crowdbench import InputError, load_planner, load_scenario
from crowdbench.core.types import Outcome
from crowdbench.envs.rewards import Step
from crowdbench.envs.training_worlds import Driven
from crowdbench.networks.weights import weights_digest, weights_file
from crowdbench.planners.driver import Driver
from crowdbench.planners.trained_policy import load_policy
from crowdbench.runs.rollout import rollout
from crowdbench.scenario.cases import Cases
from crowdbench.train import ppo
from crowdbench.train import training as training_module
from crowdbench.train.checkpoint import CHECKPOINT
from crowdbench.train.config import PPOConfig
from crowdbench.train.runner import Runner

torch.set_num_threads(1)  # for so little work threads cost more than they save, much more where cores are busy


@pytest.fixture(autouse=True)
def small(monkeypatch):
    """A training of seconds."""
    trainings.shorten(monkeypatch, ppo, 4, CASES=16, CHUNK=2, VALIDATIONS=3)


SIZES = {"worlds": 8, "steps": 16, "segments": 4, "epochs": 2}
CONFIG = PPOConfig(
    network="ppo", overrides={"pedestrians.number": [1, 3], "time_limit": 8.0}, seed=7, steps=700, ppo=SIZES
)


def trained(directory):
    return trainings.train(CONFIG, directory)


@pytest.mark.slow
def test_a_training_by_minutes_makes_progress_where_cases_take_long_to_draw(tmp_path, monkeypatch):
    """Drawing the first cases alone takes longer than the time until the next validation."""
    config = dataclasses.replace(CONFIG, minutes=100.0)
    training = Runner.start(config, tmp_path / "run", "cpu").training
    draw, clock = training.worlds[0].worlds.seed, training_module.time.perf_counter
    late = [0.0]

    def slowly(seed):
        late[0] += 5000.0
        draw(seed)

    monkeypatch.setattr(training.worlds[0].worlds, "seed", slowly)
    monkeypatch.setattr(training_module, "time", SimpleNamespace(perf_counter=lambda: clock() + late[0]))
    list(training.learn())
    assert [point["steps"] for point in training.curve] == [0, 128, 256]


@pytest.mark.slow
def test_the_same_seed_trains_the_same_policy_and_another_one_another(tmp_path):
    one, two = (trained(tmp_path / name).training for name in ("a", "b"))
    assert weights_digest(one.current) == weights_digest(two.current)
    assert trainings.untimed(one) == trainings.untimed(two)
    other = trainings.train(dataclasses.replace(CONFIG, seed=8), tmp_path / "c").training
    assert weights_digest(other.current) != weights_digest(one.current)


def test_a_reward_that_is_too_large_ends_the_training_with_one_sentence(tmp_path):
    (tmp_path / "huge.py").write_text("def reward(step):\n    return 1e38 * step.progress\n")
    config = dataclasses.replace(CONFIG, reward=str(tmp_path / "huge.py"))
    with pytest.raises(InputError, match=r"the policy's actions are not finite, as where the reward .*huge\.py is too"):
        list(Runner.start(config, tmp_path / "run", "cpu").train())


@pytest.mark.slow
@pytest.mark.parametrize("points", [1, 3])
def test_a_resumed_training_ends_in_the_same_policy(points, tmp_path):
    whole = trained(tmp_path / "whole").training
    trainings.kill(CONFIG, tmp_path / "killed", points)
    again = trainings.resume(tmp_path / "killed").training
    assert weights_digest(again.current) == weights_digest(whole.current)
    assert trainings.untimed(again) == trainings.untimed(whole)


def test_threads_share_the_work_of_an_update_without_changing_a_bit(tmp_path):
    found = []
    for threads in (1, 2):
        training = Runner.start(CONFIG, tmp_path / str(threads), "cpu").training
        torch.set_num_threads(threads)
        try:
            training.train_until(0.1)
        finally:
            torch.set_num_threads(1)
        found.append(weights_digest(training.current))
    assert found[0] == found[1]


def test_the_advantage_is_the_discounted_sum_of_differences_up_to_the_end_of_the_episode():
    """Against the definition (Schulman et al. 2016, equation 16), with an end in the middle."""
    generator = torch.Generator().manual_seed(0)
    reward, value = torch.rand(5, 2, generator=generator), torch.rand(6, 2, generator=generator)
    goes_on = torch.ones(5, 2, dtype=torch.bool)
    goes_on[2, 0] = False
    found = ppo.advantages(reward, value, goes_on, 0.9, 0.8)
    for world in range(2):
        for start in range(5):
            expected, weight = 0.0, 1.0
            for step in range(start, 5):
                after = value[step + 1, world] if goes_on[step, world] else 0.0
                expected += weight * (reward[step, world] + 0.9 * after - value[step, world])
                weight *= 0.9 * 0.8
                if not goes_on[step, world]:
                    break
            assert found[start, world] == pytest.approx(float(expected), abs=1e-6)


def test_only_the_time_limit_leaves_the_value_of_what_would_have_followed(monkeypatch):
    training = trainings.start(dataclasses.replace(CONFIG, also_train_in="square_crossing_5"))
    training.train_until(0.0)
    for worlds, timed_out in zip(training.worlds, ([], [1, 3]), strict=True):
        now = worlds.worlds.worlds
        outcome = np.full(len(now), Outcome.COLLISION)
        outcome[timed_out] = Outcome.TIMEOUT
        ones = np.ones(len(now))
        driven = Driven(Step(now, now, outcome, ones), ones, ones, outcome, np.ones(len(now), bool))
        monkeypatch.setattr(worlds.worlds, "step", lambda command, driven=driven: driven)
    memory, on = training.memory, torch.zeros(1, 8, dtype=torch.bool)
    with torch.no_grad():
        value = training.network(training.seen, training.state, memory, on)[1].numpy()
        reward, ended, _ = training._step(torch.zeros((8, 2)))
    expected = np.ones(8)
    expected[[5, 7]] += training.parameters.gamma * value[[5, 7]]
    np.testing.assert_allclose(reward, expected, rtol=1e-5)
    assert ended.all()


@pytest.mark.slow
def test_recorded_crowds_can_be_among_the_scenarios(shared):
    data = str(shared / "data" / "eth_ucy")
    training = trainings.start(dataclasses.replace(CONFIG, also_train_in="hotel_recorded", data=data))
    list(training.learn())
    assert [each["name"] for each in training.conditions()["beside"]] == ["hotel_recorded"]


def test_data_without_recorded_crowds_is_refused():
    with pytest.raises(InputError, match="--data does not go with circle_crossing_mixed"):
        trainings.start(dataclasses.replace(CONFIG, also_train_in="square_crossing_5", data="somewhere"))


def test_a_scenario_that_is_listed_twice_is_simulated_once_with_twice_as_many_worlds():
    training = trainings.start(dataclasses.replace(CONFIG, also_train_in="square_crossing_5,door_10,square_crossing_5"))
    assert [len(worlds.rows) for worlds in training.worlds] == [2, 4, 2]
    assert np.concatenate([worlds.rows for worlds in training.worlds]).tolist() == list(range(8))
    listed = training.conditions()["beside"]
    assert [(each["name"], each["times"]) for each in listed] == [("square_crossing_5", 2), ("door_10", 1)]


@pytest.mark.slow
def test_a_training_in_several_scenarios_shares_its_worlds(tmp_path):
    config = dataclasses.replace(
        CONFIG, also_train_in="door_10,square_crossing_5", validation="circle_crossing_5,door_10", steps=130
    )
    training = trainings.start(config)
    assert [len(worlds.rows) for worlds in training.worlds] == [3, 3, 2]
    assert training.interface.nearest == 10
    list(training.learn())
    assert training.curve[-1]["steps"] == 256
    assert "--also-train-in door_10,square_crossing_5" in config.command
    about = training.conditions()["beside"]
    assert [each["name"] for each in about] == ["door_10", "square_crossing_5"]
    assert about[0]["pedestrians"]["number"] == [10, 10]


@pytest.mark.slow
def test_training_changes_nothing_that_is_random_elsewhere(tmp_path):
    np.random.seed(3)  # noqa: NPY002
    expected = np.random.random(3)  # noqa: NPY002
    np.random.seed(3)  # noqa: NPY002
    before = torch.get_rng_state()
    trained(tmp_path / "a")
    assert torch.equal(torch.get_rng_state(), before)
    np.testing.assert_array_equal(np.random.random(3), expected)  # noqa: NPY002


def test_a_finished_training_leaves_a_policy_that_drives(tmp_path):
    run = trained(tmp_path / "a")
    weights = run.finish(trainings.ignore)
    assert not (tmp_path / "a" / CHECKPOINT).exists()
    card = json.loads(weights.with_suffix(".json").read_text())
    assert card["network"] == "ppo"
    assert card["training"]["nearest"] == 3
    assert card["command"].startswith("crowdbench train ppo --scenario circle_crossing_mixed --set ")
    assert "jerk" in weights.with_suffix(".md").read_text()
    planner = load_planner("ppo", {"weights": str(weights)})
    scenario = load_scenario("circle_crossing_10", {"time_limit": 2.0})
    trace = rollout(Driver(planner, "ppo"), scenario, Cases("val", 0, 3))
    assert np.nanmax(np.linalg.norm(trace.command, axis=2)) <= 1.0 + 1e-9


def test_parameters_of_ppo_are_in_the_command_and_wrong_ones_get_one_sentence():
    assert "--ppo worlds=8 --ppo steps=16 --ppo segments=4 --ppo epochs=2" in CONFIG.command
    parameters = trainings.start(CONFIG).parameters
    assert (parameters.worlds, parameters.gamma) == (8, 0.97)
    for given, sentence in [
        (
            {"gama": 0.9},
            r"^--ppo is \{'gama': 0.9\}, but must be a table with worlds, steps, segments, epochs, learning_r",
        ),
        ({"gamma": 1.5}, "^in --ppo, gamma is 1.5, but must be a number from 0 to 1"),
        ({"epochs": 0}, "^in --ppo, epochs is 0, but must be a whole number, 1 or more"),
        ({"clip": 0.0}, "^in --ppo, clip is 0.0, but must be a number above 0"),
        ({"worlds": 8}, "^in --ppo, segments is 32, but must be 8, the number of worlds, at most"),
    ]:
        with pytest.raises(InputError, match=sentence):
            trainings.start(dataclasses.replace(CONFIG, ppo=given))


@pytest.mark.slow
def test_a_reward_of_ones_own_is_on_the_card(tmp_path):
    (tmp_path / "my reward.py").write_text("from crowdbench.envs.rewards import progress as reward\n")
    own = dataclasses.replace(CONFIG, reward=str(tmp_path / "my reward.py"))
    run = trainings.train(own, tmp_path / "a")
    card = json.loads(run.finish(trainings.ignore).with_suffix(".json").read_text())
    assert list(card["training"]["reward_files"]) == ["my reward.py"]
    assert f"--reward '{tmp_path / 'my reward.py'}'" in card["command"]


@pytest.mark.parametrize(
    ("scenario", "expected"),
    [
        ({"pedestrians": {"number": 20}}, 20),
        ({"pedestrians": {"number": [2, 7]}}, 12),
        ({"pedestrians": {"number": "many"}}, None),
        ("circle_crossing_5", None),
    ],
)
def test_a_policy_knows_with_how_many_pedestrians_it_was_trained(scenario, expected, tmp_path):
    weights = tmp_path / "ppo.safetensors"
    shutil.copy(weights_file("ppo"), weights)
    card = json.loads(weights_file("ppo").with_suffix(".json").read_text())
    card["training"] |= {"scenario": scenario, "beside": [{"pedestrians": {"number": [1, 12]}}]}
    weights.with_suffix(".json").write_text(json.dumps(card))
    assert load_policy(str(weights)).trained_pedestrians == expected


def test_weights_that_are_not_a_policys_get_one_sentence(tmp_path):
    with pytest.raises(InputError, match="are of the network sarl, but must be of ppo"):
        load_policy("sarl")
    weights = trained(tmp_path / "a").finish(trainings.ignore)
    card = json.loads(weights.with_suffix(".json").read_text())
    del card["training"]["nearest"]
    weights.with_suffix(".json").write_text(json.dumps(card))
    with pytest.raises(InputError, match="does not say how many pedestrians the policy is shown"):
        load_policy(str(weights))
