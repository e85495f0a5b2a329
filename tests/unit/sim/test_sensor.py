"""What a vehicle with limited sight sees: who, how exactly, how late, for how long."""

import numpy as np
import pytest
from helpers import drive, fixture, same, world, worlds_of

from crowdbench.api import run
from crowdbench.catalog import load_scenario
from crowdbench.check.checks import with_padding
from crowdbench.core import rng
from crowdbench.core.types import HISTORY, PERFECT_SENSOR, Detector, Rules, Sensor
from crowdbench.planners.planner import Planner
from crowdbench.predict.linear import ConstantVelocity, Linear
from crowdbench.results.run_result import RunResult
from crowdbench.runs.loading import load_stored_scenario
from crowdbench.scenario.cases import Cases
from crowdbench.sim.sensor import observe
from crowdbench.sim.sight import look
from crowdbench.utils.errors import InputError

DT = 0.25
FIELDS = ("position", "velocity", "radius", "seen", "history", "observed", "age")
LIMITED = fixture("limited_sight")
EVERYTHING = {"sensor.range": 1e5, "sensor.remember": 1.0}
"""A sensor that measures everybody, and so keeps tracks of them."""


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
    assert place.rules.sensor == PERFECT_SENSOR == Sensor()
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


def test_a_track_of_sensing_sets_the_keys_that_a_scenario_leaves_out():
    perfect, realistic = (load_scenario("circle_20", {"sensor.track": track}) for track in ("perfect", "realistic"))
    assert perfect.digest == load_scenario("circle_20").digest != realistic.digest
    sensor = realistic.rules.sensor
    assert (sensor.range, sensor.occlusion, sensor.detector, sensor.track) == (8.0, True, Detector(), None)
    written_out = {"sensor.range": 8.0, "sensor.occlusion": True, "sensor.detector": {}}
    assert realistic.digest == load_scenario("circle_20", written_out).digest
    assert load_scenario("blocks_12", {"sensor.track": "realistic"}).rules.sensor.range == 5.0
    changed = {"sensor.track": "realistic", "sensor.detector.raw": True, "sensor.range": 6.0}
    sensor = load_scenario("circle_20", changed).rules.sensor
    assert (sensor.range, sensor.detector) == (6.0, Detector(raw=True))


@pytest.mark.parametrize(
    ("scenario", "track", "sentence"),
    [
        ("circle_20", "real", r"^circle_20\.toml: sensor\.track is 'real', but must be \"perfect\" or \"realistic\"$"),
        ("circle_20", 3, r"^circle_20\.toml: sensor\.track is 3, but must be"),
        (
            fixture("noise_late"),
            "realistic",
            r"noise_late\.toml: sensor\.noise, missed and remember do not go",
        ),
    ],
)
def test_a_track_that_is_unknown_or_beside_noise_gets_one_sentence(scenario, track, sentence):
    with pytest.raises(InputError, match=sentence):
        load_scenario(scenario, {"sensor.track": track})


def test_a_run_in_a_track_of_sensing_is_computed_again_from_its_table(tmp_path):
    overrides = {"sensor.track": "realistic"}
    run("straight", "circle_20", "val:1", overrides=overrides, out=tmp_path / "made", record="none")
    again = load_stored_scenario(RunResult.read(tmp_path / "made"))
    assert again.digest == load_scenario("circle_20", overrides).digest
    assert again.rules.sensor.detector == Detector()
