"""What a vehicle with limited sight sees: who, how exactly, how late, for how long; and its lidar."""

import numpy as np
import pytest
from helpers import drive, failed_checks, fixture, same, world
from typer.testing import CliRunner

from crowdbench.catalog import load_scenario
from crowdbench.check.contract import Subject, with_padding
from crowdbench.check.subjects import PLANNER
from crowdbench.cli import app
from crowdbench.core import rng
from crowdbench.core.types import HISTORY, PERFECT, Lidar, Noise, Rules, Sensor
from crowdbench.envs.parallel import parallel_env
from crowdbench.envs.vector import VehicleVectorEnv
from crowdbench.envs.vehicle import VehicleEnv
from crowdbench.envs.views import View, encode, row_of
from crowdbench.planners.base import Planner
from crowdbench.predict.linear import ConstantVelocity, Linear
from crowdbench.record.contents import read
from crowdbench.record.drawing import draw_episode
from crowdbench.record.write import Recorder
from crowdbench.runs.replay import replay
from crowdbench.runs.store import RunResult
from crowdbench.scenario.cases import Cases
from crowdbench.sim.sensor import observe
from crowdbench.sim.sight import look
from crowdbench.sim.simulator import crowd_velocities, step
from crowdbench.utils.errors import InputError

DT = 0.25
FIELDS = ("position", "velocity", "radius", "seen", "history", "observed", "age")
LIMITED = fixture("limited_sight")
EVERYTHING = {"sensor.range": 1e5, "sensor.remember": 1.0}
"""A sensor that measures everybody, and so keeps tracks of them."""


def worlds_of(changes, n=4, steps=14, scenario="circle_crossing_mixed"):
    """The worlds of some cases, step by step, while the vehicle drives on."""
    place = load_scenario(scenario, changes)
    now = place.worlds(Cases("val", 0, n))
    for _ in range(steps):
        yield now
        crowd = crowd_velocities(now, place.policies)
        now, _ = step(now, np.tile([0.1, 0.6], (n, 1)), crowd)


def assert_same_pedestrians(one, two, fields=FIELDS):
    for field in fields:
        np.testing.assert_array_equal(getattr(one, field), getattr(two, field), err_msg=field)


def looks(sensor, positions, velocity=(0.0, 0.0), **others):
    """What a vehicle at the origin that faces along x sees of one pedestrian at these positions, one a step.

    Where there is None, the pedestrian is far away.
    """
    now, found = None, []
    for t, place in enumerate(positions):
        fresh = world(
            [[0, 0], place or [900, 0]], [[0, 0], velocity], [[9, 0], [9, 9]], step=t, rules=Rules(sensor=sensor)
        )
        now = look(fresh.replace(sight={} if now is None else now.sight, **others))
        found.append(observe(now).pedestrians)
    return found


def seen_at(sensor, place, **others):
    return bool(looks(sensor, [place], **others)[0].seen[0, 0])


def test_perfect_sight_is_the_default_and_keeps_nothing():
    place = load_scenario("circle_crossing_5")
    assert place.rules.sensor == PERFECT == Sensor()
    assert place.worlds(Cases.parse("2")).sight == {}
    assert observe(place.worlds(Cases.parse("2"))).pedestrians.filled is None
    assert "sensor" not in place.rules.to_table()


def test_a_sensor_that_measures_everybody_shows_what_perfect_sight_shows():
    for one, two in zip(worlds_of({}), worlds_of(EVERYTHING), strict=True):
        perfect, tracked = observe(one).pedestrians, observe(two).pedestrians
        there = perfect.seen
        assert_same_pedestrians(perfect, tracked, ("seen", "observed", "age"))
        for field in ("position", "velocity", "radius"):
            assert np.array_equal(getattr(perfect, field)[there], getattr(tracked, field)[there])
        assert np.array_equal(perfect.history.swapaxes(1, 2)[there], tracked.history.swapaxes(1, 2)[there])
        assert not tracked.filled.any()


def test_planners_drive_the_same_with_a_sensor_that_measures_everybody():
    perfect, tracked = (drive("orca", "4", **changes) for changes in ({}, {"sensor__range": 1e5}))
    assert np.array_equal(perfect.position, tracked.position, equal_nan=True)
    assert np.array_equal(perfect.outcome, tracked.outcome)
    assert perfect.perceived is None


def test_where_people_are_replaced_a_sensor_that_measures_everybody_shows_what_perfect_sight_shows():
    class Keeps(Planner):
        def __init__(self):
            self.shown = []

        def plan(self, obs):
            self.shown.append(obs.pedestrians)
            return np.tile([0.0, 0.2], (len(obs), 1))

    perfect, tracked = Keeps(), Keeps()
    changes = {"pedestrians__arrival": "respawn", "collision": "crowdnav"}
    traces = [drive(perfect, "3", **changes), drive(tracked, "3", **changes, sensor__range=1e5, sensor__remember=1.0)]
    assert (np.diff(traces[0].person, axis=1) != 0).any()
    assert np.array_equal(traces[0].seen, traces[1].seen)
    for one, two in zip(perfect.shown, tracked.shown, strict=True):
        assert_same_pedestrians(one, two)


def test_the_range_is_between_the_rims():
    assert seen_at(Sensor(range=3.0), [3.599, 0.0])
    assert not seen_at(Sensor(range=3.0), [3.601, 0.0])
    assert not seen_at(Sensor(range=3.0), [3.7, 0.0], radius=np.array([[0.3, 0.3]]))
    assert seen_at(Sensor(range=3.0), [3.7, 0.0], radius=np.array([[0.3, 0.5]]))


def test_the_field_of_view_is_around_the_heading():
    front = Sensor(field_of_view=90.0)
    assert seen_at(front, [1.0, 0.99])
    assert not seen_at(front, [1.0, 1.01])
    assert not seen_at(front, [-1.0, 0.0])
    assert seen_at(front, [0.0, 3.0], heading=np.array([1.3]))
    assert seen_at(Sensor(field_of_view=360.0, range=9.0), [-3.0, 0.0])
    assert not seen_at(Sensor(field_of_view=359.0), [-3.0, 0.0])


def crowd_seen(sensor, positions, **others):
    made = world([[0, 0], *positions], rules=Rules(sensor=sensor)).replace(**others)
    return observe(look(made)).pedestrians.seen[0].tolist()


def test_people_hide_whoever_is_wholly_behind_them():
    occluding = Sensor(occlusion=True)
    assert crowd_seen(occluding, [[1, 0], [3, 0]]) == [True, False]
    assert crowd_seen(occluding, [[3, 0], [1, 0]]) == [False, True]
    assert crowd_seen(Sensor(range=99.0), [[1, 0], [3, 0]]) == [True, True]
    # One side of the disc behind looks out of the shadow.
    assert crowd_seen(occluding, [[1, 0], [3, 0.9]]) == [True, True]
    assert crowd_seen(occluding, [[-1, 0], [3, 0]]) == [True, True]
    assert crowd_seen(occluding, [[1, 0], [3, 0]], present=np.array([[True, False, True]])) == [False, True]


def test_walls_hide_people():
    wall = np.array([[[[2.0, -1.0], [2.0, 1.0]]]])
    block = np.array([[[[1.5, -1.0], [2.0, -1.0], [2.0, 1.0], [1.5, 1.0]]]])
    for obstacles in (wall, block):
        seen = crowd_seen(Sensor(occlusion=True), [[4, 0], [1, 0.6], [-4, 0], [4, 4]], obstacles=obstacles)
        assert seen == [False, True, True, True]
        assert crowd_seen(Sensor(range=99.0), [[4, 0]], obstacles=obstacles) == [True]


def test_measurements_have_the_noise_that_was_asked_for():
    sensor = {"position": 0.2, "velocity": 0.5}
    offsets = {"position": [], "velocity": []}
    for now in worlds_of({"sensor.noise": sensor}, n=40, steps=20, scenario="circle_crossing_5"):
        crowd = observe(now).pedestrians
        assert crowd.seen.all()
        for name, found in offsets.items():
            found.append(getattr(crowd, name) - getattr(now, name)[:, 1:])
        assert np.array_equal(crowd.radius, now.radius[:, 1:])
    for name, found in offsets.items():
        values = np.stack(found)
        assert values.std() == pytest.approx(sensor[name], rel=0.03)
        assert abs(values.mean()) < 0.03 * sensor[name]
        # Nobody's noise repeats: neither in the next step nor in the next case nor with the next person.
        for axis in (0, 1, 2):
            n = values.shape[axis]
            pairs = np.take(values, range(1, n), axis).ravel(), np.take(values, range(n - 1), axis).ravel()
            assert abs(np.corrcoef(*pairs)[0, 1]) < 0.05


def test_noise_follows_the_person_and_is_not_the_planners():
    now = next(worlds_of({"sensor.noise": {"position": 1.0}}, scenario="circle_crossing_5"))
    offset = observe(now).pedestrians.position - now.position[:, 1:]
    assert np.allclose(offset, rng.normal(now.key, "sensor", now.step, (5, 2)))
    assert not np.allclose(offset, rng.normal(now.noise_key, "sensor", now.step, (5, 2)))
    others = look(now.replace(person=now.person + 1, sight={}))
    moved = observe(others).pedestrians.position - now.position[:, 1:]
    assert np.allclose(moved[:, :-1], offset[:, 1:])


def test_some_are_missed_each_for_itself():
    seen = np.stack(
        [observe(now).pedestrians.seen for now in worlds_of({"sensor.missed": 0.3}, 40, 20, fixture("room"))]
    )
    assert seen.mean() == pytest.approx(0.7, abs=0.02)
    assert seen.all(axis=2).mean() == pytest.approx(0.7**5, abs=0.04)


@pytest.mark.parametrize("delay", [1, 3])
def test_measurements_arrive_late(delay):
    now = list(worlds_of({"sensor.delay": delay * DT}, scenario="circle_crossing_5"))
    perfect = [observe(each).pedestrians for each in worlds_of({}, scenario="circle_crossing_5")]
    for t, each in enumerate(now):
        crowd = observe(each).pedestrians
        if t < delay:
            assert not crowd.seen.any()
        else:
            assert_same_pedestrians(crowd, perfect[t - delay], set(FIELDS) - {"age"})
            assert (crowd.age == delay * DT).all()
        assert np.array_equal(observe(each).vehicle.position, each.position[:, 0])


def test_the_unseen_go_on_at_constant_velocity_and_are_then_forgotten():
    found = looks(Sensor(range=9.0, remember=0.6), [[3, 0], None, None, None, None], velocity=[1.0, -2.0])
    assert [bool(crowd.seen[0, 0]) for crowd in found] == [True, True, True, False, False]
    assert [crowd.age[0, 0] for crowd in found] == [0.0, 0.25, 0.5, np.inf, np.inf]
    assert found[2].position[0, 0].tolist() == [3.5, -1.0]
    assert found[2].velocity[0, 0].tolist() == [1.0, -2.0]
    assert found[2].history[0, -4:, 0].tolist() == [[3.0, 0.0], [3.0, 0.0], [3.25, -0.5], [3.5, -1.0]]
    assert found[2].filled[0, :, 0].tolist() == [False] * 6 + [True] * 2
    assert found[2].observed[0, 0] == 3
    forgotten = found[4]
    assert (forgotten.position == 0.0).all()
    assert (forgotten.velocity == 0.0).all()
    assert (forgotten.history == 0.0).all()
    assert (forgotten.observed[0, 0], forgotten.radius[0, 0], forgotten.filled.any()) == (0, 1.0, False)


def test_a_gap_is_filled_on_the_line_between_what_was_seen():
    sensor = Sensor(range=9.0, remember=1.0)
    last = looks(sensor, [[3, 0], [3, 1], None, None, [3, 4], [3, 5]], velocity=[7.0, 7.0])[-1]
    assert last.history[0, -6:, 0] == pytest.approx(np.array([[3, y] for y in range(6)]))
    assert last.filled[0, :, 0].tolist() == [False] * 4 + [True] * 2 + [False] * 2
    assert (last.observed[0, 0], last.age[0, 0]) == (6, 0.0)


def test_who_was_forgotten_begins_anew():
    again = looks(Sensor(range=9.0, remember=0.25), [[3, 0], [3, 1], None, None, [3, 4]])[-1]
    assert (again.history[0, :, 0] == [3.0, 4.0]).all()
    assert (again.observed[0, 0], again.filled.any()) == (1, False)


def test_a_long_gap_leaves_only_filled_positions_in_the_history():
    found = looks(Sensor(range=9.0, remember=9.0), [[3, 0], *[None] * HISTORY, [3, 4.5]], velocity=[0.0, 1.0])
    assert found[-2].filled.all()
    assert found[-2].observed[0, 0] == HISTORY
    assert found[-1].history[0, :, 0, 1] == pytest.approx(0.5 * np.arange(2, 10))


@pytest.mark.parametrize("delay", [0, 2])
def test_a_new_person_in_an_old_place_has_a_history_of_its_own(delay):
    sensor, now, found = Sensor(range=99.0, remember=9.0, delay=delay * DT), None, []
    for t, person in enumerate([0, 0, 7, 7, 7, 7, 7]):
        hidden = t == 2
        place = [900, 0] if hidden else [3 + person, t]
        fresh = world([[0, 0], place], step=t, rules=Rules(sensor=sensor))
        now = look(fresh.replace(person=np.array([[person]]), sight={} if now is None else now.sight))
        found.append(observe(now).pedestrians)
    found = found[delay:]
    assert [bool(crowd.seen[0, 0]) for crowd in found[:5]] == [True, True, False, True, True]
    assert (found[3].history[0, :, 0] == [10.0, 3.0]).all()
    assert [crowd.observed[0, 0] for crowd in found[:5]] == [1, 2, 0, 1, 2]


def test_a_person_who_has_left_is_remembered_like_any_other_who_is_not_seen():
    sensor = Sensor(range=9.0, remember=0.25)
    now = look(world([[0, 0], [3, 0]], rules=Rules(sensor=sensor)))
    for seen in (True, False):
        now = look(now.replace(present=np.array([[True, False]]), step=now.step + 1))
        assert bool(observe(now).pedestrians.seen[0, 0]) == seen


def test_a_case_is_the_same_alone_in_any_batch_and_with_more_padding():
    together = drive("orca", "val:0:6", LIMITED)
    for case in (0, 3, 5):
        alone = drive("orca", f"val:{case}:{case + 1}", LIMITED)
        for name in ("position", "command", "perceived", "age"):
            one, two = getattr(alone, name)[0], getattr(together, name)[case]
            assert np.array_equal(one, two, equal_nan=True), name
    place = load_scenario(LIMITED)
    narrow, wide = (each.worlds(Cases("val", 0, 3)) for each in (place, with_padding(place)))
    assert wide.radius.shape[1] > narrow.radius.shape[1]
    for name, array in narrow.sight.items():
        assert np.array_equal(array, wide.sight[name][tuple(map(slice, array.shape))], equal_nan=True), name


def test_the_sensor_also_works_between_observations():
    class Keeps(Planner):
        def __init__(self):
            self.histories = {}

        def plan(self, obs):
            return self.plan_ahead(obs, 1)[:, 0]

        def plan_ahead(self, obs, steps):
            self.histories[int(obs.step[0])] = obs.pedestrians
            return np.tile([0.0, 0.3], (len(obs), steps, 1))

    each, eighth = Keeps(), Keeps()
    traces = drive(each, "1", LIMITED), drive(eighth, "1", LIMITED, replan_every=8)
    assert same(*traces)
    assert len(eighth.histories) < len(each.histories) / 6
    for step_, crowd in eighth.histories.items():
        assert_same_pedestrians(crowd, each.histories[step_], (*FIELDS, "filled"))


def test_fits_use_measured_positions_alone():
    # The measured velocity is wrong, so that what is filled in is off the line.
    sensor = Sensor(range=9.0, remember=1.0)
    place = [[3, 0], [3, 0.25], [3, 0.5], None, None]
    now = None
    for t, at in enumerate(place):
        fresh = world([[0, 0], at or [900, 0]], [[0, 0], [2.0, 0.0]], step=t, rules=Rules(sensor=sensor))
        now = look(fresh.replace(sight={} if now is None else now.sight))
    obs = observe(now)
    assert obs.pedestrians.position[0, 0].tolist() == [4.0, 0.5]
    assert Linear().predict(obs, 1).velocity[0, 0, 0, 0] == pytest.approx([0.0, 1.0])
    assert Linear().predict(obs, 1).position[0, 0, 0, 0] == pytest.approx([3.0, 1.25])
    assert ConstantVelocity().predict(obs, 1).position[0, 0, 0, 0] == pytest.approx([4.5, 0.5])


def test_who_was_measured_once_goes_on_in_a_fit_as_in_the_observation():
    now = look(world([[0, 0], [3, 0]], [[0, 0], [0.0, 1.0]], rules=Rules(sensor=Sensor(range=9.0, remember=1.0))))
    away = now.position.copy()
    away[0, 1] = 900.0
    obs = observe(look(now.replace(position=away, step=now.step + 1)))
    assert Linear().predict(obs, 1).velocity[0, 0, 0, 0] == pytest.approx([0.0, 1.0])


def test_the_true_next_step_stays_the_truth():
    class Oracle(Planner):
        privileged = True

        def plan(self, obs):
            self.unseen = ~obs.pedestrians.seen
            self.next = obs.true_next()
            return np.zeros((len(obs), 2))

    planner = Oracle()
    trace = drive(planner, "1", LIMITED)
    last = trace.steps[0]
    assert planner.unseen.any()
    assert np.array_equal(planner.next[0], trace.velocity[0, last, 1:])


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
        PERFECT,
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
    return cls(scenario=load_scenario(LIMITED, SEEN_BY_LIDAR), observation=observation, **options)


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
    env._world = env._world.replace(sight={**env._world.sight, "unseen": env._world.sight["unseen"] * 0})
    assert not np.array_equal(env.render(), before)


def test_a_recording_keeps_and_shows_what_was_perceived(tmp_path):
    trace = drive("straight", "2", fixture("room"), **{f"sensor__{key}": value for key, value in SHOWN.items()})
    with Recorder(tmp_path / "run.rrd", planner="p", scenario="s", scenario_digest="d", cases=2) as recorder:
        recorder.add(trace, np.arange(2), {})
    found = read(tmp_path / "run.rrd").trace
    assert same(found, trace)
    assert found.rules == trace.rules
    chunks = list(draw_episode(trace, 0, "title", {}))
    assert {"/world/sight", "/world/view", "/world/lidar"} <= {chunk.entity_path for chunk in chunks}
    perfect = list(draw_episode(drive("straight", "1", fixture("room")), 0, "title", {}))
    assert not {"/world/sight", "/world/view", "/world/lidar"} & {chunk.entity_path for chunk in perfect}


SHOWN = {"range": 3.0, "occlusion": True, "delay": 0.25, "remember": 0.5, "lidar": {"beams": 200, "range": 3.0}}


def test_a_replay_sees_again_what_was_seen_and_finds_what_was_not(tmp_path):
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
    files = RunResult.read_unchecked(tmp_path / "run")
    assert replay(files, scenario, {}).differences == []
    files.recording.trace.perceived[1, 9] += 0.5
    assert "perceived at step 9" in str(replay(files, scenario, {}).differences[0])


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
