import json

import numpy as np
import pytest
from helpers import Still, drive, with_walkers

from agents.pedestrians import power_law
from crowdbench.catalog import load_scenario
from crowdbench.core.geometry import norm
from crowdbench.networks.weights import WEIGHTS
from crowdbench.scenario.cases import Cases
from crowdbench.sim.pedestrians import forces


def power_law_velocities(*inputs, **options):
    """The function of that name, with agents and parameters as arguments."""
    return with_walkers(power_law.power_law_velocities, power_law.PARAMETERS, *inputs, **options)


K, TAU0, XI, BOUND = 1.5, 3.0, 0.54, 20.0
"""The paper's numbers, written out."""

H = power_law.SUB_STEP
"""A step without sub-steps, in seconds."""


def energy(i, position, velocity, radius, walls=()):
    """The energy of agent i with all others and with walls, by stepping through time until they touch."""
    found = 0.0
    for j in range(len(position)):
        if j != i:
            found += of_tau(until(position[j] - position[i], velocity[j] - velocity[i], radius[i] + radius[j]))
    return found + sum(of_tau(until_wall(position[i], velocity[i], radius[i], wall)) for wall in walls)


def of_tau(tau):
    return K / tau**2 * np.exp(-tau / TAU0) if np.isfinite(tau) else 0.0


def until(between, motion, reach):
    """The first root of |between + t motion| = reach."""
    roots = np.roots([motion @ motion, 2 * between @ motion, between @ between - reach**2])
    times = [root.real for root in roots if abs(root.imag) < 1e-12 and root.real > 0]
    return min(times, default=np.inf)


def until_wall(position, velocity, radius, wall):
    """When a disc first touches a segment: bisection between times at which it does not and does."""

    def distance(t):
        a, b = wall
        share = np.clip((position + t * velocity - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
        return np.linalg.norm(position + t * velocity - a - share * (b - a)) - radius

    times = np.linspace(0, 20, 801)
    touching = [t for t in times if distance(t) < 0]
    if not touching:
        return np.inf
    low, high = touching[0] - times[1], touching[0]
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (low, middle) if distance(middle) < 0 else (middle, high)
    return high


def slow_velocities(position, velocity, goal, radius, speed, h, walls=()):
    """One sub-step, the gradient by differences."""
    out = np.empty_like(velocity)
    for i in range(len(position)):
        ahead = goal[i] - position[i]
        desired = ahead / np.linalg.norm(ahead) * min(speed[i], np.linalg.norm(ahead))
        force = np.empty(2)
        for axis in range(2):
            sides = []
            for step in (-1e-6, 1e-6):
                moved = position.copy()
                moved[i, axis] += step
                sides.append(energy(i, moved, velocity, radius, walls))
            force[axis] = -(sides[1] - sides[0]) / 2e-6
        force *= min(1.0, BOUND / max(np.linalg.norm(force), 1e-9))
        out[i] = velocity[i] + (1 - np.exp(-h / XI)) * (desired + XI * force - velocity[i])
        out[i] *= min(1.0, speed[i] / np.linalg.norm(out[i]))
    return out


def apart(rng, agents, size):
    """Places that do not overlap."""
    while True:
        position = rng.uniform(-size, size, (agents, 2))
        if all(np.linalg.norm(position[i] - position[j]) > 0.9 for i in range(agents) for j in range(i)):
            return position


@pytest.mark.parametrize("seed", range(5))
def test_forces_are_gradients_of_the_energy(seed):
    rng = np.random.default_rng(seed)
    position, goal = apart(rng, 5, 2.5), rng.uniform(-6, 6, (5, 2))
    velocity, radius = rng.uniform(-1, 1, (5, 2)), rng.uniform(0.2, 0.4, 5)
    speed = rng.uniform(1.0, 1.6, 5)
    expected = slow_velocities(position, velocity, goal, radius, speed, H)
    got = power_law_velocities(*(each[None] for each in (position, velocity, goal, radius, speed)), time_step=H)
    assert np.allclose(got[0], expected, atol=2e-5)
    free = power_law_velocities(
        *(each[None] for each in (position, velocity, goal, radius, speed)), time_step=H, interaction_energy=0.0
    )
    assert not np.allclose(got, free, atol=1e-3)


@pytest.mark.parametrize(
    ("position", "velocity"), [((0.0, -1.5), (0.3, 0.8)), ((2.6, -1.0), (-0.5, 0.9)), ((0.4, -1.5), (0.3, -0.8))]
)
def test_walls_are_somebody_who_stands(position, velocity):
    # The first walks towards the side, the second towards an end, the third away.
    wall = np.array([[-2.0, 0.0], [2.0, 0.0]])
    state = [np.array([each], float) for each in (position, velocity, (5.0, 5.0))]
    radius, speed = np.array([0.3]), np.array([1.5])
    expected = slow_velocities(*state, radius, speed, H, [wall])
    arrays = [each[None] for each in (*state, radius, speed)]
    assert np.allclose(power_law_velocities(*arrays, time_step=H, obstacles=wall[None, None])[0], expected, atol=2e-5)
    repelled = not np.allclose(power_law_velocities(*arrays, time_step=H)[0], expected, atol=1e-3)
    assert repelled == (velocity[1] > 0)


def test_of_an_obstacle_only_what_is_touched_first_repels():
    square = np.array([[-1.0, 0.0], [1.0, 0.0], [1.0, 2.0], [-1.0, 2.0]])
    arrays = [np.array([[each]]) for each in ([0.0, -2.0], [0.0, 1.0], [0.0, 9.0])]
    arrays += [np.array([[0.3]]), np.array([[1.0]])]
    side = power_law_velocities(*arrays, time_step=H, obstacles=square[None, None, :2])
    assert np.array_equal(power_law_velocities(*arrays, time_step=H, obstacles=square[None, None]), side)
    assert side[0, 0, 1] < 1.0


def test_an_agent_alone_gains_speed_with_the_relaxation_time():
    arrays = np.zeros((1, 1, 2)), np.zeros((1, 1, 2)), np.array([[[50.0, 0.0]]]), np.array([[0.3]]), np.array([[1.2]])
    got = power_law_velocities(*arrays, time_step=0.5)
    assert got[0, 0] == pytest.approx([1.2 * (1 - np.exp(-0.5 / XI)), 0.0])


def test_who_overlaps_is_pushed_apart_and_no_more_than_the_bound_allows():
    position = np.array([[[0.0, 0.0], [0.5, 0.1]]])
    velocity = np.array([[[0.2, 0.0], [-0.2, 0.0]]])
    goal = position + np.array([[[9.0, 0.0], [-9.0, 0.0]]])
    arrays = position, velocity, goal, np.full((1, 2), 0.3), np.full((1, 2), 1.0)
    got = power_law_velocities(*arrays, time_step=H)
    assert got[0, 0, 0] < 0.0 < got[0, 1, 0]
    gentle = power_law_velocities(*arrays, time_step=H, max_acceleration=2.0)
    gain = 1 - np.exp(-H / XI)
    driven = velocity + gain * ([[[1.0, 0.0], [-1.0, 0.0]]] - velocity)
    assert norm(gentle - driven)[0] == pytest.approx(2 * [gain * XI * 2.0])


@pytest.mark.slow
def test_threads_do_not_change_it(monkeypatch):
    rng = np.random.default_rng(1)
    state = rng.uniform(-4, 4, (3, 7, 6, 2))
    radius, speed = np.full((7, 6), 0.3), np.full((7, 6), 1.0)
    serial = power_law_velocities(*state, radius, speed)
    monkeypatch.setattr(forces, "BLOCK_PAIRS", 1)
    assert np.array_equal(power_law_velocities(*state, radius, speed), serial)


def test_the_circle_is_crossed():
    crowd = {"pedestrians__policy": "power_law", "vehicle__radius": 0.01}
    trace = drive(Still(), "val:10", "circle_crossing_10", time_limit=30.0, **crowd)
    ended = trace.steps > 100
    assert ended.sum() >= 5
    remaining = norm(trace.goal[:, :, 1:] - trace.position[:, :, 1:])[ended]
    assert (np.nanmin(remaining, axis=1) < 0.3).mean() > 0.9
    assert np.nanmax(norm(trace.velocity)) <= 1.0 + 1e-9


def test_a_case_does_not_depend_on_its_batch():
    scenario = load_scenario("circle_crossing_10", pedestrians="power_law")
    many, one = (scenario.worlds(Cases("val", *bounds)) for bounds in ((0, 4), (2, 3)))
    policy, names = scenario.policies["power_law"], many.parameters["power_law"]
    got = policy.velocities(many, names)[2]
    assert np.array_equal(got, policy.velocities(one, one.parameters["power_law"])[0])


def test_no_planner_that_comes_along_is_trained_among_them():
    cards = list(WEIGHTS.glob("*.json"))
    assert len(cards) > 10
    for card in cards:
        assert "power_law" not in json.dumps(json.loads(card.read_text())), card.name
