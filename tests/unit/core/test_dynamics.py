import itertools
import math

import numpy as np
import pytest
from helpers import advance, world

from crowdbench.core.dynamics import Bicycle, Holonomic, State, Unicycle
from crowdbench.core.dynamics.dynamics import speeds_and_headings
from crowdbench.core.dynamics.kernels import CHORD_ERROR, along_arc, chords, limit_speed
from crowdbench.utils.errors import InputError

DT = 0.25
FREE = {"max_acceleration": math.inf, "max_angular_acceleration": math.inf}
WHEELED = [
    Unicycle(),
    Unicycle(0.7, 1.1, 2.5),
    Unicycle(max_reverse_speed=0.4),
    Bicycle(),
    Bicycle(wheelbase=1.0, max_steering=0.4),
    Bicycle(wheelbase=1.0, max_steering=0.4, max_reverse_speed=0.4),
]


def at_rest(n=1, heading=0.0):
    return State(np.zeros((n, 2)), np.zeros((n, 2)), np.full(n, heading), np.zeros(n))


def driven(dynamics, state, command, steps, max_speed=1.0):
    """The states after each of some steps with the same command."""
    n = len(state.heading)
    states = [state]
    for _ in range(steps):
        states.append(dynamics.step(states[-1], np.tile(command, (n, 1)).astype(float), np.full(n, max_speed), DT))
    return states


def test_a_full_circle_leads_back():
    # 40 steps at w make 2 pi.
    unicycle = Unicycle(**FREE)
    *_, last = driven(unicycle, at_rest(heading=0.3), [0.8, 2 * math.pi / (40 * DT)], 40)
    assert last.position[0] == pytest.approx([0, 0], abs=1e-9)
    assert last.heading[0] == pytest.approx(0.3, abs=1e-9)


def test_half_a_circle_ends_at_its_diameter():
    wheelbase, steering = 1.0, 0.5
    radius = wheelbase / math.tan(steering)
    bicycle = Bicycle(wheelbase, max_acceleration=math.inf)
    *_, last = driven(bicycle, at_rest(), [math.pi * radius / (20 * DT), steering], 20, max_speed=9.0)
    assert last.position[0] == pytest.approx([0, 2 * radius], abs=1e-9)
    assert abs(last.heading[0]) == pytest.approx(math.pi)


@pytest.mark.parametrize("dynamics", [Unicycle(**FREE), Bicycle(max_acceleration=math.inf)])
def test_without_a_turn_the_way_is_straight_and_without_a_speed_there_is_none(dynamics):
    *_, last = driven(dynamics, at_rest(heading=0.4), [0.5, 0.0], 8)
    assert last.position[0] == pytest.approx([math.cos(0.4), math.sin(0.4)], abs=1e-12)
    assert last.velocity[0] == pytest.approx([0.5 * math.cos(0.4), 0.5 * math.sin(0.4)])
    assert last.heading[0] == 0.4
    *_, last = driven(dynamics, at_rest(), [0.0, 0.6], 8)
    assert last.position.tolist() == [[0.0, 0.0]]


def test_a_car_at_rest_does_not_turn_and_a_unicycle_does():
    assert driven(Bicycle(), at_rest(), [0.0, 0.6], 1)[-1].heading[0] == 0.0
    assert driven(Unicycle(**FREE), at_rest(), [0.0, 0.6], 1)[-1].heading[0] == pytest.approx(0.6 * DT)


def test_a_vehicle_speeds_up_by_its_acceleration():
    speeds = [state.speed[0] for state in driven(Unicycle(max_acceleration=0.8), at_rest(), [1.0, 0.0], 6)]
    assert speeds == pytest.approx([0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 1.0])
    sliding = [state.velocity[0, 1] for state in driven(Holonomic(0.8), at_rest(), [0.0, 1.0], 6)]
    assert sliding == pytest.approx(speeds)


@pytest.mark.parametrize("dynamics", [*WHEELED, Holonomic(1.5)])
def test_limits_hold_at_every_step_whatever_is_commanded(dynamics):
    rng = np.random.default_rng(1)
    state, max_speed = at_rest(50), rng.uniform(0.5, 2.0, 50)
    for _ in range(100):
        after = dynamics.step(state, rng.normal(0.0, 3.0, (50, 2)), max_speed, DT)
        change = after.velocity - state.velocity
        if not isinstance(dynamics, Holonomic):
            assert (after.speed >= -dynamics.max_reverse_speed - 1e-12).all()
            change = (after.speed - state.speed)[:, None]
        assert (np.linalg.norm(change, axis=1) <= dynamics.max_acceleration * DT + 1e-9).all()
        assert (np.linalg.norm(after.velocity, axis=1) <= max_speed * (1 + 1e-6)).all()
        if isinstance(dynamics, Unicycle):
            assert (np.abs(after.angular_speed) <= dynamics.max_angular_speed).all()
            most = dynamics.max_angular_acceleration * DT + 1e-9
            assert (np.abs(after.angular_speed - state.angular_speed) <= most).all()
        if isinstance(dynamics, Bicycle):
            sharpest = math.tan(dynamics.max_steering) / dynamics.wheelbase
            assert (np.abs(after.angular_speed) <= sharpest * np.abs(after.speed) + 1e-9).all()
        state = after


def test_a_holonomic_vehicle_moves_as_the_simulator_moves_it_to_the_last_bit():
    rng = np.random.default_rng(2)
    for _ in range(50):
        here, asked = rng.normal(0.0, 3.0, (1, 2)), rng.normal(0.0, 1.0, 2) * rng.integers(0, 2)
        before = world(here, rng.normal(0.0, 1.0, (1, 2))).replace(heading=rng.uniform(-3.0, 3.0, 1))
        after = advance(before, asked[None, None])
        state = State(here, before.velocity[:, 0], before.heading, before.angular_speed)
        found = Holonomic().step(state, asked[None], np.ones(1), before.rules.dt)
        expected = State(after.position[:, 0], after.velocity[:, 0], after.heading, after.angular_speed)
        assert all(np.array_equal(one, two) for one, two in zip(found, expected, strict=True))


@pytest.mark.parametrize("reach", [0.0, 2.0])
@pytest.mark.parametrize(("speed", "turn_rate"), [(1.0, 2.0), (8.0, 0.6), (0.05, 3.0), (1.0, -0.01), (2.0, 0.0)])
def test_no_point_of_the_body_is_further_than_a_millimetre_from_its_chord(speed, turn_rate, reach):
    def point(time):
        x, y, heading = along_arc(1.0, 2.0, 0.7, speed, turn_rate, time)
        return np.array([x + reach * math.cos(heading), y + reach * math.sin(heading)])

    number = chords(speed, turn_rate, reach, DT)
    ends = np.linspace(0.0, DT, number + 1)
    worst = 0.0
    for begin, end in itertools.pairwise(ends):
        for share in np.linspace(0.0, 1.0, 200):
            chord = (1 - share) * point(begin) + share * point(end)
            worst = max(worst, np.linalg.norm(chord - point((1 - share) * begin + share * end)))
    assert worst <= CHORD_ERROR
    # And there are no more of them than needed.
    assert number == 1 or worst > CHORD_ERROR / 4


@pytest.mark.parametrize("dynamics", [Unicycle(), Unicycle(**FREE), Unicycle(2.0, 2.0, 0.5), *WHEELED[2:]])
@pytest.mark.parametrize("behind", [math.pi, 3.0, -2.0, 0.5, 0.0])
def test_who_follows_the_direction_of_a_goal_reaches_it_wherever_it_is(dynamics, behind):
    goal = 12.0 * np.array([[math.cos(behind), math.sin(behind)]])
    state = at_rest()
    for _ in range(400):
        ahead = goal - state.position
        if np.linalg.norm(ahead) < 0.3:
            return
        wanted = ahead / max(np.linalg.norm(ahead), 1.0)
        command = dynamics.follow(state, wanted, np.ones(1), DT)
        assert dynamics.is_within(command, np.ones(1)).all()
        state = dynamics.step(state, command, np.ones(1), DT)
    pytest.fail(f"still {np.linalg.norm(goal - state.position):.2f} m away")


def test_a_unicycle_turns_to_a_direction_without_turning_beyond_it():
    for unicycle in (Unicycle(), Unicycle(2.0, 2.0, 0.5), Unicycle(2.0, 1.3, 3.1)):
        state = at_rest()
        for _ in range(60):
            command = unicycle.follow(state, np.array([[-0.5, 0.1]]), np.ones(1), DT)
            state = unicycle.step(state, command, np.ones(1), DT)
            assert 0.0 <= state.heading[0] <= math.atan2(0.1, -0.5) + 1e-9
        assert state.heading[0] == pytest.approx(math.atan2(0.1, -0.5))
        assert state.speed[0] == pytest.approx(math.hypot(0.5, 0.1))


def test_a_holonomic_vehicle_follows_a_velocity_by_the_velocity():
    wanted = np.array([[0.3, -0.4]])
    assert Holonomic().follow(at_rest(), wanted, np.ones(1), DT) is wanted


def test_a_holonomic_lookahead_has_crowdnavs_commands():
    speed = np.array([1.0, 0.5])
    assert np.array_equal(Holonomic().commands(at_rest(2), speed, DT), speeds_and_headings(speed))


@pytest.mark.parametrize("dynamics", WHEELED)
def test_commands_of_a_lookahead_can_be_reached_within_the_step(dynamics):
    rng = np.random.default_rng(3)
    state, max_speed = at_rest(20), np.ones(20)
    for _ in range(10):
        commands = dynamics.commands(state, max_speed, DT)
        # Straight ahead is among them, wherever the vehicle can stop turning.
        stops = np.abs(state.angular_speed) <= getattr(dynamics, "max_angular_acceleration", math.inf) * DT
        assert ((commands[..., 1] == 0.0).any(axis=1) == (stops | isinstance(dynamics, Bicycle))).all()
        for action in range(commands.shape[1]):
            command = commands[:, action]
            assert dynamics.is_within(command, max_speed).all()
            after = dynamics.step(state, command, max_speed, DT)
            assert after.speed == pytest.approx(command[:, 0], abs=1e-9)
            if isinstance(dynamics, Unicycle):
                assert after.angular_speed == pytest.approx(command[:, 1], abs=1e-9)
        state = dynamics.step(state, commands[np.arange(20), rng.integers(0, commands.shape[1], 20)], max_speed, DT)


@pytest.mark.parametrize(
    ("dynamics", "command", "expected"),
    [
        (Holonomic(), [0.8, 0.8], "asked for 1.13137 m/s, but the vehicle's maximum is 1 m/s"),
        (Unicycle(), [-0.2, 0.0], "asked for -0.2 m/s, but the vehicle's speeds are 0 to 1 m/s"),
        (Unicycle(), [0.2, 2.5], "asked for 2.5 rad/s, but its max_angular_speed is 2 rad/s"),
        (Bicycle(), [1.2, 0.0], "asked for 1.2 m/s, but the vehicle's speeds are 0 to 1 m/s"),
        (Bicycle(), [0.2, -1.0], "asked to steer by -1 rad, but its max_steering is 0.6 rad"),
    ],
)
def test_a_command_beyond_a_limit_gets_a_sentence_that_names_it(dynamics, command, expected):
    beyond, max_speed = np.array([command]), np.ones(1)
    assert not dynamics.is_within(beyond, max_speed)[0]
    assert dynamics.broken_limit(beyond[0], 1.0) == expected
    assert dynamics.is_within(0.7 * np.clip(beyond, *dynamics.space(max_speed)), max_speed)[0]


@pytest.mark.parametrize(
    ("made", "expected"),
    [
        (lambda: Holonomic(0.0), "max_acceleration is 0.0, but must be a number above 0"),
        (lambda: Unicycle(max_angular_speed=math.inf), "max_angular_speed is inf, but must be a number above 0, and"),
        (lambda: Bicycle(max_steering=1.6), "max_steering is 1.6, but must be a number above 0, and 1.5 at most"),
        (lambda: Bicycle(wheelbase=-1), "wheelbase is -1, but must be a number above 0"),
    ],
)
def test_impossible_limits_are_refused(made, expected):
    with pytest.raises(InputError, match=expected):
        made()


@pytest.mark.parametrize("size", [1e3, 1e150, 1e154, 1e300, 1.7e308])
def test_a_velocity_of_any_size_is_slowed_down_to_the_limit(size):
    for x, y in ((size, size), (-size, 0.5 * size), (0.0, -size)):
        vx, vy = limit_speed(x, y, 1.3)
        assert math.hypot(vx, vy) == pytest.approx(1.3)
        assert math.atan2(vy, vx) == pytest.approx(math.atan2(y, x))


@pytest.mark.parametrize("dynamics", [Unicycle(**FREE, max_reverse_speed=0.5), Bicycle(1.0, max_reverse_speed=0.5)])
def test_a_drive_backwards_undoes_a_drive_forwards(dynamics):
    there = driven(dynamics, at_rest(heading=0.3), [0.4, 0.5], 8)
    first = dynamics.step(there[-1], np.array([[-0.4, 0.5]]), np.ones(1), DT)  # a bicycle stops on the way
    back = driven(dynamics, first, [-0.4, 0.5] if isinstance(dynamics, Bicycle) else [-0.4, -0.5], 8)
    assert back[-1].speed[0] == pytest.approx(-0.4)
    assert np.linalg.norm(back[-1].position) < 0.2 < np.linalg.norm(there[-1].position)


def test_a_vehicle_does_not_drive_backwards_faster_than_its_limit_or_its_preferred_speed():
    slow, fast = Unicycle(max_reverse_speed=0.4), Unicycle(max_reverse_speed=9.0)
    assert driven(slow, at_rest(), [-5.0, 0.0], 9)[-1].speed[0] == -0.4
    assert driven(fast, at_rest(), [-5.0, 0.0], 9)[-1].speed[0] == -1.0
    assert driven(Unicycle(), at_rest(), [-5.0, 0.0], 9)[-1].speed[0] == 0.0
    assert slow.is_within(np.array([[-0.4, 0.0], [-0.41, 0.0]]), np.ones(2)).tolist() == [True, False]
    assert slow.broken_limit(np.array([-0.41, 0.0]), 1.0).endswith("but the vehicle's speeds are -0.4 to 1 m/s")


@pytest.mark.parametrize("made", [Unicycle, Bicycle])
def test_a_slow_velocity_behind_is_driven_backwards_and_a_fast_one_makes_the_vehicle_turn(made):
    dynamics, state = made(max_reverse_speed=0.5), at_rest(heading=0.0)
    slow, _ = dynamics.follow(state, np.array([[-0.4, 0.05]]), np.ones(1), DT)[0]
    fast, turn = dynamics.follow(state, np.array([[-0.9, 0.05]]), np.ones(1), DT)[0]
    assert -0.4 <= slow < -0.35
    assert fast >= 0.0
    assert turn > 0.0
    assert made().follow(state, np.array([[-0.4, 0.05]]), np.ones(1), DT)[0, 0] >= 0.0


@pytest.mark.parametrize("made", [Unicycle, Bicycle])
def test_a_vehicle_that_backs_towards_a_point_reaches_it(made):
    dynamics, state, goal = made(max_reverse_speed=0.5), at_rest(), np.array([[-3.0, 0.5]])
    for _ in range(40):
        away = goal - state.position
        velocity = 0.4 * away / np.linalg.norm(away)
        state = dynamics.step(state, dynamics.follow(state, velocity, np.ones(1), DT), np.ones(1), DT)
        if np.linalg.norm(goal - state.position) < 0.15:
            return
    raise AssertionError(state)
