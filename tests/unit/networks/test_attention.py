"""The recurrent attention policy: what it is shown, who is heard, what is remembered, and what its actions mean."""

import dataclasses

import numpy as np
import pytest
import torch
import trainings
from lookahead_scenes import DT, crowded

from crowdbench import load_scenario
from crowdbench.core.dynamics import Bicycle, Holonomic, Unicycle
from crowdbench.core.types import Outcome
from crowdbench.networks.attention_encoder import AttentionEncoder
from crowdbench.networks.encoders import POLICIES, make_policy
from crowdbench.networks.features import VEHICLE_FEATURES, features
from crowdbench.networks.features_ahead import MOTION, RAYS, REACH, STEPS
from crowdbench.networks.policy import Seen
from crowdbench.planners.driver import Driver
from crowdbench.planners.trained_policy import NetworkPlanner, PolicyInterface
from crowdbench.predict import ConstantVelocity
from crowdbench.runs.rollout import rollout
from crowdbench.scenario.cases import Cases
from crowdbench.train import ppo
from crowdbench.train.config import PPOConfig
from crowdbench.train.policy_worlds import make_interface
from crowdbench.train.runner import Runner

torch.set_num_threads(1)


def shown_of(obs, nearest=4):
    return PolicyInterface(nearest, ConstantVelocity())(obs)


def turned(vectors, axis):
    """Vectors in the frame whose x axis is `axis`."""
    return np.stack([vectors @ axis, vectors @ np.array([-axis[1], axis[0]])], axis=-1)


@pytest.mark.slow
def test_what_is_shown_begins_with_what_is_shown_without_a_memory():
    obs = crowded()
    ahead, now = shown_of(obs), features(obs, 4)
    np.testing.assert_array_equal(ahead.vehicle[:, :VEHICLE_FEATURES], now.vehicle)
    np.testing.assert_array_equal(ahead.pedestrians[..., : now.pedestrians.shape[2]], now.pedestrians)


def test_people_are_shown_where_they_are_predicted_and_how_uncertain_that_is():
    obs = crowded()
    crowd = obs.pedestrians
    deviation = np.full((*crowd.radius.shape, 2), [0.3, 0.4])
    age = np.where(crowd.seen, 2.0 * REACH, np.inf)
    obs = dataclasses.replace(obs, pedestrians=dataclasses.replace(crowd, deviation=deviation, age=age))
    shown, position = shown_of(obs), ConstantVelocity().predict(obs, STEPS).position
    for w, k in zip(*np.nonzero(shown.seen), strict=True):
        ahead = position[w, 0, :, shown.which[w, k]] - obs.vehicle.position[w]
        numbers = shown.pedestrians[w, k, -2 * STEPS - 2 :]
        np.testing.assert_allclose(numbers[:-2].reshape(STEPS, 2), turned(ahead, shown.axis[w]), atol=1e-12)
        np.testing.assert_allclose(numbers[-2:], [REACH, np.hypot(0.3, STEPS * DT * 0.4)])
    assert not shown.pedestrians[~shown.seen].any()


def test_rays_end_at_walls_and_the_next_two_waypoints_are_shown():
    obs = crowded(2, 1)
    square = np.array(
        [[[1.0, -0.5], [2.0, -0.5], [2.0, 1.2], [1.0, 1.2]], [[-3.0, -4.0], [-3.0, 4.0], *[[np.nan] * 2] * 2]]
    )
    route = np.array([[[4.0, 0.0], [4.0, 2.0], [np.nan] * 2]] * 2)
    vehicle = dataclasses.replace(
        obs.vehicle,
        position=np.zeros((2, 2)),
        heading=np.array([0.0, 0.5]),
        goal=np.array([[6.0, 2.0]] * 2),
        route=route,
        waypoint=np.array([0, 1]),
    )
    obs = dataclasses.replace(obs, vehicle=vehicle, obstacles=np.stack([square] * 2))
    shown = shown_of(obs)
    way = [[[4.0, 0.0], [4.0, 2.0]], [[4.0, 2.0], [6.0, 2.0]]]
    for w in range(2):
        facing, _, points, rays = np.split(shown.vehicle[w, VEHICLE_FEATURES:], [2, MOTION, MOTION + 4])
        cos, sin = turned(np.array([np.cos(vehicle.heading[w]), np.sin(vehicle.heading[w])]), shown.axis[w])
        np.testing.assert_allclose(facing, [cos, sin])
        np.testing.assert_allclose(points.reshape(2, 2), turned(np.array(way[w]), shown.axis[w]), atol=1e-12)
        angle = np.arctan2(*shown.axis[w][::-1]) + np.linspace(0.0, 2.0 * np.pi, RAYS, endpoint=False)
        ends = rays[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        is_square, is_line = np.isclose(ends[:, 0], 1.0), np.isclose(ends[:, 0], -3.0)
        assert is_square.sum() >= 4
        assert is_line.sum() >= 5
    away = dataclasses.replace(vehicle, position=np.full((2, 2), 100.0))
    assert (shown_of(dataclasses.replace(obs, vehicle=away)).vehicle[:, -RAYS:] == REACH).all()


@pytest.mark.parametrize(("dynamics", "kind"), [(Holonomic(), [0, 0]), (Unicycle(), [1, 0]), (Bicycle(), [0, 1])])
def test_a_policy_is_told_what_it_drives(dynamics, kind):
    obs = crowded(2, 1)
    vehicle = dataclasses.replace(obs.vehicle, dynamics=dynamics, body=(-0.5, 0.0, 1.5))
    shown = shown_of(dataclasses.replace(obs, vehicle=vehicle)).vehicle
    np.testing.assert_array_equal(shown[:, VEHICLE_FEATURES + 3 : VEHICLE_FEATURES + 6], [[*kind, 1.5]] * 2)


@pytest.mark.slow
def test_nobody_is_heard_who_is_not_there_and_the_order_does_not_matter():
    torch.manual_seed(0)
    encoder, seen = AttentionEncoder(), Seen.of(shown_of(crowded(6, 5), nearest=5))
    with torch.no_grad():
        code = encoder(seen)
        noise = seen.pedestrians + 9.0 * (~seen.mask)[..., None]
        torch.testing.assert_close(encoder(seen._replace(pedestrians=noise)), code)
        back = Seen(seen.vehicle, seen.pedestrians.flip(1), seen.mask.flip(1))
        torch.testing.assert_close(encoder(back), code)
        alone = Seen(seen.vehicle, seen.pedestrians[:, :1], torch.zeros_like(seen.mask[:, :1]))
        assert encoder(alone).isfinite().all()
        moved = seen._replace(pedestrians=seen.pedestrians + 0.1 * seen.mask[..., None])
        somebody = seen.mask.any(dim=1)
        assert ((encoder(moved) - code).abs().amax(dim=1) > 1e-4)[somebody].all()


def test_an_episode_begins_without_a_memory_and_steps_at_once_are_steps_one_by_one():
    torch.manual_seed(0)
    policy, seen = make_policy("ppo_attention"), Seen.of(shown_of(crowded(6, 3)))  # 2 steps of 3 worlds
    first, second = (Seen(*(part[3 * at : 3 * at + 3] for part in seen)) for at in (0, 1))
    before = torch.randn(3, policy.remembered)
    begins = torch.tensor([[False, True, False], [False, False, True]])
    with torch.no_grad():
        code, memory = policy.code(seen, before, begins)
        one, kept = policy.code(first, before * torch.tensor([1.0, 0.0, 1.0])[:, None], begins.new_zeros(1, 3))
        two, after = policy.code(second, kept * torch.tensor([1.0, 1.0, 0.0])[:, None], begins.new_zeros(1, 3))
    torch.testing.assert_close(code, torch.cat([one, two]))
    torch.testing.assert_close(memory, after)
    assert (kept - before).abs().max() > 0.1


@pytest.mark.slow
@pytest.mark.parametrize("network", POLICIES)
def test_an_episode_is_the_same_alone_and_in_company(network):
    torch.manual_seed(0)
    scenario = load_scenario("unicycle", {"time_limit": 4.0, "pedestrians.number": 3})
    policy = make_policy(network)
    planner = NetworkPlanner(policy, make_interface(network, [scenario]))
    together = rollout(Driver(planner, "policy"), scenario, Cases("val", 0, 4))
    alone = rollout(Driver(planner, "policy"), scenario, Cases("val", 2, 3))
    np.testing.assert_allclose(together.command[2], alone.command[0], atol=1e-5)
    assert np.nanstd(together.command[:, :, 1]) > 0.0


def test_actions_are_velocities_in_the_frame_of_the_goal_no_faster_than_preferred():
    obs = crowded(2, 1)
    axis, interface = features(obs, 1).axis, PolicyInterface(1, ConstantVelocity())
    action = np.array([[1.0, 0.0], [0.0, 5.0]]) * obs.vehicle.preferred_speed[:, None]
    side = np.stack([-axis[:, 1], axis[:, 0]], axis=1)
    np.testing.assert_allclose(
        interface.velocities(action, obs, axis),
        obs.vehicle.preferred_speed[:, None] * np.stack([axis[0], side[1]]),
    )


@pytest.mark.slow
def test_it_is_trained_and_drives(tmp_path, monkeypatch):
    trainings.shorten(monkeypatch, ppo, 4, CASES=16, CHUNK=2, VALIDATIONS=2)
    overrides = {"pedestrians.number": [1, 3], "time_limit": 4.0}
    sizes = {"worlds": 8, "steps": 16, "segments": 4}
    config = PPOConfig(network="ppo_attention", scenario="door_10", overrides=overrides, seed=7, steps=300, ppo=sizes)
    run = Runner.start(config, tmp_path / "a", "cpu")
    before = [each.clone() for each in run.training.network.parameters()]
    list(run.train())
    changed = [(new != old).any().item() for new, old in zip(run.training.network.parameters(), before, strict=True)]
    assert all(changed)
    assert (
        "crowdbench train ppo_attention --scenario door_10"
        in run.finish(trainings.ignore).with_suffix(".md").read_text()
    )


@pytest.mark.slow
@pytest.mark.parametrize("scenario", ["door_10", "corner_5"])
def test_a_policy_that_heads_for_walls_drives_into_none(scenario):
    torch.manual_seed(1)
    policy = make_policy("ppo_attention")
    policy.action.bias.data = torch.tensor([2.0, 0.4])  # fast, and to the left of its goal
    planner = NetworkPlanner(policy, PolicyInterface(3, ConstantVelocity()))
    place = load_scenario(scenario, {"pedestrians.number": 1, "time_limit": 15.0})
    trace = rollout(Driver(planner, "policy"), place, Cases("val", 0, 30))
    assert not (trace.outcome == Outcome.WALL_COLLISION).any()
    assert (np.nanmin(trace.wall_gap, axis=1) < 0.1).mean() > 0.2  # it would have
