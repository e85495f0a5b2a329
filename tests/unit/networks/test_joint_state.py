import math

import numpy as np
import pytest
from joint_states import scenes, slow_joint_states

from crowdbench.networks.joint_state import SIZE, VEHICLE, joint_states


@pytest.mark.parametrize("shape", [(), (40,), (2, 30)])
@pytest.mark.parametrize("pedestrians", [0, 1, 6])
def test_joint_states_are_those_of_crowdnav(shape, pedestrians):
    arguments = scenes(np.random.default_rng(0), shape, pedestrians)
    joint = joint_states(**arguments)
    assert joint.shape == (*shape, max(pedestrians, 1), SIZE)
    for world in np.ndindex(shape):
        slow = slow_joint_states(**{name: values[world] for name, values in arguments.items()})
        np.testing.assert_allclose(joint[world], slow, rtol=1e-6, atol=1e-6)


def test_the_x_axis_points_to_the_goal():
    joint = joint_states(
        position=np.array([[1.0, 1.0], [4.0, 3.0]]),
        velocity=np.array([[0.5, 0.1], [0.0, -0.7]]),
        radius=np.array([0.3, 0.4]),
        present=np.array([True, True]),
        goal=np.array([1.0, 6.0]),
        preferred_speed=np.array(1.2),
    )
    # The goal is 5 m up: what is up in the world is ahead, what is right of it has a negative y.
    vehicle = [5.0, 1.2, 0.0, 0.3, 0.1, -0.5]
    np.testing.assert_allclose(joint, [[*vehicle, 2.0, -3.0, -0.7, 0.0, 0.4, math.sqrt(13.0), 0.7]], rtol=1e-6)


def test_turning_and_shifting_everything_changes_nothing():
    rng = np.random.default_rng(1)
    arguments = scenes(rng, (50,))
    angle, shift = rng.uniform(-np.pi, np.pi, 50), rng.normal(0.0, 10.0, (50, 2))
    turn = np.stack([np.stack([np.cos(angle), np.sin(angle)], -1), np.stack([-np.sin(angle), np.cos(angle)], -1)], -1)
    turned = arguments | {
        "position": np.einsum("wij,waj->wai", turn, arguments["position"]) + shift[:, None],
        "velocity": np.einsum("wij,waj->wai", turn, arguments["velocity"]),
        "goal": np.einsum("wij,wj->wi", turn, arguments["goal"]) + shift,
    }
    np.testing.assert_allclose(joint_states(**turned), joint_states(**arguments), atol=2e-6)


@pytest.mark.parametrize(("left", "ahead"), [(0.0, 0.0), (1e-300, 0.0), (1e-9, 1e-9)])
def test_joint_states_at_the_goal_are_in_the_frame_of_the_world(left, ahead):
    arguments = scenes(np.random.default_rng(2)) | {"present": np.ones(5, bool)}
    arguments["position"][0] = 0.0
    joint = joint_states(**arguments | {"goal": np.array([0.0, left])})
    # As long as there is any way left that can be measured, it gives the direction.
    expected = slow_joint_states(**arguments | {"goal": np.array([0.0, ahead])})
    np.testing.assert_allclose(joint, expected, rtol=1e-6, atol=1e-6)


def test_whatever_is_said_of_the_absent_is_zeros():
    arguments = scenes(np.random.default_rng(3), (30,))
    absent = ~arguments["present"][:, 1:]
    vehicle = joint_states(**arguments)[:, 0, :VEHICLE]
    for name in ("position", "velocity", "radius"):
        arguments[name][:, 1:][absent] = np.nan
    joint = joint_states(**arguments)
    assert 0 < absent.sum() < absent.size
    assert (joint[absent][:, VEHICLE:] == 0.0).all()
    assert np.isfinite(joint).all()
    assert np.array_equal(joint[..., :VEHICLE], np.repeat(vehicle[:, None], 4, axis=1))


def test_broadcast_and_strided_arrays_are_read_as_they_are():
    arguments = scenes(np.random.default_rng(4), (3, 8))
    arguments["radius"] = np.broadcast_to(arguments["radius"][:, :1], (3, 8, 5))
    odd = {name: values[:, ::2] for name, values in arguments.items()}
    plain = {name: values.copy() for name, values in odd.items()}
    assert np.array_equal(joint_states(**odd), joint_states(**plain))
