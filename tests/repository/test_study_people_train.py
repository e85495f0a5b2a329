"""The network of `learned_people`, and its training."""

import numpy as np
import pytest
from helpers import world
from repository.test_study_people import crossings
from safetensors.numpy import load_file

from agents.pedestrians.learned_people.learned_people import FEATURES, NEAREST, REACH, LearnedPeople, observe
from crowdbench.plugins import plugin_name
from studies.people.fit import POLICIES
from studies.people.simulate import simulate
from studies.people.train import examples, train

pytestmark = pytest.mark.slow  # the kernels take seconds to compile


def scene(angle=0.0, shift=(0.0, 0.0), people=8):
    """Positions, velocities, goals, speeds and presence of people at random, turned and shifted."""
    generator = np.random.default_rng(1)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    position, velocity, goal = (generator.normal(0.0, size, (1, people, 2)) @ turn for size in (2.0, 1.0, 6.0))
    present = np.arange(people)[None] != 3
    return position + shift, velocity, goal + shift, generator.uniform(0.8, 1.6, (1, people)), present


def test_observations_are_those_of_the_pedestrians_own_frame():
    assert observe(*scene(1.1, (4.0, -3.0))) == pytest.approx(observe(*scene()), abs=1e-12)


def test_an_agent_observes_the_nearest_others_first():
    position, velocity, goal, speed, present = scene()
    apart = np.linalg.norm(position[0] - position[0, 0], axis=-1)
    others = sorted(j for j in range(1, len(apart)) if present[0, j] and apart[j] < REACH)
    others.sort(key=apart.__getitem__)
    rows = observe(position, velocity, goal, speed, present)[0, 0, 4:].reshape(NEAREST, 5)
    seen = rows[rows[:, 4] == 1.0]
    assert len(seen) == min(len(others), NEAREST)
    assert np.linalg.norm(seen[:, :2], axis=1) * REACH == pytest.approx(apart[others[:NEAREST]])
    assert (rows[len(seen) :] == 0.0).all()


def test_examples_are_mirrored_and_the_change_is_none_for_constant_motion():
    observed, change = examples(crossings(windows=1))
    assert observed.shape == (len(change), FEATURES)
    assert np.abs(change).max() < 1e-9
    assert np.abs(observed[:, 5::5]).max() > 0.1  # somebody is beside somebody
    assert np.abs(observed[:, 5::5].sum()) < 1e-9  # and mirrored on the other side


def test_a_pedestrian_alone_goes_to_its_goal():
    policy = LearnedPeople()
    now = world([[0.0, 90.0], [0.0, 0.0]], [[0.0, 0.0], [1.2, 0.0]], [[0.0, 90.0], [20.0, 0.0]])
    now = now.replace(preferred_speed=np.full((1, 2), 1.2))
    table = {name: np.full((1, 2), float(value)) for name, value in policy.parameters.items()}
    assert policy.velocities(now, table)[0, 0] == pytest.approx([1.2, 0.0], abs=0.15)


def test_training_writes_a_policy_that_differs_from_the_shipped_one(shared, tmp_path, monkeypatch):
    monkeypatch.setattr("studies.people.train.EPOCHS", 1)
    windows = crossings(windows=1)
    train(data=shared / "data" / "eth_ucy", out=tmp_path, held_out="zara")
    written = tmp_path / "learned_people.py"
    assert plugin_name(str(written)) in POLICIES
    weights = load_file(tmp_path / "learned_people.safetensors")
    assert weights["w0"].shape == (48, FEATURES)
    own, shipped = (simulate(policy, windows, rollouts=1)[0] for policy in (str(written), "learned_people"))
    assert not np.array_equal(own, shipped, equal_nan=True)
