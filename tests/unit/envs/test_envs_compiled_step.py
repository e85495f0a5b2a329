"""A whole step in one compiled call gives what the composed steps give, to the last bit."""

import copy
import pickle

import numpy as np
import pytest

from crowdbench.catalog import load_scenario
from crowdbench.envs.compiled_step import CompiledStep
from crowdbench.envs.parallel import parallel_env
from crowdbench.envs.vehicle import VehicleEnv

USUAL = [
    ("circle_crossing_5", {}),
    ("circle_crossing_5", {"collision": "crowdnav"}),
    ("circle_crossing_5", {"collision": "crowdnav_plus"}),
    ("circle_crossing_5_visible", {}),
    ("circle_crossing_mixed", {}),
    ("square_crossing_5", {"pedestrians.number": 1}),
    ("circle_crossing_10", {"dt": 0.1, "pedestrians.number": 12}),
]

UNROUNDED = {"action": "velocity", "dtype": "float64"}


def drive(env, case, steps=120):
    """Everything that an episode shows, the vehicle heading for its goal with noise."""
    draw = np.random.default_rng(3)
    observed, info = env.reset(options={"case": case})
    shown = [(observed, 0.0, False, False, info)]
    while len(shown) < steps and not (shown[-1][2] or shown[-1][3]):
        way = shown[-1][0][:2]
        shown.append(env.step(way / max(np.hypot(*way), 1.0) + 0.4 * draw.standard_normal(2)))
    return shown


@pytest.mark.parametrize("options", [{}, UNROUNDED], ids=str)
@pytest.mark.parametrize(("name", "changes"), USUAL)
def test_episodes_are_those_of_the_composed_step(name, changes, options, monkeypatch):
    env = VehicleEnv(load_scenario(name, changes), **options)
    fast = [drive(env, f"val/{case}") for case in range(4)]
    assert env._compiled is not None
    world = env._world
    monkeypatch.setattr(CompiledStep, "fits", lambda *_: False)
    slow = [drive(env, f"val/{case}") for case in range(4)]
    assert env._compiled is None
    for one, other in zip(fast, slow, strict=True):
        assert len(one) == len(other)
        for (observed, *said), (expected, *meant) in zip(one, other, strict=True):
            np.testing.assert_array_equal(observed, expected)
            assert said == meant
    for field in ("step", "position", "velocity", "heading", "angular_speed", "history", "waypoint"):
        np.testing.assert_array_equal(getattr(world, field), getattr(env._world, field))


def drive_everybody(env, case, acting, steps=60):
    """Everything that an episode shows, where some agents act and head for their goals with noise."""
    draw = np.random.default_rng(4)
    shown = [env.reset(options={"case": case})]
    while len(shown) < steps and env.agents:
        actions = {}
        for agent in env.agents:
            if agent == "vehicle" or draw.random() < acting:
                way = shown[-1][0][agent][:2]
                actions[agent] = way / max(np.hypot(*way), 1.0) + 0.4 * draw.standard_normal(2)
        shown.append(env.step(actions))
    return shown


@pytest.mark.parametrize(("name", "changes"), USUAL)
@pytest.mark.parametrize("acting", [0.0, 0.5, 1.0])
def test_episodes_of_all_agents_are_those_of_the_composed_step(name, changes, acting, monkeypatch):
    options = UNROUNDED if acting == 0.5 else {}
    env = parallel_env(load_scenario(name, changes), **options)
    fast = [drive_everybody(env, f"val/{case}", acting) for case in range(3)]
    assert env._compiled is not None
    monkeypatch.setattr(CompiledStep, "fits", lambda *_: False)
    slow = [drive_everybody(env, f"val/{case}", acting) for case in range(3)]
    assert env._compiled is None
    for one, other in zip(fast, slow, strict=True):
        assert len(one) == len(other)
        for (observed, *said), (expected, *meant) in zip(one, other, strict=True):
            assert observed.keys() == expected.keys()
            for agent, seen in observed.items():
                np.testing.assert_array_equal(seen, expected[agent])
            assert said == meant


def test_a_copy_of_an_environment_goes_on_by_itself():
    env = VehicleEnv()
    env.reset(options={"case": "val/1"})
    env.step(np.array([0.3, 0.4]))
    for copied in (copy.deepcopy(env), pickle.loads(pickle.dumps(env))):
        ahead = [copied.step(np.array([0.0, 1.0]))[0] for _ in range(5)]
        again = copy.deepcopy(env)
        np.testing.assert_array_equal([again.step(np.array([0.0, 1.0]))[0] for _ in range(5)], ahead)


def test_what_was_observed_stays_as_it_was():
    env = VehicleEnv()
    env.reset(options={"case": "val/1"})
    observed = [env.step(np.array([0.3, 0.4]))[0] for _ in range(4)]
    kept = [each.copy() for each in observed]
    env.step(np.array([0.0, 1.0]))
    np.testing.assert_array_equal(observed, kept)
    assert len({each.tobytes() for each in observed}) == 4


@pytest.mark.parametrize(
    ("name", "changes", "options"),
    [
        ("corner_5", {}, {}),
        ("circle_crossing_5", {"vehicle.dynamics": "unicycle"}, {}),
        ("circle_crossing_5", {"sensor.range": 3.0}, {}),
        ("circle_crossing_5", {"pedestrians.policy": "social_force"}, {}),
        ("circle_crossing_5_visible", {"pedestrians.attention": {"ignores": 0.5}}, {}),
        ("circle_crossing_5", {}, {"reward": "progress"}),
        ("circle_crossing_5", {}, {"observation": "dict"}),
        ("circle_crossing_5", {}, {"action": "goal_frame"}),
    ],
)
def test_what_needs_more_is_composed(name, changes, options):
    env = VehicleEnv(load_scenario(name, changes), **options)
    env.reset(options={"case": "val/0"})
    assert env._compiled is None
