"""The score of pedestrian models: windows, rollouts, likelihoods, references, and what leads."""

import csv
import dataclasses
import io
import json
import math
import os
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from crowdbench.cli.app import build_script
from crowdbench.scenario.tracks.dut import Car
from crowdbench.scenario.tracks.recorded_tracks import FRAME_STEP, RecordedTracks
from crowdbench.utils.errors import InputError
from studies import people as definitions
from studies.people.cars import (
    DISCS,
    EVERY,
    FRAMES,
    MOVING,
    NEAR_CAR,
    cut_with_cars,
    discs_of,
    rim_distance,
    time_to_collision,
)
from studies.people.closeness import measure, seconds_close
from studies.people.encounters import NEAR, closest_approach
from studies.people.features import BINS, CONTACT, RANGES, bins_of, per_frame
from studies.people.groups import APART, DRIFT, TOGETHER, find_groups
from studies.people.likelihood import FARTHEST, THIRDS, UNIFORM, score, score_window
from studies.people.references import random_walkers, recording_with_noise, resampled_motion
from studies.people.run import people
from studies.people.simulate import ROLLOUTS, population_options, simulate
from studies.people.summary import compare, summarize
from studies.people.traffic import score_traffic, simulate_traffic, with_discs
from studies.people.windows import BEYOND, CONFLICT, FUTURE, HISTORY, cut, read_windows

DT = 0.4
STATES = HISTORY + FUTURE + 1


def recording(*paths, name="mine"):
    """A recording of paths `[time, 2]`; absent where NaN."""
    rows = [
        (FRAME_STEP * t, person, *point)
        for person, path in enumerate(paths)
        for t, point in enumerate(np.asarray(path, float))
        if np.isfinite(point[0])
    ]
    frame, person, x, y = np.array(rows).T
    return RecordedTracks(name, frame.astype(int), person.astype(int), np.stack([x, y], axis=1))


def walk(start, velocity, frames=STATES, first=0):
    path = np.array(start, float) + DT * np.arange(frames)[:, None] * np.array(velocity, float)
    path[:first] = np.nan
    return path


def crossings(seed=0, windows=6, name="mine"):
    """Windows in which four persons meet in the middle of the future."""
    random, found = np.random.default_rng(seed), []
    for number in range(windows):
        speed = random.uniform(0.9, 1.4, 4)
        angle = np.pi / 2 * np.arange(4) + random.uniform(-0.3, 0.3, 4)
        ahead = np.stack([np.cos(angle), np.sin(angle)], axis=1) * speed[:, None]
        starts = -6.0 * ahead + random.uniform(-0.2, 0.2, (4, 2))
        found += cut(recording(*map(walk, starts, ahead), name=f"{name}{number}"))
    return found


def recorded_by(policy, windows, options=None):
    """The windows with a rollout of a policy as the recording."""
    remade = []
    for window, places in zip(windows, simulate(policy, windows, options, rollouts=1), strict=True):
        paths = np.concatenate([window.position[:HISTORY], places[0]]).swapaxes(0, 1)
        remade += cut(recording(*paths, name=window.name))
    return remade


def v3(policy, windows, options=None):
    return summarize(score(windows, simulate(policy, windows, options)))["v3"].value


def test_futures_follow_each_other_and_have_the_history_before():
    tracks = recording(walk((0, 0), (1, 0), HISTORY + 2 * FUTURE + 1))
    first, second = cut(tracks)
    assert first.position.shape == (STATES, 1, 2)
    assert first.future[-1, 0] == pytest.approx(second.future[0, 0])
    assert (first.number, second.number, first.case == second.case) == (0, 1, False)


def test_persons_count_if_they_are_there_for_the_history_and_two_seconds():
    leaves = walk((0, 9), (1, 0))
    leaves[HISTORY + 5 :] = np.nan
    (window,) = cut(recording(walk((0, 0), (1, 0)), walk((0, 5), (1, 0), first=1), leaves))
    assert window.scored.tolist() == [True, False, False]


def test_gaps_of_a_track_are_linear_in_between():
    path = walk((0, 0), (1, 0.5))
    whole = cut(recording(path))[0]
    path[7:9] = np.nan
    assert cut(recording(path))[0].position == pytest.approx(whole.position)


def test_speed_velocity_and_goals_come_from_the_history():
    path = walk((0, 0), (1, 0), 60)
    path[HISTORY + 1 :, 1] = DT * np.arange(60 - HISTORY - 1)
    window = cut(recording(path))[0]
    assert window.speed == pytest.approx([1.0])
    assert window.velocity[0] == pytest.approx([1.0, 0.0])
    end = path[-1] - window.first[0]
    shown = path[-1] + BEYOND * end / np.hypot(*end)
    assert window.goals(hidden=False)[0] == pytest.approx(shown)
    assert window.goals(hidden=True)[0] == pytest.approx([HISTORY * DT + FUTURE * DT + BEYOND, 0.0])


def test_later_persons_have_the_speed_and_velocity_of_their_first_steps():
    (window,) = cut(recording(walk((0, 0), (1, 0)), walk((0, 5), (0.5, 0), first=HISTORY + 3)))
    assert window.speed[1] == pytest.approx(0.5)
    assert window.velocity[1] == pytest.approx([0.5, 0.0])
    assert window.first[1] == pytest.approx([0.5 * DT * (HISTORY + 3), 5.0])


def test_groups_walk_together_for_four_seconds():
    position = np.stack(
        [walk((0, 0), (1, 0)), walk((0, 1), (1, 0)), walk((0, 2.2), (1, 0)), walk((0, -1), (-1, 0))], axis=1
    )
    assert find_groups(position).tolist() == [0, 0, 0, 1]
    position[9:, 1] = np.nan
    assert len(set(find_groups(position).tolist())) == 4


def test_conflicts_are_with_strangers_who_are_apart():
    meeting = walk((0, 0), (1, 0)), walk((10, 0.3), (-1, 0))
    assert cut(recording(*meeting))[0].conflict.tolist() == [True, True]
    assert cut(recording(meeting[0], walk((10, 0.7), (-1, 0))))[0].conflict.tolist() == [False, False]
    assert cut(recording(meeting[0], walk((0, 0.5), (1, 0))))[0].conflict.tolist() == [False, False], "a group"


def closest_slowly(places, strangers, person):
    """The closest approach by a fine sampling of each step."""
    found = []
    for rollout in places:
        least = math.inf
        for other in range(rollout.shape[1]):
            apart = rollout[:, other] - rollout[:, person]
            there = np.flatnonzero(np.isfinite(apart[:, 0]))
            if not strangers[person, other] or not len(there) or np.hypot(*apart[there[0]]) <= NEAR:
                continue
            least = min(least, *np.hypot(*apart[there].T))
            for t in there[:-1]:
                if t + 1 in there:
                    share = np.linspace(0.0, 1.0, 1001)[:, None]
                    least = min(least, np.hypot(*((1 - share) * apart[t] + share * apart[t + 1]).T).min())
        found.append(least)
    return found


def test_closest_approaches_equal_a_slow_reference():
    random = np.random.default_rng(0)
    places = np.cumsum(random.normal(size=(3, 21, 6, 2)), axis=1) + 3.0 * random.normal(size=(3, 1, 6, 2))
    places[:, :4, 1], places[:, 9:, 2], places[:, 1:, 3], places[:, :9, 4] = np.nan, np.nan, np.nan, np.nan
    strangers = ~np.eye(6, dtype=bool)
    strangers[0, 5] = strangers[5, 0] = False
    found = closest_approach(places, strangers, np.ones(6, bool))
    for person in range(6):
        assert found[:, person] == pytest.approx(closest_slowly(places, strangers, person), abs=2e-3)


def log_slowly(samples, truth, feature):
    """The log-likelihood of a value among samples, by the definition's words."""
    low, high = RANGES[feature]
    shares = [0.0] * (BINS + 1)

    def bin_of(value):
        return BINS if not math.isfinite(value) else min(max(int((value - low) // ((high - low) / BINS)), 0), BINS - 1)

    for sample in samples:
        place = bin_of(sample)
        for other, part in ((place - 1, 0.25), (place, 0.5), (place + 1, 0.25)):
            shares[place if place == BINS else min(max(other, 0), BINS - 1)] += part / len(samples)
    return math.log(0.95 * shares[bin_of(truth)] + 0.05 / 21)


def score_slowly(window, places):
    """The mean log-likelihoods of the thirds, person by person and frame by frame."""
    simulated, truth = per_frame(window, places), per_frame(window, window.future[None])
    thirds = {third: [] for third in THIRDS}
    for person in np.flatnonzero(window.scored):
        frames = [t for t in range(FUTURE) if window.present[t + 1, person]]
        for third in ("motion", "path"):
            logs = [
                np.mean(
                    [
                        log_slowly(
                            simulated[name][:, [f for f in frames if f // 5 == t // 5], person].ravel(),
                            truth[name][0, t, person],
                            name,
                        )
                        for t in frames
                    ]
                )
                for name in THIRDS[third]
            ]
            thirds[third].append(np.mean(logs))
        if window.conflict[person]:
            near = closest_slowly(places, window.strangers, person)
            nearest = closest_slowly(window.future[None], window.strangers, person)[0]
            chance = 0.95 * np.mean(np.array(near) < 0.4) + 0.025
            contact = math.log(chance if nearest < 0.4 else 1.0 - chance)
            thirds["encounter"].append((log_slowly(near, nearest, "closest") + contact) / 2)
    return {third: np.mean(logs) if logs else np.nan for third, logs in thirds.items()}


def test_log_likelihoods_equal_a_slow_reference():
    standing, leaving = walk((3, 3), (0, 0)), walk((-8, 0), (1.2, 0.3))
    leaving[HISTORY + 9 :] = np.nan
    meeting = walk((0, 0), (1.01, 0)), walk((10, 0.2), (-1.02, 0)), walk((4, -9), (0, 1.31), first=HISTORY + 2)
    (window,) = cut(recording(*meeting, standing, leaving))
    random = np.random.default_rng(1)
    places = window.future + np.cumsum(random.normal(0.0, 0.15, (4, *window.future.shape)), axis=1)
    places[:, 0] = window.future[0]
    assert score_window(window, places).log == pytest.approx(score_slowly(window, places), abs=1e-9)
    assert score_window(window, window.future[None]).log == pytest.approx(score_slowly(window, window.future[None]))


def test_undefined_values_have_a_bin_of_their_own():
    values = np.array([-1.0, 0.0, 0.149, 0.151, 2.99, 9.0, np.nan, np.inf])
    assert bins_of("speed", values).tolist() == [0, 0, 0, 1, 19, 19, BINS, BINS]


def test_new_contacts_count_persons_and_not_groups():
    apart, meeting = walk((0, 0), (1, 0)), walk((10, 0.1), (-1, 0))
    (window,) = cut(recording(apart, meeting, walk((0, 0.3), (1, 0))))
    found = score_window(window, np.repeat(window.future[None], 2, axis=0))
    assert (found.recorded_contacts, found.contacts, found.persons) == (3, 3.0, 3)
    (window,) = cut(recording(apart, walk((0, 0.3), (1, 0))))
    assert score_window(window, window.future[None]).recorded_contacts == 0


def test_people_come_and_go_as_recorded_and_start_with_the_recorded_velocity():
    leaves, comes = walk((0, 3), (1, 0)), walk((0, 6), (1, 0), first=HISTORY + 4)
    leaves[HISTORY + 9 :] = np.nan
    windows = cut(recording(walk((0, 0), (1, 0)), leaves, comes))
    (places,) = simulate("straight", windows, rollouts=2)
    assert (np.isfinite(places[..., 0]) == windows[0].present).all()
    assert places[0] == pytest.approx(windows[0].future, abs=1e-9, nan_ok=True), "straight walkers, simulated straight"


def test_a_window_has_the_same_rollouts_alone_and_in_a_batch():
    windows = [*cut(recording(*[walk((0, 5.0 * k), (1, 0)) for k in range(7)])), *crossings(windows=3)]
    population = {"pedestrians.population": {"noise": 0.2, "inertia": 1.0, "spread": {"radius": 0.3}}}
    for policy, options in (("social_force", {}), ("orca", population)):
        together = simulate(policy, windows, options)
        assert (together[2] == simulate(policy, windows[2:], options)[0]).all()
    together = simulate("social_force", windows)
    assert score(windows, together) == score(windows, simulate("social_force", windows))
    assert not (together[0][0] == together[0][1]).all(), "rollouts have other random numbers"


@pytest.mark.parametrize(("truth", "other"), [("orca", "straight"), ("social_force", "orca"), ("straight", "orca")])
def test_the_model_that_made_the_tracks_has_the_best_score(truth, other):
    windows = recorded_by(truth, crossings())
    assert v3(truth, windows) > v3(other, windows) + 0.02


@pytest.mark.slow
def test_no_disperser_and_no_collider_leads():
    windows = recorded_by("orca", crossings())
    best = v3("orca", windows)
    references = {
        "random": score(windows, list(map(random_walkers, windows))),
        "dispersing": score(windows, simulate("social_force", windows, {"repulsion_strength": 50.0})),
        "colliding": score(windows, simulate("straight", windows)),
    }
    for name, scores in references.items():
        assert summarize(scores)["v3"].value < best - 0.05, name
    assert summarize(references["colliding"])["contacts"].value > 0.5


def test_preferred_speeds_shrink_and_spread_by_the_population_of_the_scenario():
    windows = cut(recording(walk((0, 0), (0.6, 0), 60), walk((0, 9), (1.8, 0), 60)))[:1]
    shrunk = {"pedestrians.population": {"shrinkage": 0.5, "typical_speed": 1.0}, "pedestrians.limits": None}
    (places,) = simulate("straight", windows, shrunk, rollouts=1)
    assert places[0, -1, :, 0] - places[0, 0, :, 0] == pytest.approx([0.8 * DT * FUTURE, 1.4 * DT * FUTURE])
    spread = {"pedestrians.population": {"spread": {"preferred_speed": 0.3}}, "pedestrians.limits": None}
    (places,) = simulate("straight", windows, spread)
    factor = (places[:, -1, :, 0] - places[:, 0, :, 0]) / (DT * FUTURE) / [0.6, 1.8]
    assert np.log(factor).std() == pytest.approx(0.3 * 0.88, rel=0.25), (
        "normal numbers within 2 have a deviation of 0.88"
    )
    assert len(np.unique(factor.round(6))) == factor.size


def test_the_blind_walker_has_the_population_without_parameters_of_the_policy():
    spread = {"radius": 0.2, "time_horizon": 0.3}
    options = {
        "time_horizon": 2.0,
        "pedestrians.radius": 0.18,
        "pedestrians.population": {"noise": 0.1, "spread": spread},
    }
    found = population_options("orca", options)
    assert found["pedestrians.radius"]["mean"] == 0.18
    assert (found["pedestrians.population"]["noise"], found["pedestrians.population"]["spread"]) == (
        0.1,
        {"radius": 0.2},
    )
    assert simulate("straight", crossings(windows=1), found, rollouts=1)
    assert population_options("orca", {"time_horizon": 2.0}) == {}


def test_goals_that_are_hidden_are_worth_less():
    windows = recorded_by("orca", crossings())
    turned = []
    for window in windows:
        paths = window.position.swapaxes(0, 1).copy()
        paths[:, HISTORY + 1 :] += 0.3 * DT * np.arange(1, FUTURE + 1)[:, None] * [[0.0, 1.0]]
        turned += cut(recording(*paths, name=window.name))
    shown = summarize(score(turned, simulate("orca", turned)))["path"].value
    hidden = summarize(score(turned, simulate("orca", turned, hidden=True)))["path"].value
    assert shown > hidden


def test_references_start_where_people_do_and_leave_as_recorded():
    windows, donors = crossings(windows=2), crossings(1, 12, "other")
    for places in (
        recording_with_noise(windows[0]),
        random_walkers(windows[0]),
        resampled_motion(windows[0], donors),
    ):
        assert places.shape == (32, *windows[0].future.shape)
        assert places[:, 0] == pytest.approx(np.repeat(windows[0].future[:1], 32, axis=0))
        assert (np.isfinite(places[..., 0]) == windows[0].present).all()
    straight = resampled_motion(windows[0], donors)
    assert per_frame(windows[0], straight)["lateral"] == pytest.approx(0.0, abs=1e-9), "donors walk straight ahead"


def test_the_recording_with_noise_leads_in_tracks_that_no_model_made():
    windows = crossings()
    noisy = summarize(score(windows, list(map(recording_with_noise, windows))))
    assert noisy["v3"].value > summarize(score(windows, list(map(random_walkers, windows))))["v3"].value + 0.1


def test_differences_are_paired():
    windows = crossings()
    scores, others = (score(windows, simulate(name, windows)) for name in ("orca", "straight"))
    found = compare(scores, others)["v3"]
    assert found.value == pytest.approx(summarize(scores)["v3"].value - summarize(others)["v3"].value)
    same = compare(scores, scores)
    assert all(tuple(same[name]) == (0.0, 0.0, 0.0) for name in ("v3", "motion", "contacts"))


def test_the_uniform_share_bounds_a_logarithm():
    (window,) = cut(recording(walk((0, 0), (1, 0))))
    places = np.repeat(window.future[None], 32, axis=0) + np.arange(FUTURE + 1)[:, None, None]
    assert score_window(window, places).log["path"] >= math.log(UNIFORM / (BINS + 1))


def test_the_definition_has_the_numbers_of_the_code():
    folder = Path(definitions.__file__).parent
    page, cars = ((folder / name).read_text("utf-8") for name in ("definition.md", "definition_cars.md"))
    for name, (low, high) in RANGES.items():
        assert f"{low:g} to {high:g} m" in page + cars or f"{low:g} to {high:g} rad" in page, name
    for number in (NEAR, CONTACT, CONFLICT, BEYOND, FARTHEST, APART):
        assert f"{number:g} m" in page
    for number in (f"{ROLLOUTS} rollouts", f"{DRIFT:g} m/s", f"{TOGETHER} frames", f"{UNIFORM:.0%}".replace("%", " %")):
        assert number in page
    for number in (f"{FRAMES * DT:g} s of future", f"{EVERY * DT:g} s later", f"{NEAR_CAR:g} m", f"{MOVING:g} m/s"):
        assert number in cars


RUNNER = CliRunner()
DATA = Path(os.environ.get("CROWDBENCH_SHARED", "/nowhere")) / "data" / "eth_ucy"
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason="the tracks of ETH/UCY are not in CROWDBENCH_SHARED")


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["orca", "--data", "nowhere"], "there is no folder nowhere with the recorded tracks of ETH/UCY"),
        (["orca", "--data", ".", "--location", "moon"], "location is 'moon', but must be one of hotel, zara, univ"),
        (["orca", "--data", "."], "biwi_hotel.txt cannot be read: No such file or directory"),
        (["orca", "--data", "nowhere", "--cars"], "there is no folder nowhere with the recorded tracks of DUT"),
        (
            ["orca", "--data", ".", "--cars", "--location", "zara"],
            "--location, --references and --fits go with ETH/UCY",
        ),
        (["orca", "--data", ".", "--option", "radius"], "--option 'radius' sets nothing: write --option key=value"),
    ],
)
def test_wrong_input_is_one_sentence(arguments, sentence, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = RUNNER.invoke(build_script(people), arguments)
    assert isinstance(done.exception, InputError)
    assert sentence in str(done.exception)


@pytest.mark.parametrize(
    ("policy", "options", "sentence"),
    [
        ("nobody", {}, "no pedestrian policy is called 'nobody'"),
        ("standing", {}, "the pedestrians of standing always stand"),
        ("recorded", {}, "pedestrians.policy is recorded"),
        ("orca", {"horizon": 2.0}, "unknown key pedestrians.orca.horizon"),
        ("orca", {"pedestrians.radius": -1.0}, "pedestrians.radius is -1.0"),
    ],
)
def test_a_wrong_policy_or_option_is_one_sentence(policy, options, sentence):
    with pytest.raises(InputError, match=sentence):
        simulate(policy, crossings(windows=1), options)


@needs_data
def test_windows_of_hotel_are_those_of_the_definition():
    windows = read_windows(DATA, ["hotel"])["hotel"]
    assert (len(windows), sum(int(each.scored.sum()) for each in windows)) == (43, 161)


@needs_data
@pytest.mark.slow
def test_the_command_prints_a_row_for_each_goal():
    done = RUNNER.invoke(build_script(people), ["straight", "--data", str(DATA), "--location", "hotel"])
    rows = [line for line in done.output.splitlines() if line.startswith("| ")]
    assert [row.split(" | ")[:2] for row in rows[2:]] == [
        [f"| {model}", goal]
        for model in ("straight", "orca as shipped", "difference to orca as shipped")
        for goal in ("shown", "hidden")
    ]
    assert "43 windows, 161 persons" in done.output


def car(start, velocity, seconds=11.0, length=4.0, width=1.6):
    time = np.arange(0.0, seconds, 0.1)
    heading = np.full(len(time), math.atan2(velocity[1], velocity[0]))
    return Car(time, np.array(start) + time[:, None] * np.array(velocity), heading, length, width)


def traffic(*cars, people=((-8.0, 0.0), (1.2, 0.0)), frames=HISTORY + FRAMES + 1):
    """The first window of a person among cars."""
    return cut_with_cars(recording(walk(*people, frames), walk((50, 50), (1, 0), frames)), cars)[0]


def test_windows_with_cars_have_the_nearest_moving_car_first():
    near, far, parked = car((0, -20), (0, 4)), car((30, -20), (0, 4)), car((0, 3), (1e-9, 0))
    window = traffic(parked, far, near)
    assert [each is near for each in window.cars] == [True, False, False]
    assert window.start == pytest.approx(HISTORY * DT)
    assert window.near.tolist() == [True, False]
    assert cut_with_cars(recording(walk((0, 0), (1, 0))), [parked]) == []


def test_rims_and_times_to_collision_equal_a_slow_reference():
    random = np.random.default_rng(0)
    places = np.cumsum(random.normal(size=(2, 9, 3, 2)), axis=1)
    places[:, 5:, 2] = np.nan
    cars = [car((-3, 1), (2, 0.5), 3.0), car((0, 5), (0.3, -1.5), 2.0), car((1, 1), (0.1, 0))]
    discs = discs_of(cars, DT * np.arange(9))
    rims, times = np.full((2, 3), np.inf), np.full((2, 3), np.inf)
    for r, t, p, d in np.ndindex(2, 8, 3, len(discs.radius)):
        begin, end = (places[r, k, p] - discs.position[k, d] for k in (t, t + 1))
        if not discs.moving[t, d] or not np.isfinite(begin + end).all():
            continue
        share = np.linspace(0.0, 1.0, 2001)[:, None]
        reach = discs.radius[d] + 0.2
        rims[r, p] = min(rims[r, p], np.hypot(*(begin + share * (end - begin)).T).min() - reach)
        ahead = np.hypot(*(begin + np.linspace(0.0, 100.0, 100_001)[:, None] * (end - begin) / DT).T) <= reach
        if ahead.any():
            times[r, p] = min(times[r, p], 1e-3 * ahead.argmax())
    assert rim_distance(places, discs) == pytest.approx(rims, abs=1e-3)
    assert time_to_collision(places, discs) == pytest.approx(times, abs=2e-3)


@pytest.mark.slow
def test_cars_drive_as_recorded_and_people_see_them():
    window = traffic(car((0, -20), (0, 3)), car((4, -26), (0, 3), width=1.2))
    discs = with_discs(window)
    assert discs.position.shape[1] == 2 + DISCS
    assert discs.scored.tolist() == [True, True, *[False] * DISCS]
    blind, orca = (
        simulate_traffic(policy, [window], {"pedestrians.attention.ignores": 0.0}, rollouts=2)[0]
        for policy in ("straight", "orca")
    )
    assert blind[0] == pytest.approx(window.window.future, abs=1e-9)
    assert rim_distance(blind[:, :, :1], window.discs).max() < 0.0
    assert rim_distance(orca[:, :, :1], window.discs).min() > rim_distance(blind[:, :, :1], window.discs).max()


@pytest.mark.slow
def test_people_that_avoid_cars_are_scored_best_by_the_model_that_avoids_them():
    options = {"pedestrians.attention.ignores": 0.0}
    window = traffic(car((0, -20), (0, 3)))
    (places,) = simulate_traffic("orca", [window], options, rollouts=1)
    paths = np.concatenate([window.window.position[:HISTORY], places[0]]).swapaxes(0, 1)
    (made,) = cut_with_cars(recording(*paths), window.cars)
    scores = {
        policy: score_traffic([made], simulate_traffic(policy, [made], options))[0] for policy in ("orca", "straight")
    }
    assert scores["orca"].log["encounter"] > scores["straight"].log["encounter"] + 0.5
    assert scores["orca"].contacts < 0.1, "who looks away may be struck"
    assert scores["straight"].contacts == 1.0
    assert scores["orca"].persons == 1


def test_whole_blocks_are_resampled():
    windows = crossings(windows=6)
    scores = score(windows, simulate("straight", windows))
    each, one = summarize(scores), summarize(scores, ["same"] * 6)
    assert one["v3"].value == pytest.approx(each["v3"].value)
    assert one["v3"].low == pytest.approx(one["v3"].high)
    assert each["v3"].low < each["v3"].high


@needs_data
@pytest.mark.slow
@pytest.mark.parametrize("form", ["csv", "json"])
def test_the_figures_are_for_programs_too(form):
    arguments = ["orca", "--data", str(DATA), "--location", "hotel", "--format", form]
    printed = RUNNER.invoke(build_script(people), arguments).stdout
    rows = json.loads(printed) if form == "json" else list(csv.DictReader(io.StringIO(printed)))
    assert [row["goal"] for row in rows] == ["shown", "hidden"]
    assert 0.1 < float(rows[0]["v3"]["value"] if form == "json" else rows[0]["v3.value"]) < 0.4


def test_seconds_close_are_those_of_strangers_and_counted_for_both():
    # For 8 s at 0.65 m: with radii of 0.1 m the gap is 0.45 m. Far away, two members of a group are as near.
    side_by_side = walk([0, 0], [1, 0]), walk([0, 0.65], [1, 0])
    window = dataclasses.replace(cut(recording(*side_by_side))[0], group=np.array([0, 1]))
    assert seconds_close(window, 0.1) == (pytest.approx(8.0), pytest.approx(16.0))
    assert measure([window, window], 0.1).mean == pytest.approx(0.5)
    together = dataclasses.replace(window, group=np.array([0, 0]))
    assert seconds_close(together, 0.1) == (0.0, pytest.approx(16.0))


def test_a_stranger_that_passes_between_two_annotations_is_close():
    # Towards each other at 6 m/s together: gaps of 1.16 m at the annotations, and of 0.45 m between them.
    meeting = walk([-18.6, 0.0], [3, 0]), walk([18.6, 0.65], [-3, 0])
    window = cut(recording(*meeting))[0]
    close, seconds = seconds_close(window, 0.1)
    share = (np.arange(100_000) + 0.5) / 100_000 * 8.0
    gap = np.hypot(window.future[0, 1, 0] - window.future[0, 0, 0] - 6.0 * share, 0.65) - 0.2
    assert close > 0.1
    assert close == pytest.approx(2 * 8.0 * np.clip((0.6 - gap) / 0.3, 0.0, 1.0).mean(), abs=2e-3)
    assert seconds == pytest.approx(16.0)
