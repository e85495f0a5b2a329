"""PSS-Social: the answers of its authors' code and the motion of their scene, as recorded from it."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch
from helpers import drive, rollout
from lookahead_scenes import crowded
from safetensors.torch import save_file

from crowdbench import Cases, Driver, InputError, Planner, Rules, World, load_scenario
from crowdbench.plugins.kind import load_module
from crowdbench.sim import observe, step

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "adapters" / "pss_social"
SQUARE = str(FOLDER / "square.toml")
with np.load(ROOT / "tests" / "golden" / "pss_social.npz") as file:
    RECORDED = dict(file)
DENSITIES = (11, 19, 23)
STEPS = 50

adapter, scene = load_module(FOLDER / "pss_social.py"), load_module(FOLDER / "mpe_pedestrians.py")
physics, driven = load_module(FOLDER / "mpe_physics.py"), load_module(FOLDER / "in_mpe.py")


def recorded(pedestrians):
    """Positions, velocities, goals, and the vehicle's action in each step, of a recorded episode."""
    return (RECORDED[f"{name}_{pedestrians}"].astype(float) for name in ("position", "velocity", "goal", "force"))


def worlds(pedestrians, steps=slice(0, 1)):
    """Worlds in the recorded states of an episode, as crowdbench has them: with the positions of one step later."""
    position, velocity, goal, _ = recorded(pedestrians)
    position = (position + physics.DT * velocity)[steps]
    agents = len(position), pedestrians + 1
    return World.create(
        position=position,
        velocity=velocity[steps],
        goal=np.repeat(goal[None], len(position), axis=0),
        radius=np.full(agents, physics.SIZE),
        preferred_speed=np.full(agents, 4.0),
        parameters={"pedestrians": {}},
        rules=load_scenario(SQUARE).rules,
    )


def random_policy(seed=0):
    torch.manual_seed(seed)
    return adapter.Policy(torch.nn.Identity(), [115, 64, 64], torch.zeros(115), torch.ones(115)).eval()


class Answer(torch.nn.Module):
    """A network that keeps what it is shown and always gives the same answer."""

    def __init__(self, *action):
        super().__init__()
        self.action, self.shown = torch.tensor(action), []

    def forward(self, observed):
        self.shown.append(observed.numpy())
        return self.action.expand(len(observed), 5)


@pytest.mark.parametrize("name", RECORDED["names"])
def test_each_network_answers_as_the_authors_code_does(name, shared):
    policy = adapter.load_policy(shared / "networks" / "pss_social" / f"{name}.safetensors")
    expected = RECORDED["mean"][RECORDED["names"].tolist().index(name)]
    with torch.inference_mode():
        np.testing.assert_allclose(policy(torch.from_numpy(RECORDED["observation"])), expected, rtol=0, atol=1e-5)
    assert expected.std(axis=0).max() > 0.1  # the answers differ


def test_the_observation_is_that_of_the_authors_code():
    found = []
    for pedestrians in DENSITIES:
        position, velocity, goal, _ = (part[:: RECORDED["every"]] for part in recorded(pedestrians))
        seen = np.ones((len(position), pedestrians), bool)
        found.append(adapter.observe(position, velocity, goal[:1].repeat(len(position), axis=0), seen))
    np.testing.assert_allclose(np.concatenate(found), RECORDED["observation"], rtol=0, atol=1e-5)


@pytest.mark.parametrize("pedestrians", DENSITIES)
def test_the_states_of_fifty_steps_are_those_of_the_authors_scene(pedestrians):
    position, velocity, _, force = recorded(pedestrians)
    world, policy = worlds(pedestrians), scene.policy()
    gap = np.inf
    for t in range(STEPS + 1):
        mpe = physics.positions_of_mpe(world.position, world.velocity)
        # Their positions and velocities are float32.
        np.testing.assert_allclose(mpe[0], position[t], rtol=0, atol=1e-4)
        np.testing.assert_allclose(world.velocity[0], velocity[t], rtol=0, atol=1e-4)
        if t == STEPS:
            break
        away, distance = (part[:, :1] for part in physics.pairs(mpe, world.present))
        command = physics.velocities_after(world.velocity[:, :1], force[t][None, None], away, distance)[:, 0]
        world, check = step(world, command, policy.velocities(world, {}))
        gap = min(gap, check.gap[0])
    assert np.linalg.norm(position[-1] - position[0], axis=1).min() > 0.1  # all have moved
    assert (gap < 0.0) == (pedestrians != 19)  # the vehicle touches pedestrians in two of the three


@pytest.mark.parametrize("pedestrians", DENSITIES)
def test_a_network_drives_as_in_the_authors_scene(pedestrians, shared):
    made = adapter.planner(str(shared / "networks" / "pss_social" / "pss_social-seed9.safetensors"))
    driven = np.array([t for t in range(STEPS) if t % 20 < 12])  # by the network, other steps at random
    obs = observe(worlds(pedestrians, driven), np.arange(len(driven)), None, None)
    _, velocity, _, _ = recorded(pedestrians)
    np.testing.assert_allclose(made.plan(obs), velocity[driven + 1, 0], rtol=0, atol=1e-4)


def test_people_that_are_not_seen_have_no_influence():
    position, velocity = np.random.default_rng(0).normal(0.0, 1.0, (2, 3, 5, 2))
    goal, seen = np.zeros((3, 2)), np.array([[True, True, False, False], [False] * 4, [True] * 4])
    shown = adapter.observe(position, velocity, goal, seen)
    elsewhere = position.copy()
    elsewhere[:, 1:][~seen] = 0.1
    assert np.array_equal(shown, adapter.observe(elsewhere, velocity, goal, seen))
    np.testing.assert_allclose(
        shown[0], adapter.observe(*(part[:1, :3] for part in (position, velocity)), goal[:1], seen[:1, :2])[0]
    )
    assert np.array_equal(shown[1, 7:103].reshape(24, 4), [[10.0, 10.0, 0.0, 0.0]] * 24)
    assert np.isfinite(shown).all()


def test_sixteen_of_more_pedestrians_are_shown_and_all_are_counted():
    position = np.zeros((1, 21, 2))
    position[0, 1:, 0] = np.arange(20, 0, -1)
    shown = adapter.observe(position, np.zeros((1, 21, 2)), np.ones((1, 2)), np.ones((1, 20), bool))
    assert shown[0, 7:103].reshape(24, 4)[:, 0].tolist() == [*range(1, 11), *[10.0] * 14]
    assert shown[0, 112] == pytest.approx(20 / 24)


def test_an_action_is_a_force_that_damped_velocities_follow():
    obs = crowded(2, 3)
    made = adapter.PSSSocialPlanner(Answer(9.0, -3.0, 1.0, 0.5, 0.0), scale=2.0, in_mpe=False)
    expected = 0.75 * obs.vehicle.velocity + 0.1 * 2.0 * 5.0 * np.array([1.0, -0.25])
    speed, most = np.linalg.norm(expected, axis=1), obs.vehicle.preferred_speed
    np.testing.assert_allclose(made.plan(obs), expected / np.maximum(speed / most, 1.0)[:, None])
    ahead = obs.vehicle.goal - obs.vehicle.position
    np.testing.assert_allclose(made.policy.shown[0][:, 6], np.linalg.norm(ahead, axis=1) / 2.0, rtol=1e-6)
    np.testing.assert_allclose(made.policy.shown[0][:, :2], obs.vehicle.velocity / 2.0, rtol=1e-6)


def test_a_command_of_our_planners_becomes_the_nearest_forces():
    obs = crowded(3, 2)
    seen = np.zeros_like(obs.pedestrians.seen)
    obs = dataclasses.replace(obs, pedestrians=dataclasses.replace(obs.pedestrians, seen=seen))
    vehicle = dataclasses.replace(obs.vehicle, preferred_speed=np.full(3, 4.0))
    obs, wish = dataclasses.replace(obs, vehicle=vehicle), np.array([[0.1, -0.1], [9.0, 0.0], [0.0, -9.0]])

    class Wish(Planner):
        def plan(self, obs):
            self.shown = obs
            return 2.0 * wish

    inner = Wish()
    command = driven.InMPE(inner, speed=0.5, scale=2.0).plan(obs)
    slowed = 0.75 * vehicle.velocity
    np.testing.assert_allclose(command, np.clip(wish, slowed - 0.5, slowed + 0.5), atol=1e-12)
    assert inner.shown.vehicle.preferred_speed.tolist() == [1.0] * 3
    np.testing.assert_allclose(inner.shown.vehicle.goal, 2.0 * vehicle.goal)
    np.testing.assert_allclose(inner.shown.pedestrians.radius, 2.0 * obs.pedestrians.radius)


def test_weights_are_read_and_other_files_get_one_sentence(tmp_path):
    policy = random_policy()
    tensors = policy.state_dict() | {
        "obs_mean": torch.ones(115),
        "obs_var": torch.ones(115),
        "value_net.bias": torch.ones(1),
    }
    save_file(tensors, tmp_path / "weights.safetensors")
    made = adapter.planner(str(tmp_path / "weights.safetensors"))
    assert all(map(torch.equal, made.policy.state_dict().values(), policy.state_dict().values()))
    assert made.policy.mean.tolist() == [1.0] * 115
    assert len(made.facts["weights"]) == 12
    save_file({"obs_mean": torch.ones(115)}, tmp_path / "other.safetensors")
    (tmp_path / "text.safetensors").write_text("no weights")
    for name, sentence in {"other": "do not belong to", "text": "do not belong to", "absent": "cannot be read"}.items():
        with pytest.raises(InputError, match=f"{name}.safetensors {sentence}") as error:
            adapter.load_policy(tmp_path / f"{name}.safetensors")
        assert "\n" not in str(error.value)


def test_starts_do_not_touch_and_goals_are_away():
    world = load_scenario(SQUARE, {"pedestrians.number": 23}).draw("val", np.arange(20))
    assert max(np.abs(world.position).max(), np.abs(world.goal).max()) <= 1.1
    _, distance = physics.pairs(world.position, world.present)
    assert distance.min() > 0.3
    assert np.linalg.norm(world.goal - world.position, axis=2).min() > 0.8


def test_contacts_do_not_end_an_episode_and_the_hundredth_state_is_the_last():
    still = adapter.PSSSocialPlanner(Answer(0.0, 0.0, 0.0, 0.0, 0.0), scale=1.0, in_mpe=True)
    trace = rollout(Driver(still, "still"), load_scenario(SQUARE, {"pedestrians.number": 23}), Cases.parse("val:10"))
    assert (trace.steps == 101).all()  # the last step of crowdbench is a time-out
    assert (trace.gap[:, :100] < 0.0).any()
    ends = drive(still, "val:10", SQUARE, pedestrians__number=23, collision_ends=True)
    assert (ends.steps < 101).any()
    touched = (trace.gap[:, :100] < 0.0).any(axis=1)
    assert np.array_equal(ends.steps < 101, touched)


def test_collisions_end_episodes_unless_a_scenario_says_otherwise():
    usual = load_scenario("circle_crossing_5")
    assert usual.rules.collision_ends
    assert "collision_ends" not in usual.table
    assert "collision_ends" not in usual.rules.to_table()
    going_on = load_scenario(SQUARE)
    assert Rules.of_table(going_on.rules.to_table()) == going_on.rules
    assert dataclasses.replace(going_on.rules, collision_ends=True) != going_on.rules
    assert going_on.digest != load_scenario(SQUARE, {"collision_ends": True}).digest
