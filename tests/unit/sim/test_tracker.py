"""A detector of people and its tracker: no identities, false tracks, delay, raw detections."""

import dataclasses

import numpy as np
import pytest
from helpers import drive, same, world

from crowdbench.api import run
from crowdbench.catalog import load_scenario
from crowdbench.core.types import HISTORY, Detector, Rules, Sensor
from crowdbench.drawing import Moment, measured_rings
from crowdbench.envs.parallel import parallel_env
from crowdbench.envs.vehicle import VehicleEnv
from crowdbench.planners.planner import Planner
from crowdbench.record.entities import draw_episode
from crowdbench.results.compare import compare
from crowdbench.results.run_result import RunResult
from crowdbench.results.stored_tracks import read_tracks, write_tracks
from crowdbench.results.table import RunTable
from crowdbench.runs.replay import stored_case
from crowdbench.scenario.cases import Cases
from crowdbench.sim.detections import detect
from crowdbench.sim.sensor import observe
from crowdbench.sim.sight import look
from crowdbench.sim.simulator import crowd_velocities, step
from crowdbench.sim.tracker import Tracks
from crowdbench.utils.errors import InputError
from crowdbench.views.ego import flatten, flatten_everybody

DT = 0.25
PERFECT = Detector(position=0.0, missed=0.0, false_detections=0.0, spare=2)
WALL = np.array([[[[2.0, -9.0], [2.0, 9.0]]]])


def looks(detector, positions, **sensor):
    """The worlds after each look at people at these positions, `[time, person, 2]`; the vehicle is at the origin."""
    rules, now, found = Rules(sensor=Sensor(detector=detector, **sensor)), None, []
    for t, people in enumerate(positions):
        fresh = world([[0, 0], *people], step=t, rules=rules)
        now = look(fresh if now is None else fresh.replace(sight=now.sight))
        found.append(now)
    return found


def test_the_tracks_of_a_perfect_detector_are_at_the_true_positions():
    path = [[[1.0 + 0.3 * t, 2.0], [-1.0, 3.0 - 0.2 * t]] for t in range(12)]
    found = looks(PERFECT, path)
    for now, people in zip(found, path, strict=True):
        crowd = observe(now).pedestrians
        assert crowd.position.shape == (1, 4, 2)
        assert crowd.seen[0].tolist() == [True, True, False, False]
        np.testing.assert_allclose(sorted(crowd.position[0, :2].tolist()), sorted(people))
        assert crowd.age[0].tolist() == [0.0, 0.0, np.inf, np.inf]
        assert not crowd.filled.any()
    np.testing.assert_allclose(sorted(crowd.velocity[0, :2].tolist()), [[0.0, -0.8], [1.2, 0.0]], atol=0.01)
    order = np.argsort(crowd.position[0, :2, 0])
    np.testing.assert_allclose(crowd.history[0, :, order[1], 0], [1.0 + 0.3 * t for t in range(12 - HISTORY, 12)])
    assert crowd.observed[0].tolist() == [HISTORY, HISTORY, 0, 0]


def test_the_tracks_do_not_depend_on_the_columns_of_people():
    scenario = load_scenario("circle_crossing_5", {"sensor.detector": {}, "sensor.delay": DT})
    now = scenario.worlds(Cases("val", 0, 8))
    order = np.array([3, 0, 4, 1, 2])
    everybody = np.concatenate([[0], 1 + order])
    sight = {}
    for _ in range(15):
        moved = {name: getattr(now, name)[:, everybody] for name in ("position", "velocity", "radius", "present")}
        other = look(now.replace(**moved, person=now.person[:, order], sight=sight))
        sight = other.sight
        for name in Tracks._fields:
            np.testing.assert_array_equal(sight[name], now.sight[name])
        np.testing.assert_array_equal(sight["detected"], now.sight["detected"][:, order])
        now, _ = step(now, np.zeros((8, 2)), crowd_velocities(now, scenario.policies))
    assert (now.sight["unseen"] >= 0).sum() > 30


def test_people_who_meet_may_switch_their_tracks():
    # Both turn back where they meet, which no constant velocity foresees.
    found = looks(PERFECT, [[[3.0, h], [3.0, -h]] for h in (0.8, 0.6, 0.4, 0.2, 0.05, 0.2, 0.4, 0.6, 0.8)])
    upper = int(found[0].sight["state"][0, :2, 1].argmax())
    assert [now.sight["state"][0, upper, 1] for now in (found[0], found[-1])] == pytest.approx([0.8, -0.8])
    assert found[-1].sight["identity"].tolist() == found[0].sight["identity"].tolist() == [[0, 1, -1, -1]]


def test_false_tracks_appear_and_die():
    detector = Detector(position=0.0, missed=0.0, false_detections=3.0, spare=40, remember=0.5)
    found = looks(detector, [[[900.0, 900.0]]] * 300)
    shown = np.array([now.sight["unseen"][0] >= 0 for now in found])
    far = np.array([now.sight["state"][0, :, 0] > 800.0 for now in found])
    false = (shown & ~far).sum(axis=1)
    assert 0 < false[20:].mean() < 3.0
    assert (false[20:] == 0).any()
    assert found[-1].sight["born"][0] > 300
    assert (shown & far).sum(axis=1).tolist() == [1] * 300


def test_false_detections_lie_in_the_field_of_view_and_before_walls():
    detector = Detector(missed=0.0, false_detections=4.0, spare=30)
    sensor = Sensor(detector=detector, range=5.0, field_of_view=90.0)
    worlds = world([[0, 0], [900, 0]], rules=Rules(sensor=sensor)).take(np.zeros(500, int))
    worlds = worlds.replace(key=np.arange(500).astype(np.uint64), present=np.zeros((500, 2), bool))
    found, detected = detect(worlds)
    number = np.isfinite(found[..., 0]).sum(axis=1)
    assert number.mean() == pytest.approx(4.0, abs=0.3)
    assert number.var() == pytest.approx(4.0, abs=0.8)
    assert not detected.any()
    points = found[np.isfinite(found[..., 0])][:, :2]
    distance, angle = np.hypot(*points.T), np.degrees(np.arctan2(*points.T[::-1]))
    assert 0.6 <= distance.min() < 1.0
    assert 5.2 < distance.max() <= 5.6
    # Uniform over the area: half of the points lie beyond the radius that halves it.
    assert (distance > np.sqrt((0.6**2 + 5.6**2) / 2)).mean() == pytest.approx(0.5, abs=0.04)
    assert -45.0 <= angle.min() < -43.0 < 43.0 < angle.max() <= 45.0
    hidden = dataclasses.replace(worlds.rules, sensor=sensor.model_copy(update={"occlusion": True}))
    walled, _ = detect(worlds.replace(rules=hidden, obstacles=np.repeat(WALL, 500, axis=0)))
    assert np.nanmax(walled[..., 0]) < 2.4
    assert np.nanmax(found[..., 0]) > 5.0


def test_detections_are_in_the_order_of_their_distance_and_have_one_radius():
    made = world([[0, 0], [5, 0], [2, 0], [3, 3]], rules=Rules(sensor=Sensor(detector=PERFECT)))
    found, detected = detect(made.replace(radius=np.array([[0.3, 0.2, 0.5, 0.4]])))
    assert found[0, :3].tolist() == [[2, 0, 0, 0, 0.3], [3, 3, 0, 0, 0.3], [5, 0, 0, 0, 0.3]]
    assert np.isnan(found[0, 3:]).all()
    assert detected.all()


def test_a_missed_person_continues_and_a_lost_one_is_forgotten():
    path = [[[2.0, -1.0 + 0.25 * t]] for t in range(8)] + [[[900.0, 0.0]]] * 8
    found = looks(PERFECT.model_copy(update={"remember": 0.5}), path, range=10.0)
    ages = [observe(now).pedestrians.age[0, 0] for now in found]
    assert ages == [0.0] * 8 + [0.25, 0.5] + [np.inf] * 6
    lost = observe(found[9]).pedestrians
    assert lost.position[0, 0] == pytest.approx([2.0, 1.25], abs=0.01)
    assert lost.filled[0, :, 0].tolist() == [False] * 6 + [True] * 2


def test_a_new_track_is_confirmed_by_its_second_detection():
    path = [[[900.0, 0.0]]] * 3 + [[[2.0, 1.0]]] * 3
    found = looks(PERFECT, path, range=10.0)
    assert [bool(observe(now).pedestrians.seen.any()) for now in found] == [False] * 4 + [True] * 2
    assert observe(found[3]).pedestrians.history.any() == 0
    assert observe(found[4]).pedestrians.observed.max() == 2
    assert observe(looks(PERFECT, path[3:])[0]).pedestrians.seen.any()  # in the first scan


def test_tracks_are_extrapolated_by_the_delay():
    path = [[[3.0 - 0.25 * t, 1.0]] for t in range(12)]
    found = looks(PERFECT, path, delay=0.5)
    crowd = [observe(now).pedestrians for now in found]
    assert [bool(each.seen.any()) for each in crowd] == [False] * 2 + [True] * 10
    assert crowd[-1].position[0, 0] == pytest.approx([0.25, 1.0], abs=0.02)
    assert crowd[-1].age[0, 0] == 0.5
    assert found[1].sight["detected"].tolist() == [[False]]
    assert found[2].sight["detected"].tolist() == [[True]]


def test_a_measured_velocity_starts_a_track():
    made = world([[0, 0], [3, 0]], [[0, 0], [0.5, -1.0]], rules=Rules(sensor=Sensor(detector=PERFECT)))
    assert observe(look(made)).pedestrians.velocity[0, 0].tolist() == [0.0, 0.0]
    rules = Rules(sensor=Sensor(detector=PERFECT.model_copy(update={"velocity": 0.0})))
    assert observe(look(made.replace(rules=rules))).pedestrians.velocity[0, 0].tolist() == [0.5, -1.0]


def test_raw_detections_have_no_past_and_no_order():
    raw = PERFECT.model_copy(update={"raw": True})
    found = looks(raw, [[[2.0, 0.0], [0.0, 3.0]], [[4.0, 0.0], [0.0, 3.0]]])
    first, second = (observe(now).pedestrians for now in found)
    assert first.position[0, :2].tolist() == [[2.0, 0.0], [0.0, 3.0]]
    assert second.position[0, :2].tolist() == [[0.0, 3.0], [4.0, 0.0]]
    assert second.seen[0].tolist() == [True, True, False, False]
    assert second.observed[0].tolist() == [1, 1, 0, 0]
    assert (second.history[0, :, 1] == [4.0, 0.0]).all()
    assert second.deviation is None


DETECTOR = {"sensor.detector": {}, "sensor.occlusion": True, "sensor.range": 6.0}


@pytest.mark.parametrize("changes", [{}, {"raw": True}, {"velocity": 0.5}])
def test_a_case_has_the_same_tracks_alone_and_in_a_batch(changes):
    options = {"scenario": "circle_crossing_5", "sensor__delay": DT, "sensor__detector": changes}
    many, alone = drive("orca", "val:6", **options), drive("orca", "val/4", **options)
    assert same(many.episode(4), alone.episode(0))


@pytest.mark.slow
def test_a_trace_has_true_people_and_observed_tracks():
    trace = drive("orca", "val:5", "circle_crossing_5", **{key.replace(".", "__"): DETECTOR[key] for key in DETECTOR})
    assert trace.perceived.shape[2] == trace.age.shape[2] == 10
    assert trace.seen.shape[2] == trace.position.shape[2] - 1 == 5
    steps = np.arange(trace.position.shape[1]) <= trace.steps[:, None]
    assert 0.5 < trace.seen[steps].mean() < 0.95
    assert np.array_equal(np.isfinite(trace.age), np.isfinite(trace.perceived[..., 0]))


def test_a_trace_is_stored_and_drawn(tmp_path):
    trace = drive("straight", "val:2", "circle_crossing_5", sensor__detector={"false_detections": 4.0})
    assert "/world/sight" in {chunk.entity_path for chunk in draw_episode(trace, 0, "title", {})}
    moments = [Moment.of_trace(trace, 0, state) for state in range(8)]
    rings = [measured_rings(m.measured, m.position[-1, 1:], m.radius[1:], m.rules.sensor.detector) for m in moments]
    assert sum(map(len, rings)) > 8
    write_tracks(trace, tmp_path / "tracks")
    assert same(read_tracks(tmp_path / "tracks"), trace)


@pytest.mark.slow
@pytest.mark.parametrize("nearest", [None, 3, 7])
def test_environments_have_a_column_for_each_track(nearest):
    scenario = load_scenario("circle_crossing_5", {**DETECTOR, "sensor.nearest": nearest} if nearest else DETECTOR)
    columns = scenario.rules.sensor.columns(5)
    assert columns == (nearest or 10)
    env = VehicleEnv(scenario=scenario)
    shown, _ = env.reset(options={"case": "val/0"})
    for _ in range(6):
        assert shown.shape == (6 * (1 + columns),)
        assert env.observation_space.contains(shown)
        shown, *_ = env.step(np.zeros(2))
    now = scenario.worlds(Cases("val", 0, 2))
    everybody = flatten_everybody(now)
    np.testing.assert_array_equal(everybody[:, 0], flatten(observe(now)))
    assert everybody.shape == (2, 6, 6 * (1 + columns))
    agents = parallel_env(scenario)
    for agent, seen in agents.reset(options={"case": "val/0"})[0].items():
        assert agents.observation_space(agent).contains(seen)


def test_a_privileged_planner_is_refused():
    class Knowing(Planner):
        privileged = True

        def plan(self, obs):
            raise AssertionError

    with pytest.raises(InputError, match=r"Knowing is privileged, but .* leave out sensor.detector$"):
        drive(Knowing(), "val:1", "circle_crossing_5", sensor__detector={}, sensor__nearest=8)


class OwnTracker(Planner):
    """A planner that stands still, and keeps its observations."""

    raw = True

    def __init__(self):
        self.seen = []

    def plan(self, obs):
        self.seen.append(obs)
        return np.zeros((len(obs), 2))


def test_a_planner_that_declares_raw_observes_detections_where_others_observe_tracks():
    options = {"scenario": "circle_crossing_5", "sensor__detector": {}}
    planner, tracked = OwnTracker(), OwnTracker()
    tracked.raw = False
    trace = drive(planner, "val:2", **options)
    same_people = drive(tracked, "val:2", **options)
    assert (trace.position == same_people.position).all(), "people and outcomes do not depend on the observation"
    assert all(obs.pedestrians.deviation is None for obs in planner.seen)
    assert all(obs.pedestrians.deviation is not None for obs in tracked.seen)
    assert (planner.seen[-1].pedestrians.observed <= 1).all(), "detections have no past"
    assert tracked.seen[-1].pedestrians.observed.max() > 1
    explicit = drive(tracked, "val:2", "circle_crossing_5", sensor__detector={"raw": True})
    assert np.array_equal(trace.perceived, explicit.perceived, equal_nan=True)


def test_raw_changes_nothing_without_a_detector():
    scenario = load_scenario("circle_crossing_5")
    assert scenario.without_tracker() is scenario
    realistic = load_scenario("circle_crossing_5", {"sensor.track": "realistic"})
    assert realistic.without_tracker().digest == realistic.digest


def test_runs_of_raw_planners_are_marked_and_compared_with_others(tmp_path):
    overrides = {"sensor.track": "realistic"}
    for name, planner in (("raw", OwnTracker()), ("straight", "straight")):
        run(planner, "circle_crossing_5", "val:6", overrides=overrides, out=tmp_path / name, record="commands")
    run(OwnTracker(), "circle_crossing_5", "val:6", out=tmp_path / "perfect", record="commands")
    table = RunTable.read([tmp_path / "raw", tmp_path / "straight"])
    assert [row[0] for row in table.grid(["success_rate"]).rows] == ["OwnTracker (raw)", "straight"]
    assert compare(tmp_path / "straight", tmp_path / "raw").names == ("straight", "OwnTracker (raw)")
    stored = RunResult.read(tmp_path / "raw")
    trace, _ = stored_case(stored, lambda run: load_scenario("circle_crossing_5", overrides), 3)
    assert trace.rules.sensor.detector.raw
    assert RunResult.read(tmp_path / "perfect").label == "OwnTracker"


@pytest.mark.parametrize("key", ["noise", "missed", "remember"])
def test_errors_of_a_sensor_without_a_detector_are_refused_beside_one(key):
    value = {"position": 0.1} if key == "noise" else 0.5
    with pytest.raises(InputError, match=r"sensor.noise, missed and remember do not go with a detector"):
        load_scenario("circle_crossing_5", {"sensor.detector": {}, f"sensor.{key}": value})


def test_the_rules_with_a_detector_are_read_back_and_others_do_not_name_it():
    rules = Rules(sensor=Sensor(detector=Detector(velocity=0.2, raw=True), range=4.0))
    assert Rules.of_table(rules.to_table()) == rules
    assert "detector" not in Rules(sensor=Sensor(range=4.0)).to_table()["sensor"]
    assert "detector" not in load_scenario("circle_crossing_5").table["sensor"]
