"""Crowds of thousands: who is shown to planners, how they are placed, what environments do with them."""

import math

import numpy as np
import pytest
from helpers import world

from crowdbench.catalog import load_scenario
from crowdbench.core.dynamics import FREE, Unicycle
from crowdbench.core.types import Rules
from crowdbench.envs.parallel import parallel_env
from crowdbench.envs.step_outcomes import outcomes_of_agents
from crowdbench.envs.vehicle import VehicleEnv
from crowdbench.runs.recording import most_failures
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.layouts.placer import CLEARANCE, Points
from crowdbench.sim.sensor import observe, with_nearest
from crowdbench.sim.simulator import crowd_velocities, step
from crowdbench.utils.errors import InputError
from crowdbench.views.ego import flatten, flatten_everybody

SMALL = {"pedestrians.number": 150, "layout.square_width": 40.0}


def scenario(**changes):
    return load_scenario("thousand", SMALL | changes)


def worlds(cases=2, **changes):
    return scenario(**changes).worlds(Cases("test", 0, cases))


def test_planners_are_shown_the_nearest_in_their_order():
    world = worlds(3)
    future = np.random.default_rng(0).normal(size=(3, 150, 2))
    obs = observe(world, future=future)
    assert obs.pedestrians.seen.shape == (3, 20)
    for w in range(3):
        distance = np.linalg.norm(world.position[w, 1:] - world.position[w, 0], axis=1)
        nearest = np.sort(np.argsort(distance, kind="stable")[:20])
        assert np.array_equal(obs.pedestrians.position[w], world.position[w, 1:][nearest])
        assert np.array_equal(obs.pedestrians.history[w], world.history[w][:, nearest])
        assert np.array_equal(obs.true_next()[w], future[w, nearest])


def test_of_two_at_the_same_distance_the_first_one_is_shown():
    world = worlds(1)
    position = world.position.copy()
    position[0, 1:] = position[0, 0] + [3.0, 0.0]
    position[0, 31] = position[0, 0] + [0.0, 1.0]
    shown = observe(world.replace(position=position, radius=np.arange(151.0)[None])).pedestrians.radius[0]
    assert shown.tolist() == [*range(1, 20), 31]


def test_who_is_not_seen_only_fills_places():
    world = worlds(1)
    present = np.zeros((1, 151), bool)
    present[0, [0, 40, 90]] = True
    obs = observe(world.replace(present=present, radius=np.arange(151.0)[None]))
    assert obs.pedestrians.radius[0].tolist() == [*range(1, 19), 40, 90]
    assert np.flatnonzero(obs.pedestrians.seen[0]).tolist() == [18, 19]
    assert (obs.pedestrians.observed[0] > 0).tolist() == obs.pedestrians.seen[0].tolist()


@pytest.mark.parametrize(("number", "given", "shown"), [(100, None, 100), (101, None, 20), (150, 7, 7), (6, 3, 3)])
def test_in_crowds_of_up_to_a_hundred_all_are_shown_unless_the_scenario_says_otherwise(number, given, shown):
    changes = {"pedestrians.number": number} | ({} if given is None else {"sensor.nearest": given})
    base = load_scenario("square_crossing_5", {"layout.square_width": 60.0} | changes)
    obs = observe(base.worlds(Cases("train", 0, 1)))
    assert obs.pedestrians.seen.shape[1] == shown
    assert with_nearest(obs, shown) is obs


@pytest.mark.slow
def test_a_case_of_thousands_does_not_depend_on_its_batch():
    loaded = scenario()
    together = loaded.worlds(Cases("test", 0, 3))
    alone = loaded.worlds(Cases("test", 1, 2))
    for _ in range(3):
        together, _ = step(together, np.full((3, 2), 0.5), crowd_velocities(together, loaded.policies))
        alone, _ = step(alone, np.full((1, 2), 0.5), crowd_velocities(alone, loaded.policies))
    assert np.array_equal(together.position[1], alone.position[0])


def test_points_in_cells_are_as_clear_as_among_all():
    random = np.random.default_rng(0)
    radius = random.uniform(0.1, 0.5, 400).tolist()
    points, placed = Points(radius), []
    for i, own in enumerate(radius):
        for _ in range(20):
            x, y = random.uniform(-8.0, 8.0, 2).tolist()
            clear = all(math.hypot(x - a, y - b) >= own + CLEARANCE + radius[k] for k, (a, b) in enumerate(placed))
            assert points.is_clear(x, y) == clear
        points.append((x, y))
        placed.append((x, y))
        if i % 7 == 3:
            points.pop()
            points.append(placed[-1])


@pytest.mark.slow
def test_thousands_are_placed_apart():
    world = worlds(1, **{"pedestrians.number": 3000, "layout.square_width": 110.0})
    start = world.position[0]
    order = np.argsort(start[:, 0])
    for k in range(1, 60):  # whoever is closer than a metre is among the next in x
        gap = np.linalg.norm(start[order[k:]] - start[order[:-k]], axis=1) - 0.6
        assert gap.min() >= CLEARANCE - 1e-12


@pytest.mark.parametrize("observation", ["flat", "goal_frame", "dict"])
def test_environments_of_thousands_show_the_nearest(observation):
    env = VehicleEnv(scenario(), observation=observation)
    seen, _ = env.reset(options={"case": "test/0"})
    assert env.observation_space.contains(seen)
    assert env.observation_space.contains(env.step(np.array([0.0, 0.5]))[0])


@pytest.mark.parametrize("number", [110, 150])
def test_agents_of_thousands_observe_the_nearest(number):
    loaded = scenario(**{"pedestrians.number": number, "vehicle.visible": False})
    env = parallel_env(loaded)
    seen, _ = env.reset(options={"case": "test/0"})
    assert all(env.observation_space(agent).contains(view) for agent, view in seen.items())
    world = loaded.worlds(Cases("test", 0, 1))
    views = flatten_everybody(world)[0]
    assert np.array_equal(views[0], flatten(observe(world))[0])
    distance = np.linalg.norm(world.position[0] - world.position[0, 9], axis=1)
    distance[[0, 9]] = np.inf  # the vehicle is not visible
    nearest = np.sort(np.argsort(distance)[:20])
    assert np.array_equal(views[9].reshape(-1, 6)[1:, :2], world.position[0, nearest] - world.position[0, 9])


def test_what_needs_a_world_for_each_of_thousands_is_refused():
    with pytest.raises(InputError, match=r"of which 20 are shown, they must be 'flat' or 'lidar', and 'crowdnav'$"):
        parallel_env(scenario(), observation="goal_frame")
    with pytest.raises(InputError, match=r"^observation is 'flat' and reward 'progress', but"):
        parallel_env(scenario(), reward="progress")


def test_fewer_failures_of_large_crowds_are_recorded():
    assert [most_failures(number) for number in (0, 100, 1000, 10_000)] == [100, 100, 10, 1]


def crowd(area, agents=300, dynamics=FREE):
    """A crowd on a square of so many metres, whose agents differ in size and speed; some are absent."""
    rng = np.random.default_rng(agents)
    rules = Rules(visible=True, dynamics=dynamics)
    start = world(rng.uniform(0.0, area, (agents, 2)), rules=rules)
    present = rng.random((1, agents)) < 0.9
    present[:, 0] = True
    return start.replace(
        radius=rng.uniform(0.05, 0.6, (1, agents)), preferred_speed=rng.uniform(0.0, 3.0, (1, agents)), present=present
    )


@pytest.mark.slow
@pytest.mark.parametrize("dynamics", [FREE, Unicycle()])
@pytest.mark.parametrize("area", [4.0, 40.0, 400.0])
def test_the_step_of_all_agents_is_checked_from_cells_as_among_all(area, dynamics, monkeypatch):
    before = crowd(area, dynamics=dynamics)
    asked = 3.0 * np.random.default_rng(1).normal(size=before.velocity.shape)
    after, check = step(before, asked[:, 0], asked[:, 1:])
    found = outcomes_of_agents(before, after, check)
    monkeypatch.setattr("crowdbench.sim.neighbors.CELLS_FROM", math.inf)
    for from_cells, among_all in zip(found, outcomes_of_agents(before, after, check), strict=True):
        np.testing.assert_array_equal(from_cells, among_all)
    assert np.isfinite(found[1]).all()
