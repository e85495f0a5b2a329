import dataclasses

import numpy as np
import pytest
from helpers import advance

from crowdbench import load_predictor, load_scenario
from crowdbench.core.types import HISTORY, Observation, Pedestrians, Vehicle
from crowdbench.predict import ConstantVelocity, ConstantVelocitySampled, Linear, Oracle
from crowdbench.predict.predictors import PREDICTORS
from crowdbench.scenario.cases import Cases
from crowdbench.sim.sensor import observe
from crowdbench.sim.simulator import crowd_velocities
from crowdbench.utils.errors import InputError

DT = 0.25
BOTH = pytest.mark.parametrize("predictor", [Linear(), ConstantVelocity()])
EVERY = pytest.mark.parametrize("predictor", [Linear(), ConstantVelocity(), ConstantVelocitySampled(modes=7)])


def observation(tracks, observed=None, before=None):
    """An observation of tracks `[world, time, pedestrian, 2]`, of which the last `observed` points were seen.

    `observed` is a number for each world, or for each pedestrian of each world. Points before are filled with the
    first one seen, or with `before`.
    """
    history = np.array(tracks, float)
    worlds, _, pedestrians, _ = history.shape
    observed = np.full(worlds, HISTORY) if observed is None else np.array(observed)
    observed = np.broadcast_to(observed.reshape(worlds, -1), (worlds, pedestrians)).copy()
    for w, p in np.ndindex(worlds, pedestrians):
        own, seen = history[w, :, p], observed[w, p]
        own[: HISTORY - seen] = own[HISTORY - seen] if before is None else before
    nothing, zeros = np.zeros((worlds, 2)), np.zeros(worlds)
    return Observation(
        vehicle=Vehicle(
            position=nothing,
            velocity=nothing,
            heading=zeros,
            angular_speed=zeros,
            goal=nothing,
            route=np.empty((worlds, 0, 2)),
            waypoint=np.zeros(worlds, int),
            radius=zeros,
            preferred_speed=zeros,
        ),
        pedestrians=Pedestrians(
            position=history[:, -1],
            velocity=(history[:, -1] - history[:, -2]) / DT,
            radius=np.full((worlds, pedestrians), 0.3),
            seen=np.ones((worlds, pedestrians), bool),
            history=history,
            observed=observed,
            age=np.zeros((worlds, pedestrians)),
        ),
        obstacles=np.empty((worlds, 0, 0, 2)),
        row=np.arange(worlds),
        noise_key=np.zeros(worlds, np.uint64),
        step=observed.max(axis=1, initial=1) - 1,
        dt=DT,
    )


def bent(worlds=HISTORY, pedestrians=3):
    """Tracks that wander."""
    return np.random.default_rng(0).normal(size=(worlds, HISTORY, pedestrians, 2)).cumsum(axis=1)


def test_linear_is_the_least_squares_line_through_the_points_really_seen():
    tracks, observed = bent(), np.arange(1, HISTORY + 1)
    found = Linear().predict(observation(tracks, observed), 5)
    assert found.position.shape == found.velocity.shape == (8, 1, 5, 3, 2)
    time = DT * np.arange(1 - HISTORY, 1)
    for w, seen in enumerate(observed[1:], 1):
        for p in range(3):
            for axis in range(2):
                slope, at_now = np.polyfit(time[-seen:], tracks[w, -seen:, p, axis], 1)
                np.testing.assert_allclose(found.position[w, 0, :, p, axis], at_now + slope * DT * np.arange(1, 6))
                np.testing.assert_allclose(found.velocity[w, 0, :, p, axis], slope)


def test_constant_velocity_goes_on_as_in_the_last_step():
    tracks = bent()
    found = ConstantVelocity().predict(observation(tracks), 4)
    moved = tracks[:, -1] - tracks[:, -2]
    for step in range(4):
        np.testing.assert_allclose(found.position[:, 0, step], tracks[:, -1] + (step + 1) * moved)
        np.testing.assert_allclose(found.velocity[:, 0, step], moved / DT)


def test_constant_velocity_is_the_velocity_of_a_track():
    seen = observation(bent())
    velocity = np.random.default_rng(1).normal(size=seen.pedestrians.velocity.shape)
    tracks = dataclasses.replace(seen.pedestrians, velocity=velocity, deviation=np.full(velocity.shape, 0.1))
    found = ConstantVelocity().predict(dataclasses.replace(seen, pedestrians=tracks), 2)
    np.testing.assert_allclose(found.velocity[:, 0, 1], velocity)


@EVERY
def test_who_was_seen_once_stands_still(predictor):
    tracks = bent()
    found = predictor.predict(observation(tracks, np.ones(8, int)), 3)
    np.testing.assert_allclose(found.position, np.broadcast_to(tracks[:, None, -1:], found.position.shape))
    assert not found.velocity.any()


@EVERY
def test_points_that_were_not_seen_do_not_matter(predictor):
    observed = np.arange(1, HISTORY + 1)
    one = predictor.predict(observation(bent(), observed), 3)
    other = predictor.predict(observation(bent(), observed, before=1e3), 3)
    np.testing.assert_array_equal(one.position, other.position)
    np.testing.assert_array_equal(one.velocity, other.velocity)


@EVERY
def test_padding_and_other_worlds_do_not_matter(predictor):
    tracks, observed = bent(), np.arange(1, HISTORY + 1)
    alone = predictor.predict(observation(tracks[4:5], observed[4:5]), 3)
    padded = predictor.predict(observation(np.pad(tracks, ((0, 0), (0, 0), (0, 2), (0, 0))), observed), 3)
    np.testing.assert_array_equal(padded.position[4:5, :, :, :3], alone.position)
    np.testing.assert_array_equal(padded.velocity[4:5, :, :, :3], alone.velocity)
    assert np.isfinite(padded.position).all()
    assert np.isfinite(padded.velocity).all()


@EVERY
@pytest.mark.parametrize("pedestrians", [0, 1])
def test_a_crowd_may_be_one_or_nobody(predictor, pedestrians):
    found = predictor.predict(observation(bent(pedestrians=3)[:, :, :pedestrians]), 3)
    modes = getattr(predictor, "modes", 1)
    assert found.position.shape == found.velocity.shape == (8, modes, 3, pedestrians, 2)
    assert np.isfinite(found.position).all()


@BOTH
def test_the_order_of_pedestrians_does_not_matter(predictor):
    order = [2, 0, 1]
    found, other = predictor.predict(observation(bent()), 3), predictor.predict(observation(bent()[:, :, order]), 3)
    np.testing.assert_array_equal(found.position[:, :, :, order], other.position)


def headings(prediction):
    return np.arctan2(prediction.velocity[..., 1], prediction.velocity[..., 0])


def test_sampled_headings_turn_the_last_velocity_by_normal_angles():
    obs = observation(bent(pedestrians=40))
    found = ConstantVelocitySampled(modes=50, angle=10.0).predict(obs, 3)
    straight = ConstantVelocity().predict(obs, 3)
    speed = np.linalg.norm(straight.velocity, axis=-1)
    np.testing.assert_allclose(np.linalg.norm(found.velocity, axis=-1), np.broadcast_to(speed, (8, 50, 3, 40)))
    turned = (headings(found) - headings(straight) + np.pi) % (2 * np.pi) - np.pi
    np.testing.assert_allclose(turned[:, :, 0], turned[:, :, 2])
    assert np.degrees(turned.std()) == pytest.approx(10.0, rel=0.03)
    assert np.degrees(turned.mean()) == pytest.approx(0.0, abs=1.0)
    own = np.corrcoef(turned[0, :, 0, :2].T)
    assert abs(own[0, 1]) < 0.4  # each pedestrian has an angle of its own
    np.testing.assert_allclose(np.diff(found.position, axis=2), DT * found.velocity[:, :, 1:])


def test_fewer_sampled_modes_are_the_first_of_more():
    obs = observation(bent())
    few, many = (ConstantVelocitySampled(modes).predict(obs, 3).position for modes in (3, 20))
    np.testing.assert_array_equal(few, many[:, :3])


def test_options_reach_the_predictor_and_wrong_ones_are_told():
    assert load_predictor("constant_velocity_sampled", {"modes": 3}).modes == 3
    for name, options, expected in [
        ("linear", {"modes": 3}, "linear has no option 'modes'; its options are: none"),
        (
            "constant_velocity_sampled",
            {"mode": 3},
            "has no option 'mode' .did you mean modes.*; its options are: modes, angle",
        ),
        ("constant_velocity_sampled", {"modes": 0}, "modes is 0, but must be a whole number, 1 or more"),
        ("constant_velocity_sampled", {"modes": 2.5}, "modes is 2.5, but must be a whole number"),
        ("constant_velocity_sampled", {"modes": True}, "modes is true, but must be a whole number"),
        ("constant_velocity_sampled", {"angle": "wide"}, "angle is 'wide', but must be a number"),
        ("sgan", {"rescaled": 1}, "rescaled is 1, but must be true or false"),
        ("sgan", {"weights": 1}, "weights is 1, but must be a text in quotes"),
        ("constant_velocity_sampled", {"angle": -1.0}, "angle is -1.0, but must be a number of degrees, 0 or more"),
    ]:
        with pytest.raises(InputError, match=expected):
            load_predictor(name, options)


def after(world, steps, scenario):
    """The world some steps later, in which the vehicle stands."""
    for _ in range(steps):
        world = advance(world, np.pad(crowd_velocities(world, scenario.policies), ((0, 0), (1, 0), (0, 0))))
    return world


@pytest.mark.parametrize("name", ["circle_crossing_5", "circle_crossing_5_social_force"])
def test_the_oracle_knows_the_next_step_and_goes_straight_on_from_there(name):
    scenario = load_scenario(name)
    world = after(scenario.worlds(Cases.parse("val:10")), 12, scenario)
    found = Oracle().predict(observe(world, future=crowd_velocities(world, scenario.policies)), 3)
    then = after(world, 1, scenario)
    np.testing.assert_allclose(found.position[:, 0, 0], then.position[:, 1:])
    np.testing.assert_allclose(found.velocity[:, 0, 0], then.velocity[:, 1:])
    np.testing.assert_allclose(found.velocity[:, 0, 2], then.velocity[:, 1:])
    np.testing.assert_allclose(found.position[:, 0, 2], then.position[:, 1:] + 2 * DT * then.velocity[:, 1:])


def test_only_the_oracle_is_privileged_and_it_needs_the_future():
    assert [name for name in PREDICTORS.functions if load_predictor(name).privileged] == ["oracle"]
    with pytest.raises(PermissionError):
        Oracle().predict(observation(bent()), 3)


MINE = """
from crowdbench.predict import Linear

class Mine(Linear):
    pass

def predictor():
    return Mine()

def other():
    return Linear()

def wrong():
    return 3
"""


def test_a_predictor_is_found_by_name_or_in_a_file(tmp_path):
    path = tmp_path / "mine.py"
    path.write_text(MINE)
    kinds = [type(load_predictor(name)).__name__ for name in PREDICTORS.functions]
    assert kinds == ["Linear", "ConstantVelocity", "ConstantVelocitySampled", "Oracle", "SocialGAN", "SocialGAN"]
    assert type(load_predictor(str(path))).__name__ == "Mine"
    assert isinstance(load_predictor(f"{path}:other"), Linear)
    for spec, expected in [
        ("linaer", "no predictor is called 'linaer' .did you mean linear.*; there are linear, constant_velocity, "),
        (f"{path}:wrong", "made a int, but must make a crowdbench.Predictor"),
        (f"{path}:none", "defines no function none"),
        ("./nowhere.py", "there is no file"),
    ]:
        with pytest.raises(InputError, match=expected):
            load_predictor(spec)
