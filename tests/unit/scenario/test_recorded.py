"""Recorded people as the crowd of a scenario: who is where and when, in which cases, and what may be concluded."""

import dataclasses
import json
import math
import sys

import numpy as np
import pytest
import recordings
import trainings
from helpers import Still, same

from crowdbench.catalog import load_planner, load_scenario, simulated_scenarios
from crowdbench.cli import app as cli
from crowdbench.core.geometry import norm
from crowdbench.core.types import HISTORY
from crowdbench.envs.parallel import parallel_env
from crowdbench.networks import card
from crowdbench.planners.driver import Driver
from crowdbench.predict import ConstantVelocity
from crowdbench.results.episodes import Episodes
from crowdbench.runs.loading import load_run
from crowdbench.runs.rollout import rollout
from crowdbench.runs.spec import RunSpec
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.recorded import TrackedCrowd
from crowdbench.scenario.schema import TracksSpec
from crowdbench.scenario.tracks.dut import Car, read_clip
from crowdbench.scenario.tracks.excerpts import MIN_TRIP, cut_windows, split_windows
from crowdbench.scenario.tracks.recorded_tracks import RecordedTracks
from crowdbench.scenario.tracks.scenes import SceneRecording, load_scene
from crowdbench.sim.presence import come_and_go, track_at
from crowdbench.sim.sensor import observe
from crowdbench.sim.simulator import crowd_velocities, step_pedestrians
from crowdbench.train.config import PPOConfig, ValueConfig
from crowdbench.utils.errors import InputError
from studies.social_gan.prediction_errors import on_scenario


@pytest.fixture
def place(tmp_path):
    return recordings.scenario(tmp_path)


def driven(scenario, cases="test:6", planner=None):
    return rollout(Driver(planner or Still(), "still", 60.0), scenario, Cases.parse(cases))


def run(monkeypatch, *words):
    """The exit status of a command, 0 if it ends by itself."""
    monkeypatch.setattr(cli.interrupts, "handle", lambda: None)
    monkeypatch.setattr(cli.watchdog, "enable", lambda: None)  # its process would hold files that tests have open
    monkeypatch.setattr(sys, "argv", ["crowdbench", *map(str, words)])
    try:
        cli.main()
    except SystemExit as end:
        return end.code or 0
    return 0


def test_recorded_people_are_where_they_were_recorded_and_only_then(place):
    trace, changes = driven(place), []
    for row, case in enumerate(trace.case.tolist()):
        window, last = place.tracks.window("test", case), trace.steps[row] + 1
        track = window.track[:last]
        there = np.isfinite(track[..., 0])
        n = track.shape[1]
        shown = trace.position[row, :last, 1 : n + 1]
        # Who would come onto the vehicle comes later.
        late = there & ~trace.present[row, :last, 1 : n + 1]
        assert late.sum() <= 3
        assert (trace.present[row, :last, 1 : n + 1] <= there).all()
        assert np.allclose(shown[there & ~late], track[there & ~late], atol=1e-9)
        assert np.isnan(shown[~there]).all()
        changes.append(len(np.unique(there.sum(axis=1))) > 1)
    assert any(changes)  # they come and go


def test_tracks_are_followed_between_annotations(place):
    window = place.tracks.window("test", 0)
    lines = np.array(recordings.rows())
    walker = int(np.isfinite(window.track[..., 0]).sum(axis=0).argmin())
    each = [lines[lines[:, 1] == person] for person in np.unique(lines[:, 1])]
    soon = [own for own in each if own[-1, 0] / 10 * recordings.DT > window.first]
    own = next(own for own in soon if np.allclose(own[-1, 2:], window.goal[walker]))
    time = window.first + place.rules.dt * np.arange(len(window.track))
    x = np.interp(time, own[:, 0] / 10 * recordings.DT, own[:, 2], left=np.nan, right=np.nan)
    assert np.allclose(window.track[:, walker, 0], x, equal_nan=True)


def test_a_case_of_recorded_people_does_not_depend_on_its_batch(place):
    together = driven(place)
    for case in range(6):
        alone = driven(place, f"test:{case}:{case + 1}")
        fields = ("outcome", "steps", "position", "velocity", "gap", "present", "seen", "goal", "block")
        for name in fields:
            assert np.array_equal(getattr(together, name)[case], getattr(alone, name)[0], equal_nan=True), name


def test_windows_are_as_long_as_an_episode_and_splits_share_no_moment(place):
    spans = {}
    for split, windows in place.tracks.windows.items():
        for window in windows:
            assert len(window.track) == place.rules.max_steps + 1
            spans.setdefault(split, []).append((window.first, window.first + place.rules.max_steps * place.rules.dt))
    assert max(end for _, end in spans["train"]) <= min(start for start, _ in spans["val"]) + 1e-9
    assert max(end for _, end in spans["val"]) <= min(start for start, _ in spans["test"]) + 1e-9
    assert spans["test"][-1][1] <= recordings.SECONDS + 1e-9
    assert len(spans["test"]) == 6  # of 12: each takes 9.25 s


def test_a_recording_that_is_shorter_than_an_episode_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"mine.toml: in tracks, no recording of the scene mine holds people for the"):
        recordings.scenario(tmp_path, time_limit=200.0)


def test_cases_go_through_the_windows_with_other_starts_each_time(place):
    world = place.draw("test", np.arange(12))
    assert place.blocks(Cases.parse("test:12")).tolist() == 2 * [6, 7, 8, 9, 10, 11]
    assert np.array_equal(world.position[:6, 1:], world.position[6:, 1:])
    assert (norm(world.position[:6, 0] - world.position[6:, 0]) > 0.0).all()


def test_the_vehicle_starts_and_goes_where_people_walk_and_nobody_comes_at_once(place):
    walked = np.array(recordings.rows())[:, 2:]
    world = place.draw("test", np.arange(40))
    assert (norm(world.goal[:, 0] - world.position[:, 0]) >= 4.0).all()
    for end in (world.position[:, 0], world.goal[:, 0]):
        assert (norm(end[:, None] - walked).min(axis=1) < 1.0).all()
    soon = world.track[:, :5] - world.position[:, None, :1]
    assert np.nanmin(norm(soon)) >= 0.3 + 0.3 + 0.2


def test_people_who_react_come_and_go_at_the_recorded_times_on_the_recorded_ways(tmp_path):
    place = recordings.scenario(tmp_path, pedestrians__policy="orca", vehicle__visible=True)
    trace = driven(place)
    assert trace.undisturbed is not None
    for row, case in enumerate(trace.case.tolist()):
        window, last = place.tracks.window("test", case), trace.steps[row] + 1
        there, n = np.isfinite(window.track[:last, :, 0]), len(window.radius)
        assert (trace.present[row, :last, 1 : n + 1] <= there).all()
        assert (trace.present[row, :last, 1 : n + 1] == there).mean() > 0.98
        # Whoever has nobody to avoid walks as recorded, but for the speed, which is the mean one.
        apart = norm(trace.position[row, :last, 1 : n + 1] - window.track[:last])
        assert np.nanmedian(apart) < 0.5


def test_shares_of_people_react(tmp_path):
    place = recordings.scenario(tmp_path, pedestrians__policy={"recorded": 0.5, "social_force": 0.5})
    trace, world = driven(place), place.worlds(Cases.parse("test:6"))
    recorded = list(place.policies).index("recorded")
    exact = np.nan_to_num(norm(trace.position[:, :, 1:] - world.track)).max(axis=1) < 1e-9
    assert exact[world.policy == recorded].all()
    assert not exact[(world.policy != recorded) & np.isfinite(world.track[:, 1:10, :, 0]).any(axis=1)].all()


def test_who_would_come_onto_the_vehicle_comes_once_there_is_room(place):
    world = place.draw("test", np.arange(1))
    there = np.isfinite(world.track[0, :, :, 0])
    step, comer = (int(found[0]) for found in np.nonzero(there[1:] & ~there[:-1]))
    step += 1
    while world.step[0] < step - 1:
        world = step_pedestrians(world, crowd_velocities(world, place.policies), place.post_step_rule)
    position = world.position.copy()
    position[0, 0] = world.track[0, step, comer]
    world = world.replace(position=position)
    came = []
    while world.step[0] < step + 6:
        world = step_pedestrians(world, crowd_velocities(world, place.policies), place.post_step_rule)
        came.append(bool(world.present[0, comer + 1]))
    gap = norm(world.track[0, step : step + 7, comer] - position[0, 0]) - 0.6
    assert came == (gap >= 0.0).tolist()
    assert not came[0]
    assert came[-1]


def test_who_comes_has_no_history_before(place):
    world, seen = place.draw("test", np.arange(6)), []
    for _ in range(12):
        obs = observe(world).pedestrians
        since = world.step[:, None] - world.since
        assert np.array_equal(obs.seen, world.present[:, 1:])
        assert np.array_equal(obs.observed[obs.seen], np.minimum(since + 1, HISTORY)[obs.seen])
        new = obs.seen & (since == 0)
        first = np.broadcast_to(obs.position[:, None], obs.history.shape)
        assert np.array_equal(obs.history.swapaxes(1, 2)[new], first.swapaxes(1, 2)[new])
        seen.append(new.any())
        world = step_pedestrians(world, crowd_velocities(world, place.policies), place.post_step_rule)
    assert any(seen[1:])


def test_nothing_is_recorded_after_the_last_step(place):
    world = place.draw("test", np.arange(2))
    assert np.isnan(track_at(world, np.full(2, place.rules.max_steps + 1))).all()
    ended = come_and_go(world.replace(step=np.full(2, place.rules.max_steps + 1)), np.ones(2, bool))
    assert not ended.present[:, 1:].any()


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"layout__generator": "room"}, "unknown key layout; the keys here are .* pedestrians, tracks"),
        ({"pedestrians__number": 3}, "unknown key pedestrians.number; the keys here are policy"),
        ({"pedestrians__preferred_speed": 1.0}, "unknown key pedestrians.preferred_speed; the keys here are policy"),
        ({"crowdnav_cases": 500}, "unknown key crowdnav_cases; the keys here are"),
        ({"tracks__scene": "yours"}, "in tracks, .* has no file yours.txt, which the scene yours needs"),
        ({"tracks__scene": "eth"}, "in tracks, .* has no file biwi_eth.txt, which the scene eth needs"),
        ({"tracks__distance": 90.0}, "in case test/0, the vehicle has no room .* lower tracks.distance"),
        ({"tracks__files": {"mine.txt": "0" * 64}}, r"mine.txt is damaged or another version: its sha256 is .* 0000"),
    ],
)
def test_what_is_wrong_with_recorded_people_is_told(tmp_path, changes, sentence):
    with pytest.raises(InputError, match=sentence):
        recordings.scenario(tmp_path, **changes).draw("test", np.arange(1))


def test_a_folder_that_is_not_given_or_not_there_is_told(tmp_path):
    with pytest.raises(InputError, match=r"^eth_recorded.toml: in tracks, .* give the folder that holds them, --data"):
        load_scenario("eth_recorded")
    with pytest.raises(InputError, match=r"in tracks, there is no folder .*nowhere with the recorded tracks"):
        load_scenario("eth_recorded", data=tmp_path / "nowhere")
    with pytest.raises(InputError, match=r"pedestrians.policy is recorded, but must be another policy, or there must"):
        load_scenario("circle_crossing_5", {"pedestrians.policy": "recorded"})


def test_scenarios_of_recorded_people_can_be_listed_without_their_data(monkeypatch, capsys):
    assert not {"eth_recorded", "eth_reactive", "dut_recorded", "dut_reactive"} & set(simulated_scenarios())
    assert run(monkeypatch, "list", "scenarios", "dut_recorded") == 0
    assert 'scene = "dut"' in capsys.readouterr().out


def test_a_run_says_its_blocks_and_can_be_replayed_with_the_same_files_alone(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    file = recordings.write(tmp_path)
    words = ["run", "--planner", "straight", "--scenario", file, "--data", tmp_path, "--cases", 12, "--record", "all"]
    assert run(monkeypatch, *words, "--out", "one") == 0
    said = capsys.readouterr().out
    assert "over the 6 blocks of recorded time" in said
    assert "Recorded pedestrians do not react" in said
    result = json.loads((tmp_path / "one" / "result.json").read_text())
    assert result["blocks"] == 6
    assert list(result["scenario"]["tracks"]["files"]) == ["mine.txt"]
    assert Episodes.read(tmp_path / "one" / "episodes.csv").block.tolist() == 2 * [6, 7, 8, 9, 10, 11]
    assert run(monkeypatch, "score", "one", "--data", tmp_path) == 0
    assert "12 cases were simulated again from their commands" in capsys.readouterr().out
    rows = (tmp_path / "one" / "episodes.csv").read_text()
    (tmp_path / "one" / "episodes.csv").write_text(rows.replace(",6,", ",7,", 1))
    assert run(monkeypatch, "score", "one", "--data", tmp_path) == 1
    assert "episodes.csv is not the file that the run wrote" in capsys.readouterr().err
    (tmp_path / "one" / "episodes.csv").write_text(rows)
    assert run(monkeypatch, "score", "one") != 0
    assert "--data DIR" in capsys.readouterr().err
    text = (tmp_path / "mine.txt").read_text()
    (tmp_path / "mine.txt").write_text(text.replace("0.500000", "0.500001", 1))
    assert run(monkeypatch, "score", "one", "--data", tmp_path) != 0
    assert "mine.txt is damaged or another version" in capsys.readouterr().err


def test_runs_in_batches_and_parts_are_the_same(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    file = recordings.write(tmp_path)
    words = ["run", "--planner", "straight", "--scenario", file, "--data", tmp_path, "--cases", 12]
    assert run(monkeypatch, *words, "--out", "whole") == 0
    assert run(monkeypatch, *words, "--out", "parts", "--batch", 5) == 0
    whole, parts = ((tmp_path / name / "episodes.csv").read_text() for name in ("whole", "parts"))
    assert whole == parts


def test_recorded_people_are_no_agents_and_observations_are_within_their_space(tmp_path):
    for policy in ("recorded", "orca"):
        env = parallel_env(recordings.scenario(tmp_path, pedestrians__policy=policy))
        observations, _ = env.reset(seed=3)
        assert env.possible_agents == ["vehicle"]
        moved = []
        while env.agents:
            assert env.observation_space("vehicle").contains(observations["vehicle"])
            moved.append(observations["vehicle"])
            observations, *_ = env.step({"vehicle": np.zeros(2)})
        assert (np.ptp(np.array(moved), axis=0) > 0.0).any()


@pytest.fixture(scope="module")
def crossing():
    """A clip in which a car drives 20 m in 10 s past somebody who stands, and another car is parked."""
    frame = np.arange(240)
    tracks = RecordedTracks("clip", 10 * frame, np.zeros(240, int), np.tile([10.0, 5.0], (240, 1)), 1.0 / 24.0)
    time = frame / 24.0
    car = Car(time, np.stack([2.0 * time, np.zeros(240)], axis=1), np.zeros(240), 4.0, 1.6)
    parked = Car(time, np.tile([10.0, -4.0], (240, 1)), np.full(240, np.pi / 2), 4.0, 1.6)
    return [SceneRecording(tracks, (car, parked))]


def test_the_vehicle_takes_the_place_of_a_recorded_car(crossing, tmp_path):
    place = recordings.scenario(tmp_path)
    rules = dataclasses.replace(place.rules, time_limit=4.75)
    crowd = TrackedCrowd.of("clip", crossing, 8.0, rules)
    assert {split: len(windows) for split, windows in crowd.windows.items()} == {"train": 0, "val": 0, "test": 2}
    window = crowd.window("test", 1)
    assert np.allclose(window.replaced_car.start, [8.0, 0.0])
    assert np.allclose(window.replaced_car.goal, [8.0 + 2.0 * 0.75 * 4.0, 0.0])
    assert window.replaced_car.speed == pytest.approx(2.0)
    assert math.dist(window.replaced_car.goal, window.replaced_car.start) >= MIN_TRIP
    # Somebody who stands, and three discs that lie along the parked car.
    assert np.allclose(window.track[0], [[10.0, 5.0], [10.0, -5.2], [10.0, -4.0], [10.0, -2.8]])
    assert np.allclose(window.radius[1:], 0.8)
    with pytest.raises(InputError, match="there is no case test/2: the scene clip has no more windows of time than"):
        crowd.window("test", 2)


@pytest.mark.parametrize(("config_of", "network"), [(ValueConfig, "cadrl"), (PPOConfig, "ppo")])
def test_networks_learn_among_recorded_people(config_of, network, tmp_path):
    file = recordings.write(tmp_path)
    config = config_of(network=network, scenario=str(file), validation=str(file), data=str(tmp_path))
    training = trainings.start(config)
    place = training.scenario
    assert place.tracks.scene == training.validation[0].tracks.scene == "mine"
    assert f"--scenario {file} --data {tmp_path.name}" in config.command
    table = {"name": place.name, **place.table}
    assert card.crowd(table) == "mine, people of mine"
    assert card.episodes([table]) == "simulated episodes with the recorded tracks of mine"
    with pytest.raises(InputError, match="--data does not go with circle_crossing_5, which has no table"):
        trainings.start(dataclasses.replace(config, scenario="circle_crossing_5", validation=None))
    with pytest.raises(InputError, match="give the folder that holds them, --data DIR"):
        trainings.start(dataclasses.replace(config, data=None, validation=None))


def test_predictors_are_measured_on_those_who_come_later_too_by_networks_that_have_not_seen_the_scene(place):
    asked = []

    class Trained(ConstantVelocity):
        def for_held_out_scene(self, scene):
            asked.append(scene)
            return Moved()

    class Moved(ConstantVelocity):
        def predict(self, obs, steps):
            seen.append(obs.pedestrians.seen.copy())
            return super().predict(obs, steps)

    seen = []
    cases = Cases.parse("test:6")
    found = on_scenario("mine", Trained(), place, cases, ahead=2)
    assert asked == ["mine"]
    late = ~seen[0] & np.any(seen, axis=0)
    assert late.any()
    window = place.worlds(cases)
    assert window.rules.max_steps == len(seen)
    # They walk on sine waves of half a metre and 1.5 m/s.
    assert 0.0 < found.first.ade[0].mean < 0.05
    assert found.first.fde[1].n == len(np.unique(place.blocks(cases)))


def test_a_clip_of_dut_is_read_in_metres_with_y_upwards(tmp_path):
    header = "id,frame,x_est,y_est"
    corners = [f"{axis}_{corner}" for corner in ("fl", "fr", "rr", "rl") for axis in "xy"]
    (tmp_path / "a_ratio_pixel2meter.txt").write_text("20.0")
    (tmp_path / "a_traj_ped_filtered.csv").write_text(f",{header}\n0,3,24,40.0,60.0\n1,3,25,42.0,60.0\n")
    # The image's y points down: a car that drives up in it has its left side at a smaller x.
    place = "80,20,116,20,116,100,80,100"
    (tmp_path / "a_traj_veh_filtered.csv").write_text(f"{header},{','.join(corners)}\n0,24,98,60,{place}\n")
    tracks, (car,) = read_clip(tmp_path, "a")
    assert np.allclose(tracks.position, [[2.0, -3.0], [2.1, -3.0]])
    assert tracks.dt == pytest.approx(1 / 23.98)
    assert (car.length, car.width) == pytest.approx((4.0, 1.8))
    assert car.heading[0] == pytest.approx(np.pi / 2)
    (tmp_path / "a_traj_ped_filtered.csv").write_text(f"{header}\n3,24,40.0,?\n")
    with pytest.raises(InputError, match=r"a_traj_ped_filtered.csv is no table with columns id, frame, x_est, y_est"):
        read_clip(tmp_path, "a")


def test_a_planner_is_asked_for_the_networks_that_have_not_seen_the_scene():
    planner = load_planner("sarl_sgan")
    elsewhere, own = planner.for_held_out_scene("eth"), planner.for_held_out_scene("mine")
    assert elsewhere.facts["predictor_weights"] != planner.facts["predictor_weights"]
    assert "eth" not in elsewhere.predictor.about["scenes"]
    assert own.facts == planner.facts
    assert load_planner("straight").for_held_out_scene("eth").facts == {}


@pytest.mark.slow
def test_every_scene_of_eth_ucy_and_dut_can_be_driven_in(shared):
    for scene in ("eth", "hotel", "univ", "zara1", "zara2"):
        place = load_scenario("eth_recorded", {"tracks.scene": scene}, data=shared / "data" / "eth_ucy")
        number = sum(map(len, place.tracks.windows.values()))
        assert number == {"eth": 19, "hotel": 28, "univ": 15, "zara1": 14, "zara2": 17}[scene]
        place.draw("test", np.arange(number // 2))
    place = load_scenario("dut_recorded", data=shared / "data" / "dut")
    assert {split: len(windows) for split, windows in place.tracks.windows.items()} == {
        "train": 12,
        "val": 3,
        "test": 21,
    }
    world = place.draw("test", np.arange(21))
    assert (norm(world.goal[:, 0] - world.position[:, 0]) >= MIN_TRIP - 1e-9).all()
    reactive = load_scenario("dut_reactive", data=shared / "data" / "dut").draw("test", np.arange(21))
    assert list(reactive.parameters) == ["orca", "recorded"]
    assert set(reactive.policy[reactive.present[:, 1:]]) == {0, 1}, "some are people, some are cars"
    assert [place.tracks.most_cases(split) for split in ("train", "val", "test")] == [None, 3, 21]


def test_a_run_on_eth_uses_the_network_that_has_not_seen_it(shared):
    spec = RunSpec("sarl_sgan", "eth_recorded", Cases.parse("1"), data=shared / "data" / "eth_ucy")
    planner = load_planner("sarl_sgan")
    assert load_run(spec).driver.facts == planner.for_held_out_scene("eth").facts


def test_the_splits_of_windows_keep_blocks_together(shared):
    found = cut_windows(load_scene(TracksSpec(scene="dut"), shared / "data" / "dut")[0], 25, 0.25)
    splits = split_windows(found)
    names = [{window.recording for window in windows} for windows in splits.values()]
    assert not names[0] & names[1]
    assert not names[1] & names[2]
    assert not names[0] & names[2]
    assert [window.block for window in found] == sorted(window.block for window in found)


def test_episodes_that_are_read_back_are_the_same(place):
    assert same(driven(place), driven(place))
