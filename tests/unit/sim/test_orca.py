import numpy as np
import pytest

from crowdbench.sim.pedestrians import orca
from crowdbench.sim.pedestrians.orca import orca_velocities

INPUTS = ("position", "velocity", "preferred_velocity", "radius", "max_speed")


def scenes(worlds, agents, seed=0):
    rng = np.random.default_rng(seed)
    position = rng.uniform(-4, 4, (worlds, agents, 2))
    velocity, preferred = rng.uniform(-1, 1, (2, worlds, agents, 2))
    return position, velocity, preferred, np.full((worlds, agents), 0.3), np.ones((worlds, agents))


@pytest.mark.parametrize("agents", [2, 3, 6, 11, 21, 51])
def test_a_step_agrees_with_rvo2(reference, agents):
    data = reference("orca_steps")
    arrays = (data[f"n{agents}_{name}"].astype(float) for name in INPUTS)
    ours = orca_velocities(*arrays, max_neighbors=data[f"n{agents}_max_neighbors"])
    error = np.abs(ours - data[f"n{agents}_new_velocity"]).max(axis=-1)
    assert (error < 1e-4).mean() >= 0.995


@pytest.mark.parametrize("agents", [1, 2, 6, 21])
def test_a_step_among_walls_agrees_with_rvo2(reference, agents):
    data = reference("orca_walls")
    arrays = (data[f"n{agents}_{name}"].astype(float) for name in INPUTS)
    ours = orca_velocities(
        *arrays,
        max_neighbors=20,
        obstacles=data[f"n{agents}_obstacles"].astype(float),
        time_horizon_obst=np.repeat(data[f"n{agents}_time_horizon_obst"][:, None], agents, axis=1).astype(float),
    )
    error = np.abs(ours - data[f"n{agents}_new_velocity"]).max(axis=-1)
    for kind in range(5):
        assert (error[data[f"n{agents}_kind"] == kind] < 1e-4).mean() >= 0.99


def test_obstacles_far_away_change_nothing():
    inputs = scenes(30, 6)
    far = np.full((1, 2, 5, 2), np.nan)
    far[0, 0, :2] = [[40.0, -5.0], [40.0, 5.0]]
    far[0, 1, :4] = [[-50.0, 0.0], [-49.0, 0.0], [-49.0, 1.0], [-50.0, 1.0]]
    assert np.array_equal(orca_velocities(*inputs), orca_velocities(*inputs, obstacles=far))
    assert np.array_equal(orca_velocities(*inputs), orca_velocities(*inputs, obstacles=np.empty((1, 0, 0, 2))))


def test_nobody_walks_through_a_wall():
    wall = np.array([[[[-3.0, 1.0], [3.0, 1.0]]]])
    position, up = np.array([[[0.2, 0.0]]]), np.array([[[0.0, 1.0]]])
    velocity = np.zeros_like(up)
    for _ in range(40):
        velocity = orca_velocities(position, velocity, up, np.full((1, 1), 0.3), np.ones((1, 1)), obstacles=wall)
        position = position + 0.25 * velocity
    assert 0.6 < position[0, 0, 1] <= 0.7 + 1e-6


def test_two_agents_in_one_place_part_in_opposite_directions():
    position, velocity = np.zeros((1, 2, 2)), np.zeros((1, 2, 2))
    preferred = np.array([[[0.0, 1.0], [0.0, -1.0]]])
    radius, speed = np.full((1, 2), 0.3), np.ones((1, 2))
    velocity = orca_velocities(position, velocity, preferred, radius, speed)
    assert velocity[0, 0, 0] * velocity[0, 1, 0] < 0.0
    assert velocity[0, 0, 0] == -velocity[0, 1, 0]
    for _ in range(8):
        position = position + 0.25 * velocity
        velocity = orca_velocities(position, velocity, preferred, radius, speed)
    assert np.linalg.norm(position[0, 0] - position[0, 1]) > 0.6


def test_one_thread_and_many_give_the_same_bits(monkeypatch):
    inputs = scenes(200, 8)
    monkeypatch.setattr(orca, "BLOCK_AGENTS", (10**9, 10**9))
    serial = orca_velocities(*inputs)
    monkeypatch.setattr(orca, "BLOCK_AGENTS", (1, 10))
    assert np.array_equal(serial, orca_velocities(*inputs))


def test_a_world_does_not_depend_on_its_batch():
    inputs = scenes(20, 6)
    together = orca_velocities(*inputs)
    alone = [orca_velocities(*(array[w : w + 1] for array in inputs))[0] for w in range(20)]
    assert np.array_equal(together, np.stack(alone))


def test_nobody_avoids_an_agent_that_is_not_seen():
    position, velocity, preferred, radius, speed = scenes(50, 6)
    seen = np.ones((50, 6), bool)
    seen[:, 0] = False
    with_ghost = orca_velocities(position, velocity, preferred, radius, speed, seen=seen)
    without = orca_velocities(position[:, 1:], velocity[:, 1:], preferred[:, 1:], radius[:, 1:], speed[:, 1:])
    assert np.array_equal(with_ghost[:, 1:], without)


def test_an_agent_that_does_not_move_gets_no_velocity():
    moves = np.zeros((50, 6), bool)
    moves[:, 0] = True
    inputs = scenes(50, 6)
    moved = orca_velocities(*inputs, moves=moves)
    assert not moved[:, 1:].any()
    assert np.array_equal(moved[:, 0], orca_velocities(*inputs)[:, 0])


def test_only_the_nearest_neighbors_count():
    position, velocity, preferred, radius, speed = scenes(50, 6)
    distance = np.linalg.norm(position[:, 1:] - position[:, :1], axis=-1)
    nearest = 1 + distance.argmin(axis=1)
    pair = np.stack([np.zeros(50, int), nearest], axis=1)
    take = lambda array: np.take_along_axis(array, pair.reshape(50, 2, *[1] * (array.ndim - 2)), axis=1)  # noqa: E731
    limited = orca_velocities(position, velocity, preferred, radius, speed, max_neighbors=1)
    alone = orca_velocities(*map(take, (position, velocity, preferred, radius, speed)))
    assert np.array_equal(limited[:, 0], alone[:, 0])
    assert not np.array_equal(limited, orca_velocities(position, velocity, preferred, radius, speed))


def test_neighbors_beyond_the_distance_do_not_count():
    inputs = scenes(50, 6)
    preferred = inputs[2]
    blind = orca_velocities(*inputs, neighbor_distance=0.0)
    speed = np.linalg.norm(preferred, axis=-1, keepdims=True)
    assert np.allclose(blind, preferred / np.maximum(speed, 1.0), atol=1e-12)


def test_nobody_is_faster_than_its_maximum():
    position, velocity, preferred, radius, speed = scenes(100, 12)
    limit = np.random.default_rng(1).uniform(0.3, 1.5, speed.shape)
    taken = np.linalg.norm(orca_velocities(position, velocity, 3 * preferred, radius, limit), axis=-1)
    assert (taken <= limit * (1 + 1e-9)).all()
    assert taken.max() > 1.0


def test_read_only_arrays_and_a_limit_have_no_kernel_of_their_own():
    position, velocity, preferred, radius, speed = scenes(2, 5)
    orca_velocities(position, velocity, preferred, radius, speed)
    compiled = len(orca.avoid_block.signatures)
    speed.flags.writeable = False
    orca_velocities(position, velocity, preferred, radius, speed, max_neighbors=3, line_of_sight=True)
    assert len(orca.avoid_block.signatures) == compiled
