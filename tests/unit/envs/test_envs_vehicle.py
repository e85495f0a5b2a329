import subprocess
import sys

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env, data_equivalence
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from crowdbench.core.types import Outcome
from crowdbench.drawing import LIGHT
from crowdbench.envs.vector import VehicleVectorEnv
from crowdbench.envs.vehicle import VehicleEnv
from crowdbench.utils.errors import InputError

N = 4


def test_it_passes_gymnasiums_checks(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    check_env(gymnasium.make("crowdbench/Vehicle-v0", scenario="circle_crossing_5").unwrapped)


@pytest.mark.slow
def test_gymnasium_finds_it_by_its_module():
    code = (
        "import gymnasium\n"
        "env = gymnasium.make('crowdbench:crowdbench/Vehicle-v0', scenario='circle_crossing_10')\n"
        "envs = gymnasium.make_vec('crowdbench/Vehicle-v0', num_envs=3, scenario='circle_crossing_5')\n"
        "print(env.observation_space.shape, type(envs).__name__, envs.observation_space.shape)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.split("\n")[0] == "(66,) VehicleVectorEnv (3, 36)"


@pytest.mark.parametrize("mode", [None, "sync", "vector_entry_point"])
def test_make_vec_makes_every_kind(mode):
    envs = gymnasium.make_vec(
        "crowdbench/Vehicle-v0", num_envs=4, vectorization_mode=mode, scenario="square_crossing_5"
    )
    obs, _ = envs.reset(seed=3)
    assert obs.shape == (4, 36)
    assert isinstance(envs.unwrapped, SyncVectorEnv if mode == "sync" else VehicleVectorEnv)
    envs.close()


def test_a_timeout_is_a_truncation_and_never_a_termination():
    env = VehicleEnv()
    env.reset(options={"case": "val/0"})
    steps = [env.step(np.zeros(2)) for _ in range(env.scenario.rules.max_steps)]
    assert not any(terminated for _, _, terminated, _, _ in steps)
    assert [truncated for _, _, _, truncated, _ in steps] == [False] * (len(steps) - 1) + [True]
    assert steps[-1][4]["outcome"] == Outcome.TIMEOUT


@pytest.mark.parametrize("action", [np.array([np.nan, 0.0]), np.zeros(3), np.zeros((1, 2))])
def test_an_action_that_is_no_velocity_is_refused(action):
    env = VehicleEnv()
    env.reset(seed=0)
    with pytest.raises(InputError, match="two finite numbers"):
        env.step(action)


def episodes(envs, seed, options=None, steps=140, toward=0.9):
    """All that a vector environment returns while each vehicle drives towards its goal at its own speed."""
    obs, infos = envs.reset(seed=seed, options=options)
    returned = [(obs, infos)]
    pace = np.linspace(0.1, 1.0, N)[:, None]
    for _ in range(steps):
        step = envs.step(np.clip(obs[:, :2], -1, 1) * toward * pace)
        returned.append(step)
        obs = step[0]
        over = step[2] | step[3]
        if envs.metadata["autoreset_mode"] == AutoresetMode.DISABLED and over.any():
            obs, infos = envs.reset(options={"reset_mask": over})
            returned.append((obs, infos))
    return returned


@pytest.mark.slow
@pytest.mark.parametrize("mode", list(AutoresetMode))
@pytest.mark.parametrize("seed", [7, [5, 4, 3, 2]])
def test_the_autoreset_modes_do_what_gymnasiums_own_vector_environment_does(mode, seed):
    ours = episodes(VehicleVectorEnv(N, autoreset_mode=mode), seed)
    theirs = episodes(SyncVectorEnv([VehicleEnv] * N, autoreset_mode=mode), seed)
    assert len(ours) == len(theirs)
    for one, other in zip(ours, theirs, strict=True):
        assert data_equivalence(one, other, exact=True)
    ended = [step for step in ours if len(step) == 5 and (step[2] | step[3]).any()]
    assert any(step[2].any() for step in ended)
    assert any(step[3].any() for step in ended)


def test_cases_are_chosen_for_all_worlds_or_for_each():
    envs = VehicleVectorEnv(3)
    single = VehicleEnv()
    obs, infos = envs.reset(options={"case": ["test/4", "val/2", "test/3"]})
    assert infos["case"].tolist() == [4, 2, 3]
    assert envs.cases == ["test/4", "val/2", "test/3"]
    for row, case in enumerate(envs.cases):
        assert np.array_equal(obs[row], single.reset(options={"case": case})[0])
    obs, infos = envs.reset(options={"case": "test/9"})
    assert infos["case"].tolist() == [9] * 3
    assert (obs == obs[0]).all()


def test_options_that_do_not_fit_are_refused():
    envs = VehicleVectorEnv(3)
    with pytest.raises(gymnasium.error.ResetNeeded):
        envs.step(np.zeros((3, 2)))
    for options, said in [
        ({"case": ["test/1"]}, "1 values, but there are 3"),
        ({"case": "37"}, "not the name of a case"),
        ({"reset_mask": np.array([True, False, False])}, "never reset"),
        ({"reset_mask": np.zeros(3, bool)}, "one of them True"),
        ({"reset_mask": [True, True, True]}, "must be an array"),
    ]:
        with pytest.raises(InputError, match=said):
            envs.reset(options=options)


def test_where_autoreset_is_disabled_an_ended_world_waits_for_its_reset():
    envs = VehicleVectorEnv(2, autoreset_mode="Disabled")
    envs.reset(seed=0)
    for _ in range(envs.scenario.rules.max_steps):
        *_, truncated, _ = envs.step(np.zeros((2, 2)))
    assert truncated.all()
    with pytest.raises(gymnasium.error.ResetNeeded):
        envs.step(np.zeros((2, 2)))
    envs.reset()
    envs.step(np.zeros((2, 2)))


def has(picture, color):
    return bool((picture == color).all(axis=2).any())


def test_a_picture_shows_trails_numbers_and_contact():
    env = VehicleEnv("circle_crossing_5", render_mode="rgb_array")
    env.reset(options={"case": "val/2"})
    first = env.render()
    assert has(first, LIGHT.background)
    done = False
    while not done:
        assert not has(env.render(), LIGHT.contact)
        _, _, done, _, info = env.step(np.array([0.0, 1.0], np.float32))
    assert info["outcome"] == Outcome.COLLISION
    assert has(env.render(), LIGHT.contact)
    # Between its start and where it is, the vehicle has left nothing but its trail.
    middle = env.render()[430, 296:306]
    assert (np.abs(middle.astype(int) - LIGHT.vehicle).sum(axis=1) < 60).any()
    assert not (np.abs(first[430, 296:306].astype(int) - LIGHT.vehicle).sum(axis=1) < 60).any()
    env.reset(options={"case": "val/2"})
    np.testing.assert_array_equal(env.render(), first)
