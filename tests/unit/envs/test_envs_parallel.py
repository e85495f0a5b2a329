import inspect
import re
import warnings
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from helpers import world
from pettingzoo.utils import parallel_to_aec

from crowdbench.catalog import load_scenario, simulated_scenarios
from crowdbench.core.types import HISTORY, Outcome, Rules
from crowdbench.drawing import LIGHT
from crowdbench.envs.parallel import parallel_env
from crowdbench.envs.registration import VEHICLE as ID
from crowdbench.envs.rewards import REWARDS
from crowdbench.envs.step_outcomes import outcomes_of_agents
from crowdbench.envs.vehicle import VehicleEnv
from crowdbench.networks.features_ahead import REACH
from crowdbench.scenario.layouts import LAYOUTS
from crowdbench.sim.lidar import wall_distances
from crowdbench.sim.routes import goals_on_way
from crowdbench.sim.sensor import observe
from crowdbench.sim.simulator import crowd_velocities, step
from crowdbench.utils.errors import InputError
from crowdbench.views.actions import ACTIONS
from crowdbench.views.ego import flatten, flatten_everybody
from crowdbench.views.view import DTYPES, OBSERVATIONS, layout_bound

with warnings.catch_warnings():
    # pettingzoo's tests import one of its own games in a way that it deprecates.
    warnings.simplefilter("ignore", DeprecationWarning)
    from pettingzoo.test import parallel_api_test, parallel_seed_test, render_test

QUICK = {"circle_crossing_5", "circle_crossing_mixed", "car_28", "door_10", "groups_12", "mixed_20"}
SCENARIOS = [
    name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in sorted(simulated_scenarios())
]
STILL = np.zeros(2)


def standing(scenario, command=STILL, **options):
    """Every step of an episode in which the vehicle keeps one velocity, as `step` returns it."""
    env = parallel_env(scenario)
    env.reset(**options)
    while env.agents:
        yield env, env.step({"vehicle": command})


def test_it_passes_pettingzoos_tests():
    parallel_api_test(parallel_env(), num_cycles=200)
    parallel_seed_test(parallel_env, num_cycles=60)


def test_it_renders_as_pettingzoo_expects(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    render_test(lambda render_mode: parallel_to_aec(parallel_env(render_mode=render_mode)))


def test_the_picture_shows_vehicle_and_pedestrians_where_they_are():
    env = parallel_env(render_mode="rgb_array")
    env.reset(options={"case": "test/0"})
    picture = env.render()
    # The vehicle starts 4 m below the middle of a picture that shows about 5 m in each direction.
    below = picture[300:, 250:350].reshape(-1, 3).tolist()
    assert below.count(list(LIGHT.vehicle)) > 500
    assert picture.reshape(-1, 3).tolist().count(list(LIGHT.pedestrian)) > 2500


@pytest.mark.parametrize("mode", ["ansi", "HUMAN"])
def test_an_unknown_render_mode_is_refused(mode):
    with pytest.raises(InputError, match="human, rgb_array"):
        parallel_env(render_mode=mode)


@pytest.mark.parametrize("name", SCENARIOS)
def test_observations_lie_in_their_space_which_is_finite_without_a_tracker(name):
    env = parallel_env(name)
    space = env.observation_space(env.possible_agents[0])
    # Nothing bounds the estimates of a tracker.
    exact = env.scenario.rules.sensor.detector is None
    assert np.isfinite(space.low).all() == exact
    assert np.isfinite(space.high).all() == exact
    observations, _ = env.reset(options={"case": "val/3"})
    rng = np.random.default_rng(0)
    away = {agent: rng.normal(size=2) * 10 for agent in env.agents}
    while env.agents:
        assert all(observation in space for observation in observations.values())
        observations, *_ = env.step({agent: away[agent] for agent in env.agents})


def layout_options(generator):
    """The options of a layout, each with another value."""
    others = {"against": 1.0, "blocks": 1, "width": 12.0}
    parameters = inspect.signature(LAYOUTS[generator]).parameters.values()
    names = [parameter.name for parameter in parameters if parameter.kind is parameter.KEYWORD_ONLY]
    return [(name, others.get(name, 9.0)) for name in names]


@pytest.mark.parametrize("generator", sorted(set(LAYOUTS) - {"floor_plan"}))
def test_generators_place_nobody_beyond_the_bound_of_the_spaces(generator):
    for option, other in layout_options(generator):
        layout = {"layout": {"generator": generator, option: other}, "pedestrians.preferred_speed": 2.0}
        scenario = load_scenario("circle_crossing_mixed", layout)
        starts = scenario.draw("val", np.arange(20))
        assert max(np.abs(starts.position).max(), np.abs(starts.goal).max()) <= layout_bound(scenario)


def test_each_agent_sees_the_others_from_its_own_place():
    crowd = world(
        [[0, 0], [3, 0], [0, 4]], [[1, 0], [0, 1], [0.5, 0]], [[9, 1], [-3, 0], [0, -4]], rules=Rules(visible=True)
    )
    views = flatten_everybody(crowd)[0]
    assert views[0, :6].tolist() == [9, 1, 1, 0, 0.3, 1]
    assert views[0, 6:].tolist() == [3, 0, 0, 1, 0.3, 1, 0, 4, 0.5, 0, 0.3, 1]
    assert views[1, :6].tolist() == [-6, 0, 0, 1, 0.3, 1]
    assert views[1, 6:].tolist() == [-3, 0, 1, 0, 0.3, 1, -3, 4, 0.5, 0, 0.3, 1]
    assert views[2, 6:].tolist() == [0, -4, 1, 0, 0.3, 1, 3, -4, 0, 1, 0.3, 1]


def test_nobody_sees_the_absent_nor_pedestrians_an_invisible_vehicle():
    crowd = world([[0, 0], [3, 0], [0, 4]]).replace(present=np.array([[True, True, False]]))
    views = flatten_everybody(crowd)[0]
    assert views[0, 12:].tolist() == [0] * 6
    assert views[1, 6:].tolist() == [0] * 12
    assert views[2].tolist() == [0] * 18


@pytest.mark.parametrize("name", SCENARIOS)
def test_what_the_vehicle_sees_is_what_flatten_gives_a_planner(name):
    worlds = load_scenario(name).draw("val", np.arange(4))
    assert np.array_equal(flatten(observe(worlds)), flatten_everybody(worlds)[:, 0])


def test_a_case_can_be_chosen_and_is_told():
    env = parallel_env(dtype="float64")
    observations, infos = env.reset(options={"case": "test/37"})
    assert {info["case"] for info in infos.values()} == {37}
    assert env.case == "test/37"
    start = load_scenario("circle_crossing_5").draw("test", np.array([37]))
    assert np.array_equal(observations["vehicle"], flatten(observe(start))[0])
    with pytest.raises(InputError, match="not the name of a case"):
        env.reset(options={"case": "exam:1"})


def test_a_seed_draws_the_same_training_cases_again():
    def cases(seed):
        env = parallel_env()
        return [env.reset(seed=seed if n == 0 else None) and env.case for n in range(3)]

    assert cases(5) == cases(5)
    assert len({*cases(5), *cases(6)}) == 6
    assert all(case.startswith("train/") for case in cases(5))


def test_a_timeout_is_a_truncation_of_all():
    *_, (env, (_, rewards, terminations, truncations, infos)) = standing("circle_crossing_5", options={"case": "val/0"})
    assert "vehicle" in truncations
    assert all(truncations.values())
    assert not any(terminations.values())
    assert rewards["vehicle"] == 0.0
    assert infos["vehicle"] == {
        "outcome": Outcome.TIMEOUT,
        "is_success": False,
        "gap": infos["vehicle"]["gap"],
        "case": 0,
    }
    assert env.agents == []
    assert env.step({}) == ({}, {}, {}, {}, {})
    with pytest.raises(InputError, match="the episode is over"):
        env.step({"vehicle": STILL})


def test_a_pedestrian_that_arrives_terminates_and_its_body_walks_on():
    arrived = {}
    for env, (observations, rewards, terminations, _, infos) in standing(
        "circle_crossing_5", options={"case": "val/0"}
    ):
        assert set(observations) == set(rewards) == set(terminations) == set(infos)
        assert not arrived.keys() & observations.keys()
        for agent in terminations:
            if terminations[agent]:
                assert rewards[agent] == 1.0
                assert infos[agent]["is_success"]
                assert agent not in env.agents
                arrived[agent] = observations["vehicle"].reshape(-1, 6)[1 + int(agent[-1])]
    assert len(arrived) == 5
    last = observations["vehicle"].reshape(-1, 6)
    for agent, then in arrived.items():
        now = last[1 + int(agent[-1])]
        assert now[5] == 1.0
        assert not np.array_equal(now, then)


def test_the_vehicles_collision_terminates_all():
    env = parallel_env()
    env.reset(options={"case": "val/0"})
    while env.agents:
        views = flatten_everybody(env._world)[0]
        toward = {f"pedestrian_{p}": -views[0, 6 + 6 * p : 8 + 6 * p] for p in range(5)}
        _, rewards, terminations, truncations, infos = env.step(
            {agent: toward.get(agent, STILL) for agent in env.agents}
        )
    assert infos["vehicle"]["outcome"] == Outcome.COLLISION
    assert rewards["vehicle"] == -0.25
    assert all(terminations.values())
    assert not any(truncations.values())


def outcomes(before, velocity):
    velocity = np.array([velocity], float)
    after, check = step(before, velocity[:, 0], velocity[:, 1:])
    return outcomes_of_agents(before, after, check)


def test_a_pedestrian_collides_by_the_motion_of_those_it_sees():
    start = world([[0, 0], [9, 0], [10, 0]], goal=[[50, 50], [10, 0], [-50, 0]])
    outcome, gap = outcomes(start, [[0, 0], [0.5, 0], [-0.5, 0]])
    assert outcome.tolist() == [Outcome.RUNNING] * 3
    assert gap[1:] == pytest.approx([0.15, 0.15])
    outcome, gap = outcomes(start, [[0, 0], [1, 0], [-1, 0]])
    assert outcome.tolist() == [Outcome.RUNNING, Outcome.COLLISION, Outcome.COLLISION]
    assert gap[0] == pytest.approx(8.4 - 0.0)
    near = world([[0, 0], [9.5, 0], [20, 0]], goal=[[50, 50], [10, 0], [-50, 0]])
    assert outcomes(near, [[0, 0], [1, 0], [0, 0]])[0].tolist() == [Outcome.RUNNING, Outcome.SUCCESS, Outcome.RUNNING]


@pytest.mark.parametrize("visible", [False, True])
def test_a_pedestrian_that_cannot_see_the_vehicle_does_not_pay_for_touching_it(visible):
    outcome, gap = outcomes(world([[0, 0], [0.7, 0]], rules=Rules(visible=visible)), [[1, 0], [0, 0]])
    assert outcome.tolist() == [Outcome.COLLISION, Outcome.COLLISION if visible else Outcome.RUNNING]
    assert gap[1] == (gap[0] if visible else np.inf)


def test_whoever_is_given_no_velocity_follows_its_policy():
    env = parallel_env()
    env.reset(options={"case": "val/0"})
    scenario = env.scenario
    policy = crowd_velocities(env._world, scenario.policies)[0]
    env.step({"vehicle": STILL, "pedestrian_1": np.array([0.3, -0.4]), "pedestrian_2": None})
    policy[1] = [0.3, -0.4]
    assert np.array_equal(env._world.velocity[0], np.concatenate([[STILL], policy]))


@pytest.mark.parametrize(
    ("actions", "said"),
    [
        ({}, "actions for no agent, but there must be one for the vehicle"),
        ({"vehicle": None}, "actions for no agent, but there must be one for the vehicle"),
        ({"vehicle": STILL, "pedestrian_7": STILL}, "for vehicle, pedestrian_7, but .* others for pedestrian_0, "),
        ({"vehicle": np.array([np.nan, 0.0])}, "two finite numbers"),
        ({"vehicle": np.zeros(1)}, "two finite numbers"),
    ],
)
def test_actions_that_mean_nothing_are_refused(actions, said):
    env = parallel_env()
    env.reset(seed=0)
    with pytest.raises(InputError, match=said):
        env.step(actions)


def test_only_those_present_are_agents():
    scenario = load_scenario("circle_crossing_5", {"pedestrians.number": [1, 4]})
    env = parallel_env(scenario)
    assert env.possible_agents == ["vehicle", *(f"pedestrian_{p}" for p in range(4))]
    counts = set()
    for seed in range(16):
        observations, _ = env.reset(seed=seed)
        assert list(observations) == env.agents == env.possible_agents[: len(env.agents)]
        counts.add(len(env.agents))
        seen = observations["vehicle"].reshape(-1, 6)[1:, 5]
        assert seen.sum() == len(env.agents) - 1
        env.step({"vehicle": STILL})
    assert counts == {2, 3, 4, 5}


def test_a_vehicle_may_be_alone():
    scenario = load_scenario("circle_crossing_5", {"pedestrians.number": 0})
    *_, (_, (_, rewards, terminations, _, infos)) = standing(scenario, np.array([0.0, 1.0]), seed=0)
    assert terminations == {"vehicle": True}
    assert rewards == {"vehicle": 1.0}
    assert infos["vehicle"]["gap"] == np.inf


@pytest.mark.parametrize("scenario", ["door_10", "car_28", "corner_5"])
@pytest.mark.parametrize("observation", ["goal_frame", "dict"])
def test_the_vehicle_observes_the_same_as_in_gymnasium(scenario, observation):
    chosen = {"scenario": scenario, "observation": observation, "rays": 24}
    agents, alone, action = parallel_env(**chosen), VehicleEnv(**chosen), np.array([0.3, 0.2])
    together, own = (env.reset(options={"case": "val/3"})[0] for env in (agents, alone))
    for _ in range(10):
        np.testing.assert_equal(together["vehicle"], own)
        together, own = agents.step({"vehicle": action})[0], alone.step(action)[0]


def test_a_pedestrian_observes_walls_and_the_past_of_the_vehicle():
    env = parallel_env("door_10", observation="dict", rays=24)
    seen, _ = env.reset(options={"case": "val/3"})
    path = [env._world.position[0, 0]] * HISTORY
    for _ in range(HISTORY + 2):
        seen = env.step({"vehicle": np.array([0.3, 0.2])})[0]
        path.append(env._world.position[0, 0])
    world, p = env._world, 2
    here, way = world.position[0, p + 1], goals_on_way(world)[0, p + 1] - world.position[0, p + 1]
    axis, mine = way / np.hypot(*way), seen[f"pedestrian_{p}"]
    walls = wall_distances(here[None], axis[None], world.obstacles, 24, REACH)[0]
    np.testing.assert_allclose(mine["rays"], walls, atol=1e-9)
    assert walls.min() < REACH
    x, y = world.velocity[0, p + 1] / np.hypot(*world.velocity[0, p + 1])
    facing = axis[0] * x + axis[1] * y, axis[0] * y - axis[1] * x
    np.testing.assert_allclose(mine["motion"][:6], [*facing, 0.0, 0.0, 0.0, 0.0], atol=1e-9)
    past = np.array(path[-HISTORY:]) - here
    of_vehicle = np.stack([past @ axis, past @ [-axis[1], axis[0]]], axis=1)
    assert np.isclose(mine["history"], of_vehicle[:, None]).all(axis=(0, 2)).sum() == 1
    assert np.isclose(mine["history"][-1], mine["pedestrians"][:, :2]).all()


def table_of_training():
    """The names of `arguments` and their values in backticks, as docs/training.md lists them."""
    text = (Path(__file__).parents[3] / "docs" / "training.md").read_text()
    rows = text.partition("| argument | values |\n|---|---|\n")[2].partition("\n\n")[0].splitlines()
    for row in rows:
        name, values = row.strip("| ").split(" | ")
        yield name.strip("`"), re.findall("`([a-z_0-9]+)`", values)


@pytest.mark.slow
def test_every_environment_has_the_arguments_of_the_page():
    known = {
        "reward": list(REWARDS.built_in()),
        "observation": [*OBSERVATIONS],
        "action": [*ACTIONS],
        "dtype": [*DTYPES],
    }
    rows = dict(table_of_training())
    assert rows.keys() == {*known, "nearest", "rays", "max_episode_steps"}
    for name, values in known.items():
        assert sorted(rows[name]) == sorted(values)
    choices = [{name: value} for name, values in known.items() for value in values]
    choices += [{"observation": seen, "rays": 24, "nearest": 3} for seen in ("goal_frame", "dict")]
    for choice in choices:
        envs = gymnasium.make_vec(ID, num_envs=2, scenario="door_10", **choice)
        for env in (parallel_env("door_10", **choice), gymnasium.make(ID, scenario="door_10", **choice), envs):
            env.reset(seed=0)
            alone = not hasattr(env, "possible_agents")
            env.step(env.action_space.sample() if alone else {"vehicle": env.action_space("vehicle").sample()})
            env.close()
