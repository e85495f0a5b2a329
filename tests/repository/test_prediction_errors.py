import dataclasses
import json
import re

import numpy as np
import pytest
from typer.testing import CliRunner

from crowdbench import load_scenario
from crowdbench.cli.app import build_script
from crowdbench.predict.linear import ConstantVelocity, ConstantVelocitySampled, Linear, Oracle
from crowdbench.predict.predictor import Prediction, Predictor
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.tracks.recorded_tracks import RecordedTracks
from crowdbench.sim.simulator import crowd_velocities, step_pedestrians
from crowdbench.utils.errors import InputError
from studies.social_gan import prediction_errors
from studies.social_gan.evaluate import evaluate_predictor
from studies.social_gan.horizons import HORIZON
from studies.social_gan.prediction_errors import MEAN, displacement, on_scenario, on_tracks
from studies.social_gan.recordings import read_folder

CASES = Cases.parse("val:6")
FIRST, TOGETHER, EACH = range(3)


class Off(Predictor):
    """Stands still, and is off by what a function of the observation says, `[world, mode, time, pedestrian]`."""

    def __init__(self, off):
        self.off = off

    def predict(self, obs, steps):
        off = self.off(obs)
        position = obs.pedestrians.position[:, None, None] + np.stack([off, np.zeros_like(off)], axis=-1)
        return Prediction(position, np.zeros_like(position))


def recording(frames, name="mine", step=0.0):
    """Pedestrians who are there for so many frames, moving so many metres in each."""
    rows = [(10 * t, p, step * t, p) for p, own in enumerate(frames) for t in range(own)]
    frame, pedestrian, x, y = np.array(rows).T
    return RecordedTracks(name, frame.astype(int), pedestrian.astype(int), np.stack([x, y], axis=1))


def means(estimates):
    return [estimate.mean for estimate in estimates]


def displacement_slowly(position, truth, counted):
    worlds, modes, steps, pedestrians, _ = position.shape
    found = np.zeros((worlds, pedestrians, 3, 2, steps))
    for w in range(worlds):
        for step in range(steps):
            errors = [
                np.linalg.norm(position[w, :, : step + 1] - truth[w, : step + 1], axis=-1).mean(axis=1),
                np.linalg.norm(position[w, :, step] - truth[w, step], axis=-1),
            ]
            for measure, of_mode in enumerate(errors):
                best = min(range(modes), key=lambda mode, own=of_mode: own[mode, counted[w]].sum())
                found[w, :, FIRST, measure, step] = of_mode[0]
                found[w, :, TOGETHER, measure, step] = of_mode[best]
                found[w, :, EACH, measure, step] = [min(of_mode[:, p]) for p in range(pedestrians)]
    return found


@pytest.mark.parametrize(("modes", "pedestrians"), [(1, 3), (20, 1), (20, 6), (3, 0)])
def test_first_together_and_each_are_what_a_slow_version_finds(modes, pedestrians):
    generator = np.random.default_rng(modes)
    position, truth = (generator.normal(size=(4, *shape, pedestrians, 2)) for shape in ((modes, 5), (5,)))
    counted = generator.random((4, pedestrians)) < 0.7
    found = displacement(Prediction(position, position), truth, counted)
    np.testing.assert_allclose(found, displacement_slowly(position, truth, counted))
    order = generator.permutation(pedestrians)
    moved = position[..., order, :]
    other = displacement(Prediction(moved, moved), truth[:, :, order], counted[:, order])
    np.testing.assert_allclose(other, found[:, order])


class LeaveOneOut(ConstantVelocity):
    """Is off by as many metres as the scene's name has letters."""

    def for_held_out_scene(self, scene):
        return Off(lambda obs: np.full((len(obs), 1, HORIZON, obs.pedestrians.seen.shape[1]), float(len(scene))))


def test_each_scene_is_scored_by_the_predictor_that_has_not_seen_it():
    found = on_tracks("mine", LeaveOneOut(), [recording([16, 16], "one"), recording([16, 16], "three")])
    assert [found[scene].first.fde[0].mean for scene in ("one", "three")] == [3.0, 5.0]


def test_more_steps_ahead_take_longer_windows():
    found = on_tracks("cvm", ConstantVelocity(), [recording([21, 22], step=1.0)], ahead=12)["mine"]
    assert len(found.first.ade) == len(found.each.fde) == 12
    with pytest.raises(InputError, match="the same 20 consecutive frames"):
        on_tracks("cvm", ConstantVelocity(), [recording([19, 19])], ahead=12)


def test_each_pedestrian_of_each_window_weighs_the_same():
    # Pedestrian 0 is in windows 0, 1 and 2, pedestrian 1 too (alone it makes none), pedestrian 2 in window 0.
    number = Off(lambda obs: np.repeat(obs.pedestrians.position[:, None, None, :, 1], HORIZON, axis=2))
    found = on_tracks("number", number, [recording([18, 19, 16])])["mine"]
    assert means(found.first.ade) == pytest.approx([(3 * 0 + 3 * 1 + 1 * 2) / 7] * HORIZON)
    assert (found.first.fde[0].n, found.first.fde[0].max) == (3, 2.0)


def test_windows_of_one_pedestrian_are_no_independent_samples():
    number = Off(lambda obs: np.repeat(obs.pedestrians.position[:, None, None, :, 1], HORIZON, axis=2))
    found = on_tracks("number", number, [recording([200, 200])])["mine"].first.fde[0]
    assert (found.mean, found.low, found.high, found.n) == (0.5, 0.0, 1.0, 2)


def test_each_scene_weighs_the_same_in_the_mean():
    step = Off(lambda obs: np.arange(8.0)[:, None] * obs.pedestrians.seen[:, None, None])
    found = on_tracks("step", step, [recording([16, 16], "one"), recording([30, 30, 30], "two", step=1.0)])
    assert list(found) == ["one", "two", MEAN]
    assert means(found["one"].first.fde) == pytest.approx(np.arange(8.0))
    assert means(found["one"].first.ade) == pytest.approx(np.arange(8.0) / 2)
    assert means(found["two"].first.fde) == pytest.approx(np.ones(8))
    assert means(found[MEAN].first.fde) == pytest.approx((np.arange(8.0) + 1) / 2)


def slowly(predict, scenario, cases, ahead):
    """ADE and FDE `[ahead]`: one pedestrian after the other, until it comes near its goal."""
    world = scenario.worlds(cases)
    moving = world.replace(rules=dataclasses.replace(world.rules, visible=False))
    positions, errors = [moving.position], []
    for _ in range(scenario.rules.max_steps):
        moving = step_pedestrians(moving, crowd_velocities(moving, scenario.policies), scenario.post_step_rule)
        positions.append(moving.position)
    track = np.stack(positions, axis=1)[:, :, 1:]
    for w in range(len(world)):
        for p in np.flatnonzero(world.present[w, 1:]):
            own, goal, radius = track[w, :, p], world.goal[w, p + 1], world.radius[w, p + 1]
            for t in range(len(own) - ahead):
                if np.linalg.norm(own[t] - goal) < radius:
                    break
                distance = np.linalg.norm(predict(own[: t + 1], ahead) - own[t + 1 : t + 1 + ahead], axis=1)
                errors.append([distance.cumsum() / np.arange(1, ahead + 1), distance])
    return np.mean(errors, axis=0)


def last_velocity(track, steps):
    moved = track[-1] - track[-2] if len(track) > 1 else np.zeros(2)
    return track[-1] + np.arange(1, steps + 1)[:, None] * moved


def fitted_line(track, steps):
    track = track[-8:]
    if len(track) == 1:
        return np.repeat(track, steps, axis=0)
    ahead = np.arange(len(track), len(track) + steps)
    return np.stack([np.polyval(np.polyfit(np.arange(len(track)), own, 1), ahead) for own in track.T], axis=1)


@pytest.mark.parametrize(
    ("predictor", "predict", "ahead"), [(ConstantVelocity(), last_velocity, 12), (Linear(), fitted_line, HORIZON)]
)
def test_on_a_scenario_all_who_are_on_their_way_count_at_every_step(predictor, predict, ahead):
    scenario = load_scenario("circle_crossing_5_visible", {"pedestrians.number": [2, 5]})
    found = on_scenario("mine", predictor, scenario, CASES, ahead)
    ade, fde = slowly(predict, scenario, CASES, ahead)
    np.testing.assert_allclose(means(found.first.ade), ade)
    np.testing.assert_allclose(means(found.first.fde), fde)
    assert found.first.ade[0].n == len(CASES)


@pytest.mark.parametrize("predictor", [Linear(), ConstantVelocitySampled()])
def test_batches_do_not_matter(predictor, monkeypatch):
    scenario = load_scenario("circle_crossing_5")
    tracks = [recording([20, 40, 30, 30], step=0.5)]
    on_crowd, on_street = on_scenario("any", predictor, scenario, CASES), on_tracks("any", predictor, tracks)["mine"]
    monkeypatch.setattr(prediction_errors, "BATCH", 4)
    told = []
    assert on_scenario("any", predictor, scenario, CASES, progress=told.append) == on_crowd
    assert told == [4, 2]
    parts = on_tracks("any", predictor, tracks)["mine"]
    for choice, curves in on_street.choices().items():
        np.testing.assert_allclose(means(parts.choices()[choice].fde), means(curves.fde))


def test_the_oracle_is_right_for_one_step():
    found = on_scenario("oracle", Oracle(), load_scenario("circle_crossing_5"), CASES)
    assert found.first.fde[0].max < 1e-12
    assert found.first.fde[1].mean > 1e-3


@pytest.mark.slow
def test_the_errors_on_eth_ucy_are_the_known_ones(shared):
    recordings = read_folder(shared / "data" / "eth_ucy")
    constant = on_tracks("cvm", ConstantVelocity(), recordings)
    linear = on_tracks("linear", Linear(), recordings)
    assert list(constant) == ["eth", "hotel", "univ", "zara1", "zara2", MEAN]
    assert round(constant[MEAN].first.ade[7].mean, 3) == 0.339
    assert round(linear[MEAN].first.ade[7].mean, 3) == 0.460
    assert [round(found.first.ade[7].mean, 2) for found in constant.values()] == [0.67, 0.26, 0.31, 0.25, 0.21, 0.34]


def raises(obs):
    raise ZeroDivisionError("nothing there")


@pytest.mark.parametrize(
    ("off", "expected"),
    [
        (raises, "predictor mine raised ZeroDivisionError: nothing there"),
        (lambda obs: np.zeros((len(obs), 1, 7, 5)), r"of shape \[6, 1, 7, 5, 2\], but they must be \[world, mode"),
        (lambda obs: np.full((len(obs), 1, 8, 5), np.nan), "returned positions that are not finite"),
        (lambda obs: obs.true_next(), r"raised PermissionError: true_next\(\)"),
    ],
)
def test_a_broken_predictor_is_told_in_one_sentence(off, expected):
    with pytest.raises(InputError, match=expected):
        on_scenario("mine", Off(off), load_scenario("circle_crossing_5"), CASES)


def test_where_nothing_can_be_predicted_it_is_told():
    short = load_scenario("circle_crossing_5", {"time_limit": 2.0})
    with pytest.raises(InputError, match="circle_crossing_5 has nothing to predict in cases val:0:6"):
        on_scenario("cvm", ConstantVelocity(), short, CASES)
    with pytest.raises(InputError, match="the recording mine has no window"):
        on_tracks("cvm", ConstantVelocity(), [recording([15, 15])])
    with pytest.raises(InputError, match="for training only"):
        on_tracks("cvm", ConstantVelocity(), [recording([20, 20], "uni_examples")])
    with pytest.raises(InputError, match="predictor oracle is privileged"):
        on_tracks("oracle", Oracle(), [recording([20, 20])])


def evaluate(*arguments):
    return CliRunner().invoke(build_script(evaluate_predictor), arguments, catch_exceptions=False)


def test_the_command_prints_a_column_for_every_scene_and_json_has_every_horizon(tmp_path):
    rows = [(10 * t, p, 0.5 * t if p else 0.0, p) for p in range(2) for t in range(20)]
    (tmp_path / "street.txt").write_text("\n".join("\t".join(map(str, row)) for row in rows))
    shown = evaluate("constant_velocity", "--data", str(tmp_path))
    assert shown.exit_code == 0, shown.stderr
    title, header, row = shown.stdout.splitlines()[:3]
    assert title == f"ADE / FDE in metres, 8 steps of 0.4 s ahead, on {tmp_path}"
    assert header.split() == ["predictor", "street", *MEAN.split()]
    assert row.split() == ["constant_velocity", "best", "of", "1", "0.000", "/", "0.000", "0.000", "/", "0.000"]
    told = evaluate("linear", "--cases", "val:5", "--set", "vehicle.visible=true", "--json")
    result = json.loads(told.stdout)
    place = load_scenario("circle_crossing_5", {"vehicle.visible": True})
    found = on_scenario("linear", Linear(), place, Cases.parse("val:5"))
    errors = result["predictors"]["linear"]["errors"]["circle_crossing_5"]
    assert [step["mean"] for step in errors["first"]["ade"]] == means(found.first.ade)
    assert (list(result["predictors"]), result["cases"], result["dt"]) == (["linear"], "val:0:5", 0.25)
    assert result["overrides"] == {"vehicle.visible": True}


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["linear", "oracle", "--option", "modes=3"], "--option does not go with 2 predictors"),
        (["linear", "--data", "nowhere"], "there is no folder nowhere"),
        (["linear", "--data", ".", "--set", "dt=1"], "--set goes with --scenario only"),
    ],
)
def test_the_command_answers_bad_input_with_one_sentence(arguments, expected):
    with pytest.raises(InputError, match=f"^{re.escape(expected)}") as refused:
        evaluate(*arguments)
    assert "\n" not in str(refused.value)
