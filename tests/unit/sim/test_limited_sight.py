"""Limited sight and a lidar in planners, environments, recordings and replays."""

import numpy as np
import pytest
from helpers import drive, failed_checks, fixture, same, world, worlds_of
from typer.testing import CliRunner

from crowdbench.catalog import load_scenario
from crowdbench.check.checks import Subject
from crowdbench.check.drives import PLANNER
from crowdbench.cli.app import app
from crowdbench.core.types import PERFECT_SENSOR, Lidar, Noise, Rules, Sensor
from crowdbench.envs.parallel import parallel_env
from crowdbench.envs.vector import VehicleVectorEnv
from crowdbench.envs.vehicle import VehicleEnv
from crowdbench.planners.planner import Planner
from crowdbench.record.entities import draw_episode
from crowdbench.results.run_result import RunResult
from crowdbench.runs.score import replay_run
from crowdbench.scenario.cases import Cases
from crowdbench.sim.sensor import observe
from crowdbench.sim.simulator import crowd_velocities, step
from crowdbench.utils.errors import InputError
from crowdbench.views.view import View, encode, row_of

DT = 0.25
LIMITED = fixture("limited_sight")
LIDAR = Lidar(beams=8, range=5.0)


def distances(position, heading=0.0, lidar=LIDAR, **others):
    made = world(position, rules=Rules(sensor=Sensor(lidar=lidar)), **others)
    return observe(made.replace(heading=np.array([heading]))).lidar[0]


def test_the_beams_of_a_lidar_end_at_people_and_walls():
    assert distances([[0, 0], [3, 0]]) == pytest.approx([2.7] + [5.0] * 7)
    assert distances([[1, 1], [1, 3]], heading=np.pi / 2) == pytest.approx([1.7] + [5.0] * 7)
    assert distances([[0, 0], [0, 3]]) == pytest.approx([5.0, 5.0, 2.7] + [5.0] * 5)
    assert distances([[0, 0], [5.2, 0]]) == pytest.approx([4.9] + [5.0] * 7)
    assert distances([[0, 0], [5.4, 0]]) == pytest.approx([5.0] * 8)
    made = world([[0, 0], [3, 0]], rules=Rules(sensor=Sensor(lidar=LIDAR)))
    wall = np.array([[[[2.0, -1.0], [2.0, 1.0], [np.nan, np.nan]], [[-9, -3], [9, -3], [0, -9]]]])
    among = observe(made.replace(obstacles=wall)).lidar[0]
    diagonal = 3.0 * np.sqrt(2.0)
    assert among == pytest.approx([2.0, 5.0, 5.0, 5.0, 5.0, diagonal, 3.0, diagonal])
    assert observe(world([[0, 0], [3, 0]])).lidar is None


def test_a_lidar_alone_changes_nothing_else():
    lidar = {"beams": 12, "range": 4.0}
    assert same(drive("orca", "3"), drive("orca", "3", sensor__lidar=lidar))
    for now in worlds_of({"sensor.lidar": lidar}, steps=2):
        assert now.sight == {}


def test_the_rules_are_read_back_from_their_table():
    for sensor in (
        PERFECT_SENSOR,
        Sensor(range=3.0, noise=Noise(position=0.1, velocity=0.2), delay=4.0, lidar=Lidar(beams=6, range=7.0)),
        Sensor(missed=0.5),
    ):
        assert Rules.of_table(Rules(sensor=sensor).to_table()) == Rules(sensor=sensor)


def test_a_trace_has_what_was_perceived():
    trace = drive("straight", "5", LIMITED)
    steps = np.arange(trace.position.shape[1]) <= trace.steps[:, None]
    seen = trace.seen & steps[..., None]
    assert np.array_equal(np.isfinite(trace.age), np.isfinite(trace.perceived[..., 0]))
    assert np.array_equal(seen, trace.age == DT)
    assert (np.isfinite(trace.age) & ~trace.seen).any()
    off = np.abs(trace.perceived - trace.position[:, :, 1:])[seen]
    assert 0.0 < np.median(off) < 0.3
    assert 0.2 < seen.sum() / (10 * steps.sum()) < 0.9


@pytest.mark.parametrize("planner", ["orca", "social_force", "ppo", "lstm_rl", "sarl_lin"])
def test_planners_drive_where_they_do_not_see_everybody_or_nobody(planner):
    for changes in ({}, {"sensor__range": 0.0}):
        assert (drive(planner, "2", LIMITED, **changes).outcome > 0).all()


@pytest.mark.slow
@pytest.mark.parametrize("planner", ["cadrl", "sarl_cvm", "sarl_sgan_kce", "sarl_sgan_seq"])
def test_slow_planners_drive_where_they_do_not_see_everybody_or_nobody(planner):
    for changes in ({}, {"sensor__range": 0.0}):
        assert (drive(planner, "1", LIMITED, **changes).outcome > 0).all()


def test_a_planner_that_needs_to_see_somebody_is_found_by_the_check():
    class Needy(Planner):
        def plan(self, obs):
            assert obs.pedestrians.seen.any(axis=1).all(), "nobody is there"
            return np.tile([0.0, 1.0], (len(obs), 1))

    place = load_scenario("circle_crossing_5")
    limited = load_scenario("circle_crossing_5", {"sensor.range": 1.0})
    sentence = failed_checks(Subject(PLANNER, Needy, "needy", {"": place, "with limited sight: ": limited}), "val:1")[
        "answers"
    ]
    assert sentence.startswith("with limited sight: planner needy raised AssertionError: nobody is there")
    assert not failed_checks(Subject(PLANNER, Needy, "needy", {"": place, "with limited sight: ": place}), "val:1")


SEEN_BY_LIDAR = {"sensor.lidar": {"beams": 9, "range": 3.0}}


def vehicle_env(observation, cls=VehicleEnv, **options):
    return cls(scenario=load_scenario(LIMITED, SEEN_BY_LIDAR), observation=observation, dtype="float64", **options)


@pytest.mark.parametrize("observation", ["flat", "goal_frame", "dict"])
def test_environments_see_through_the_sensor(observation):
    env, place = vehicle_env(observation), load_scenario(LIMITED, SEEN_BY_LIDAR)
    many = vehicle_env(observation, VehicleVectorEnv, num_envs=2)
    shown, _ = env.reset(options={"case": "val/1"})
    both, _ = many.reset(options={"case": ["val/0", "val/1"]})
    view, now = View(place, observation), place.worlds(Cases("val", 1, 2))
    for _ in range(20):
        expected = row_of(encode(observe(now), view.observation, view.nearest), 0)
        for found in (shown, row_of(both, 1)):
            assert env.observation_space.contains(found)
            for one, two in zip(parts(found), parts(expected), strict=True):
                np.testing.assert_array_equal(one, two)
        now, _ = step(now, np.array([[0.1, 0.4]]), crowd_velocities(now, place.policies))
        shown, *_ = env.step(np.array([0.1, 0.4]))
        both, *_ = many.step(np.array([[0.1, 0.4]] * 2))
    assert ("lidar" in shown) == (observation == "dict")


def parts(shown):
    return list(shown.values()) if isinstance(shown, dict) else [shown]


@pytest.mark.parametrize("observation", ["flat", "goal_frame"])
def test_in_pettingzoo_the_sensor_is_the_vehicles_alone(observation):
    limited, perfect = (
        parallel_env(load_scenario(LIMITED, changes), observation=observation)
        for changes in ({"vehicle.visible": True}, {"vehicle.visible": True, "sensor": {}})
    )
    one, two = (env.reset(options={"case": "val/0"})[0] for env in (limited, perfect))
    for _ in range(12):
        vehicle, other = one.pop("vehicle"), two.pop("vehicle")
        assert not np.array_equal(vehicle, other)
        for agent, seen in one.items():
            np.testing.assert_array_equal(seen, two[agent])
        one, two = (env.step({"vehicle": np.array([0.0, 0.5])})[0] for env in (limited, perfect))


def test_the_space_of_noisy_observations_holds_them():
    noisy = load_scenario("circle_crossing_5", {"sensor.noise": {"position": 30.0, "velocity": 9.0}})
    env = VehicleEnv(scenario=noisy)
    shown, _ = env.reset(options={"case": "val/0"})
    for _ in range(5):
        assert env.observation_space.contains(shown)
        shown, *_ = env.step(np.zeros(2))


def test_pictures_show_whom_the_vehicle_does_not_see():
    env = vehicle_env("flat", render_mode="rgb_array")
    env.reset(options={"case": "val/0"})
    before = env.render()
    env._enter(env._world.replace(sight={**env._world.sight, "unseen": env._world.sight["unseen"] * 0}))
    assert not np.array_equal(env.render(), before)


def test_a_recording_shows_what_was_perceived():
    trace = drive("straight", "2", fixture("room"), **{f"sensor__{key}": value for key, value in SHOWN.items()})
    chunks = list(draw_episode(trace, 0, "title", {}))
    assert {"/world/sight", "/world/view", "/world/lidar"} <= {chunk.entity_path for chunk in chunks}
    perfect = list(draw_episode(drive("straight", "1", fixture("room")), 0, "title", {}))
    assert not {"/world/sight", "/world/view", "/world/lidar"} & {chunk.entity_path for chunk in perfect}


SHOWN = {"range": 3.0, "occlusion": True, "delay": 0.25, "remember": 0.5, "lidar": {"beams": 200, "range": 3.0}}


def test_a_replay_sees_again_what_was_seen(tmp_path):
    scenario = load_scenario(LIMITED)
    command = [
        "run",
        "--planner",
        "straight",
        "--scenario",
        LIMITED,
        "--cases",
        "val:3",
        "--out",
        str(tmp_path / "run"),
    ]
    assert CliRunner().invoke(app, command).exit_code == 0
    files = RunResult.read(tmp_path / "run")
    assert replay_run(files, scenario, {}).differences == []


@pytest.mark.parametrize(
    ("delay", "dt", "sentence"),
    [
        (0.3, 0.25, r"^circle_crossing_5.toml: sensor.delay is 0.3, but must be a multiple of dt, 0.25 s$"),
        (0.25, 0.2, r"^circle_crossing_5.toml: sensor.delay is 0.25, but must be a multiple of dt, 0.2 s$"),
        (1.5, 1e-3, "sensor.delay is 1.5, but must be 1 s or less, 1000 steps"),
        (-0.25, 0.25, "sensor.delay is -0.25, but must be a number of at least 0"),
        (0.25, 5e-324, "dt is 5e-324"),
    ],
)
def test_a_delay_is_a_whole_number_of_steps(delay, dt, sentence):
    with pytest.raises(InputError, match=sentence):
        load_scenario("circle_crossing_5", {"sensor.delay": delay, "dt": dt})


def test_a_delay_is_the_same_time_whatever_the_step():
    for dt, steps in ((0.25, 2), (0.1, 5), (0.05, 10)):
        sensor = load_scenario("circle_crossing_5", {"sensor.delay": 0.5, "dt": dt}).rules.sensor
        assert (sensor.delay, sensor.steps_delayed(dt)) == (0.5, steps)
