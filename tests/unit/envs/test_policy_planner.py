"""Policies as planners: functions, and networks in ONNX files."""

import contextlib
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from gymnasium import spaces
from gymnasium.wrappers import RescaleAction
from helpers import drive
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.vec_env import VecNormalize
from torch import nn

from crowdbench import InputError, Planner, PolicyPlanner, export_policy, load_planner, load_scenario
from crowdbench.envs import stepping
from crowdbench.envs.stable_baselines import CrowdVecEnv
from crowdbench.envs.vehicle import VehicleEnv
from crowdbench.isolation.isolated_planner import IsolatedPlanner
from crowdbench.sim.sensor import observe

NEAREST = 3
CASES = 12


def start(scenario="circle_crossing_5", **overrides):
    return observe(stepping.start(load_scenario(scenario, overrides), [f"test/{case}" for case in range(4)]))


def constant(*action):
    return lambda observed: np.tile(np.array(action, float), (len(observed), 1))


def test_an_action_is_clipped_to_its_space_and_then_to_the_preferred_speed():
    command = PolicyPlanner(constant(5.0, -5.0), "flat", "velocity").plan(start())
    np.testing.assert_allclose(command, np.tile([0.5**0.5, -(0.5**0.5)], (4, 1)))
    np.testing.assert_allclose(
        PolicyPlanner(constant(0.5, 9.0), "flat", "velocity").plan(start())[:, 0], 0.5 / 1.25**0.5
    )


def test_an_action_in_the_frame_of_the_goal_is_turned():
    obs = start()
    way = obs.vehicle.local_goal - obs.vehicle.position
    command = PolicyPlanner(constant(0.5, 0.0), "goal_frame", "goal_frame").plan(obs)
    np.testing.assert_allclose(command, 0.5 * way / np.linalg.norm(way, axis=1)[:, None])


def test_native_actions_are_clipped_to_the_limits_of_the_dynamics():
    obs = start(**{"vehicle.dynamics": "unicycle"})
    planner = PolicyPlanner(constant(-1.0, 9.0), "goal_frame", "native")
    assert planner.native
    np.testing.assert_array_equal(planner.plan(obs), np.tile([0.0, obs.vehicle.dynamics.max_angular_speed], (4, 1)))


def test_a_state_belongs_to_its_world_and_is_zero_where_an_episode_starts():
    seen = []

    def count(observed, steps):
        seen.append(steps[:, 0].tolist())
        return np.zeros((len(observed), 2)), steps + 1

    planner, obs = PolicyPlanner(count, "flat", "velocity", state=[(1,)]), start()
    planner.reset(np.arange(4))
    planner.plan(obs)
    planner.plan(obs.take(np.array([1, 3])))
    planner.plan(obs)
    planner.reset(np.arange(4))
    planner.plan(obs)
    assert seen == [[0, 0, 0, 0], [1, 1], [1, 2, 1, 2], [0, 0, 0, 0]]


@pytest.mark.parametrize(
    ("function", "said"),
    [
        (constant(np.nan, 0.0), "must be finite .case 0, step 0"),
        (constant(1.0, 0.0, 0.0), "returned shape .1, 3. instead of .1, 2."),
        (lambda observed: 1 / 0, "raised ZeroDivisionError"),
    ],
)
def test_a_function_that_gives_no_actions_gets_one_sentence(function, said):
    with pytest.raises(InputError, match=said):
        drive(PolicyPlanner(function, "flat", "velocity"), "1")


def test_a_policy_for_other_dynamics_is_refused():
    obs = start(**{"vehicle.dynamics": "unicycle"})
    with pytest.raises(InputError, match=r"trained with dynamics holonomic.*unicycle: --option dynamics=unicycle"):
        PolicyPlanner(constant(0.0, 0.0), "flat", "velocity", dynamics="holonomic").plan(obs)
    PolicyPlanner(constant(0.0, 0.0), "flat", "velocity", dynamics="unicycle").plan(obs)


def test_without_onnxruntime_a_sentence_says_how_it_is_installed(monkeypatch):
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(InputError, match=r"pip install 'crowdbench\[onnx\]'"):
        load_planner("a.onnx")


class Linear(nn.Module):
    """The first two numbers of a linear map; of the parts of a dictionary one after the other."""

    def __init__(self, features):
        super().__init__()
        torch.manual_seed(0)
        self.layer = nn.Linear(features, 2)

    def forward(self, observed):
        parts = observed.values() if isinstance(observed, dict) else [observed]
        return self.layer(torch.cat([part.flatten(1) for part in parts], 1))


@pytest.fixture(scope="module")
def onnx():
    pytest.importorskip("onnxruntime", reason="ONNX Runtime is not installed: pip install 'crowdbench[onnx]'")
    pytest.importorskip("onnxscript", reason="torch's exporter is not installed: pip install 'crowdbench[onnx]'")
    return pytest.importorskip("onnx")


def make(**view):
    return CrowdVecEnv(8, nearest=NEAREST, **view)


def randomised(model):
    """A model whose actions differ from world to world, without training it."""
    torch.manual_seed(1)
    with torch.no_grad():
        for array in model.policy.parameters():
            array.add_(0.2 * torch.randn_like(array))
    return model


def make_ppo():
    return randomised(PPO("MultiInputPolicy", env := make(), device="cpu")), env, ()


def make_normalised():
    env = VecNormalize(make(observation="goal_frame"), clip_obs=1.5)
    env.reset()
    for _ in range(5):
        env.step(np.zeros((8, 2)))
    return randomised(PPO("MlpPolicy", env, device="cpu", policy_kwargs={"share_features_extractor": False})), env, ()


def make_squashed():
    env = make(observation="flat", action="velocity")
    return randomised(PPO("MlpPolicy", env, use_sde=True, device="cpu", policy_kwargs={"squash_output": True})), env, ()


def make_sac():
    env = make(observation="goal_frame", action="native", scenario=load_scenario("circle_crossing_5", UNICYCLE))
    return randomised(SAC("MlpPolicy", env, device="cpu", buffer_size=10)), env, ()


def make_recurrent():
    contrib = pytest.importorskip("sb3_contrib", reason="sb3-contrib is not installed: pip install sb3-contrib")
    model = contrib.RecurrentPPO(
        "MlpLstmPolicy", env := make(observation="goal_frame"), device="cpu", policy_kwargs={"lstm_hidden_size": 8}
    )
    return randomised(model), env, [(1, 8), (1, 8)]


UNICYCLE = {"vehicle.dynamics": "unicycle"}
MODELS = make_ppo, make_normalised, make_squashed, make_sac, make_recurrent


def reference(model, env, state):
    """The planner that asks the model itself."""

    def predict(observed, *memory):
        observed = env.normalize_obs(observed) if hasattr(env, "normalize_obs") else observed
        if not memory:
            return model.predict(observed, deterministic=True)[0]
        action, memory = model.predict(observed, tuple(part.swapaxes(0, 1) for part in memory), deterministic=True)
        return action, *(part.swapaxes(0, 1) for part in memory)

    view = env.get_attr("view")[0]
    return PolicyPlanner(predict, view.observation, view.action, NEAREST, state)


class Both(Planner):
    """Drives with one planner, and asks another one too."""

    def __init__(self, planner, other):
        self.planner, self.other, self.native, self.difference = planner, other, planner.native, 0.0

    def reset(self, rows):
        self.planner.reset(rows)
        self.other.reset(rows)

    def plan(self, obs):
        command = self.planner.plan(obs)
        self.difference = max(self.difference, np.abs(command - self.other.plan(obs)).max())
        return command


@pytest.mark.slow
@pytest.mark.parametrize("make_model", MODELS)
def test_an_exported_model_drives_as_the_model_does_and_alone_as_in_a_batch(make_model, onnx, tmp_path):
    model, env, state = make_model()
    export_policy(model, tmp_path / "a.onnx", env)
    overrides = {"vehicle__dynamics": "unicycle"} if make_model is make_sac else {}
    planner = load_planner(str(tmp_path / "a.onnx"))
    both = Both(planner, reference(model, env, state))
    trace = drive(both, f"{CASES}", **overrides)
    assert both.difference < 2e-4
    assert np.nanstd(trace.command) > 0.05
    for case in range(0, CASES, 5):
        alone = drive(planner, f"test/{case}", **overrides)
        steps = alone.command.shape[1]
        np.testing.assert_array_equal(alone.command[0], trace.command[case, :steps])


@pytest.mark.slow
@pytest.mark.parametrize(
    "observation", ["flat", *(pytest.param(each, marks=pytest.mark.slow) for each in ("goal_frame", "dict"))]
)
def test_a_torch_module_is_exported_as_it_is_trained(observation, onnx, tmp_path):
    env = VehicleEnv(observation=observation, action="goal_frame", nearest=NEAREST)
    module = Linear(spaces.flatdim(env.observation_space)).train()
    export_policy(module, tmp_path / "a.onnx", env)
    assert module.training
    obs = start()
    planner = load_planner(str(tmp_path / "a.onnx"))
    expected = PolicyPlanner(lambda seen: module(tensors(seen)).detach().numpy(), observation, "goal_frame", NEAREST)
    np.testing.assert_allclose(planner.plan(obs), expected.plan(obs), atol=1e-5)
    assert (planner.dynamics, planner.trained_pedestrians, planner.trained_dt) == ("holonomic", 5, 0.25)


def tensors(observed):
    if isinstance(observed, dict):
        return {name: torch.from_numpy(part).float() for name, part in observed.items()}
    return torch.from_numpy(observed).float()


class Remembers(nn.Module):
    def forward(self, observed, speed):
        speed = speed + 0.1
        return torch.cat([speed, 0.0 * observed[:, :1]], 1), speed


@pytest.mark.slow
def test_a_recurrent_module_remembers_until_the_reset(onnx, tmp_path):
    env = VehicleEnv(observation="goal_frame", action="goal_frame")
    export_policy(Remembers(), tmp_path / "a.onnx", env, state=[(1,)])
    planner, obs = load_planner(str(tmp_path / "a.onnx")), start()
    for speed in (0.1, 0.2):
        np.testing.assert_allclose(np.linalg.norm(planner.plan(obs), axis=1), speed, rtol=1e-6)
    planner.reset(np.arange(4))
    np.testing.assert_allclose(np.linalg.norm(planner.plan(obs), axis=1), 0.1, rtol=1e-6)


@pytest.fixture(scope="module")
def file_of_linear(onnx, tmp_path_factory):
    file = tmp_path_factory.mktemp("linear") / "a.onnx"
    env = VehicleEnv(observation="goal_frame", action="goal_frame", nearest=NEAREST)
    export_policy(Linear(5 + 9 * NEAREST), file, env)
    return file


@pytest.fixture
def exported(file_of_linear, tmp_path):
    return Path(shutil.copy(file_of_linear, tmp_path))


def with_metadata(onnx, file, text):
    model = onnx.load(file)
    del model.metadata_props[:]
    if text is not None:
        onnx.helper.set_model_props(model, {"crowdbench": text})
    onnx.save(model, file)
    return str(file)


@pytest.mark.slow
def test_a_file_gives_the_same_commands_in_its_own_process(file_of_linear):
    here = drive(load_planner(str(file_of_linear)), "val:3", time_limit=5.0)
    with contextlib.closing(IsolatedPlanner(str(file_of_linear), {})) as planner:
        apart = drive(planner, "val:3", time_limit=5.0)
    np.testing.assert_array_equal(apart.command, here.command)


def test_a_file_without_metadata_asks_for_the_options_by_name(onnx, exported):
    file = with_metadata(onnx, exported, None)
    with pytest.raises(InputError, match="give --option observation=goal_frame --option action=goal_frame;"):
        load_planner(file)
    with pytest.raises(InputError, match="give --option action=goal_frame;"):
        load_planner(file, {"observation": "goal_frame"})
    options = {"observation": "goal_frame", "action": "goal_frame"}
    with pytest.raises(InputError, match=r"does not fit the scenario.*Got: 95 Expected: 32"):
        load_planner(file, options).plan(start())
    assert load_planner(file, {**options, "nearest": NEAREST}).plan(start()).shape == (4, 2)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[1", "cannot be read as an ONNX file: JSONDecodeError"),
        ('{"observation": "radar", "action": "velocity"}', "observation is 'radar', but must be one of"),
    ],
)
def test_wrong_metadata_get_one_sentence(onnx, exported, text, said):
    with pytest.raises(InputError, match=said):
        load_planner(with_metadata(onnx, exported, text))


def test_what_cannot_be_exported_gets_one_sentence(onnx, tmp_path):
    env = VehicleEnv(observation="goal_frame", nearest=NEAREST)
    with pytest.raises(InputError, match="env is a str"):
        export_policy(Linear(3), tmp_path / "a.onnx", "env")
    for model in (Linear(3), "model"):
        with pytest.raises(InputError, match="cannot be exported"):
            export_policy(model, tmp_path / "a.onnx", env)
    scaled = RescaleAction(VehicleEnv(scenario="unicycle", action="native"), -1, 1)
    with pytest.raises(InputError, match="wrappers that change actions are not exported"):
        export_policy(PPO("MlpPolicy", scaled, device="cpu"), tmp_path / "a.onnx", scaled)
    assert not (tmp_path / "a.onnx").exists()


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"function": 3}, "function is 3, but must be a function of the observation"),
        ({"function": lambda: 1}, "must be a function of the observation and of each array of the state"),
        ({"state": [(2,)]}, "must be a function of the observation and of each array of the state"),
        ({"state": 3}, "state is 3, but must be a list of shapes"),
        ({"state": [("x",)]}, "state is .*, but must be a list of shapes"),
        ({"nearest": 10**9}, "nearest is 1000000000, but must be a whole number from 1 to 10000"),
        ({"dynamics": "boat"}, "dynamics is 'boat', but must be None or one of holonomic, unicycle, bicycle"),
        ({"action": "world"}, "action is 'world', but must be one of normalized, .*, velocity, goal_frame, native"),
    ],
)
def test_arguments_that_do_not_fit_get_one_sentence(options, sentence):
    given = {"function": lambda observed: observed, "observation": "flat", "action": "velocity", **options}
    with pytest.raises(InputError, match=sentence):
        PolicyPlanner(**given)


def test_a_function_observes_numbers_of_the_chosen_type():
    seen = []

    def act(observed):
        seen.append(observed.dtype)
        return np.zeros((len(observed), 2))

    for options in ({}, {"dtype": "float64"}):
        PolicyPlanner(act, "flat", "normalized", **options).plan(start())
    assert seen == [np.float32, np.float64]


def test_a_normalized_action_is_a_share_of_the_preferred_speed():
    obs = start(**{"vehicle.preferred_speed": 2.0})
    np.testing.assert_allclose(PolicyPlanner(constant(0.5, -9.0), "flat", "normalized").plan(obs)[:, 0], 2.0 * 0.2**0.5)
    way = obs.vehicle.local_goal - obs.vehicle.position
    command = PolicyPlanner(constant(0.5, 0.0), "goal_frame", "normalized_goal_frame").plan(obs)
    np.testing.assert_allclose(command, way / np.linalg.norm(way, axis=1)[:, None])
    native = PolicyPlanner(constant(0.0, 1.0), "goal_frame", "normalized_native")
    wheels = start(**{"vehicle.dynamics": "unicycle", "vehicle.preferred_speed": 2.0})
    np.testing.assert_array_equal(
        native.plan(wheels), np.tile([1.0, wheels.vehicle.dynamics.max_angular_speed], (4, 1))
    )
