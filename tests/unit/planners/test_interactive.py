"""`mppi_interactive`: ways among walls, goals inferred from headings, futures by ORCA, and the same in any batch."""

import dataclasses

import numpy as np
import pytest

from agents.planners.mppi_interactive import geodesics, goal_belief
from agents.planners.mppi_interactive import mppi_interactive as interactive
from agents.planners.mppi_interactive.roll_out import roll_out
from crowdbench import ORCA, Cases, load_planner, load_scenario, rollout
from crowdbench.catalog import PLANNERS
from crowdbench.sim.sensor import observe
from crowdbench.sim.visibility_graph import find_routes
from crowdbench.utils.errors import InputError

FOLDER = PLANNERS.folder / "mppi_interactive"

DOOR = load_scenario("door_10")
STEPS = 18


@pytest.fixture(scope="module")
def worlds():
    """Worlds at a door with all that the simulator knows, before each of the first steps; the vehicle goes straight."""
    kept = []
    rollout("straight", DOOR, "val:6", watch=kept.append)
    return kept[:10]


def observed(world):
    return observe(world, np.arange(len(world)))


def length(goals, start, ahead):
    """The lengths in metres of ways of short steps in the directions of `ahead`."""
    at, step, total = start, 0.1, np.zeros(start.shape[:-1])
    for _ in range(200):
        way = ahead(at) - at
        left = np.linalg.norm(goals - at, axis=-1)
        forward = np.minimum(left, step)[..., None] * way / np.maximum(np.linalg.norm(way, axis=-1), 1e-9)[..., None]
        at, total = at + forward, total + np.minimum(left, step)
    np.testing.assert_allclose(at, goals, atol=1e-6)
    return total


def test_ways_are_the_shortest_ones_through_a_door(worlds):
    obs = observed(worlds[0])
    found = geodesics.find_geodesics(obs.obstacles, obs.vehicle.position[:, None])
    start, radius = obs.vehicle.position[0], 0.1
    number = found.exists[0].sum()
    assert number > 40
    assert len(found.table) == 1  # the walls are the same in all cases
    goals = found.goal[0, :number]
    chosen = np.arange(number)[None, :, None]
    mine = length(
        goals[None, :, None], np.tile(start, (1, number, 1, 1)), lambda at: found.ahead(np.array([0]), at, chosen)
    )
    starts = np.tile(start, (number, 1))
    route = find_routes(starts, goals, np.full(number, radius), obs.obstacles[0])
    for k in range(number):
        points = np.concatenate([start[None], route[k][np.isfinite(route[k, :, 0])], goals[k, None]])
        assert mine[0, k, 0] == pytest.approx(np.linalg.norm(np.diff(points, axis=0), axis=1).sum(), rel=0.04)


def test_the_posterior_concentrates_on_the_true_goals(worlds):
    belief = goal_belief.GoalBelief(goal_belief.INFERENCE, 4)
    masses = []
    for world in worlds:
        obs = observed(world)
        belief.update(obs)
        off = belief.ways().goal[:, :, None] - world.goal[:, None, 1:]
        masses.append(((np.linalg.norm(off, axis=3) < 2.0) * belief.posterior(obs)).sum(axis=1)[world.present[:, 1:]])
    prior = (np.linalg.norm(off, axis=3) < 2.0).sum(axis=1) / belief.ways().exists.sum(axis=1)[:, None]
    assert np.mean(masses[-1]) > 1.6 * np.mean(prior)
    assert np.mean(masses[-1]) > np.mean(masses[0])


def test_who_walks_straight_at_a_candidate_heads_for_it(worlds):
    obs = observed(worlds[0])
    obs = dataclasses.replace(obs, obstacles=obs.obstacles[:, :0])
    belief = goal_belief.GoalBelief(dataclasses.replace(goal_belief.INFERENCE, concentration=40.0), 1)
    start, crowd = np.zeros((len(obs), 1, 2)), obs.pedestrians
    velocity = np.broadcast_to([0.6, 0.8], crowd.velocity.shape)
    for step in range(12):
        position = start + obs.dt * step * velocity
        people = dataclasses.replace(crowd, position=position, velocity=velocity, seen=np.ones_like(crowd.seen))
        belief.update(shown := dataclasses.replace(obs, pedestrians=people, step=obs.step + step))
    best = belief.ways().goal[np.arange(len(obs))[:, None], belief.posterior(shown).argmax(axis=1)] - position
    cosine = (best @ [0.6, 0.8]) / np.linalg.norm(best, axis=2)
    assert cosine.min() > np.cos(0.2)


def test_somebody_else_in_the_same_place_of_the_arrays_has_no_evidence(worlds):
    belief = goal_belief.GoalBelief(goal_belief.INFERENCE, 1)
    for world in worlds:
        belief.update(observed(world))
    obs = observed(worlds[-1])
    position = obs.pedestrians.position.copy()
    position[0, 0] += 3.0
    people = dataclasses.replace(obs.pedestrians, position=position)
    before = belief.log.copy()
    belief.update(dataclasses.replace(obs, pedestrians=people, step=obs.step + 1))
    bound = goal_belief.INFERENCE.concentration * obs.dt
    assert np.abs(belief.log[0, :, 0]).max() <= bound < np.abs(before[0, :, 0]).max()


def test_goals_of_futures_are_stratified_over_the_posterior(worlds):
    belief = goal_belief.GoalBelief(goal_belief.INFERENCE, 50)
    belief.update(obs := observed(worlds[0]))
    sampled, posterior = belief.sample(obs), belief.posterior(obs)
    for goal in range(posterior.shape[1]):
        share = (sampled == goal).mean(axis=1)
        assert np.abs(share - posterior[:, goal]).max() <= 1.0 / 50 + 1e-9


@pytest.mark.parametrize(("share", "new", "number"), [(0.0, 0, 0), (0.15, 3, 1), (0.5, 3, 3), (1.0, 6, 6)])
def test_each_person_ignores_the_vehicle_in_a_share_of_the_futures_of_its_own(worlds, share, new, number):
    belief = goal_belief.GoalBelief(goal_belief.INFERENCE, 6)
    belief.update(obs := observed(worlds[0]))
    assert (belief.ignores(obs, share).sum(axis=1) == new).all()
    for world in worlds[1:]:
        belief.update(obs := observed(world))
    ignores = belief.ignores(obs, share)
    assert (ignores.sum(axis=1)[obs.pedestrians.seen] == number).all()
    if number == 1:
        assert ignores.any(axis=2).sum() > len(obs)  # not all in the same future


@pytest.mark.parametrize(("walks", "number"), [("blind", 6), ("aware", 1)])
def test_people_who_walk_as_if_they_ignored_the_vehicle_do_so_in_more_futures(worlds, walks, number):
    belief = goal_belief.GoalBelief(goal_belief.INFERENCE, 6)
    *earlier, before, now = map(observed, worlds[:6])
    for obs in (*earlier, before):
        belief.update(obs)
    true, other = now.pedestrians.velocity, now.pedestrians.velocity + 0.5
    belief.foresee(before, *((true, other) if walks == "aware" else (other, true)))
    belief.update(now)
    present = now.pedestrians.seen & (np.hypot(*np.moveaxis(true, 2, 0)) > goal_belief.SLOW)
    assert present.sum() > 20
    assert (belief.ignores(now, 0.15).sum(axis=1)[present] == number).all()


def test_people_avoid_the_vehicle_in_futures_in_which_they_do_not_ignore_it(worlds):
    obs = observed(worlds[0])
    plan = np.zeros((len(obs), 6, 2))
    none, some, everybody = (interactive.GoalRollOuts(goal_belief.INFERENCE, 6, share) for share in (0.0, 0.15, 1.0))
    found = [each.predict_given(obs, 6, plan).position for each in (none, some, everybody)]
    ignores = some.belief.ignores(obs, 0.15)[:, :, None, :, None]
    np.testing.assert_array_equal(found[1], np.where(ignores, found[2], found[0]))
    assert (found[0] != found[2]).any()


def test_with_the_true_goals_and_speeds_people_are_foreseen(worlds):
    world = worlds[2]
    obs, present = observed(world), world.present[:, 1:]
    goal, speed = world.goal[:, None, 1:], world.preferred_speed[:, None, 1:]
    found = geodesics.find_geodesics(obs.obstacles, goal.reshape(len(obs), -1, 2))
    heads = lambda at: np.where(at[..., 1:] * goal[..., 1:] < 0.0, [0.0, 0.0], goal)  # noqa: E731 (through the door)
    foreseen = roll_out(ORCA(), obs, heads, speed, 7, limits=DOOR.rules.walking[:3]).position[:, 0]
    true = worlds[9].position[:, 1:]
    still = obs.pedestrians.position + 7 * obs.dt * obs.pedestrians.velocity
    errors = [np.linalg.norm(each - true, axis=2)[present].mean() for each in (foreseen[:, -1], still)]
    assert errors[0] < 0.5 * errors[1], errors
    assert found.exists.any()


def test_people_of_a_roll_out_avoid_a_vehicle_whose_plan_is_given(worlds):
    obs = observed(worlds[0])
    goals = obs.pedestrians.position[:, None] - 5.0
    speed = np.ones(goals.shape[:3])
    plan = np.zeros((len(obs), 6, 2))
    blind, sees = (roll_out(ORCA(), obs, goals, speed, 6, plan=each).position for each in (None, plan))
    assert (blind != sees).any()
    with pytest.raises(InputError, match="shape of goals"):
        roll_out(ORCA(), obs, goals[:1], speed, 6)


@pytest.mark.slow
def test_a_world_is_the_same_in_a_batch_and_a_run_works():
    scenario, cases = load_scenario("blocks_12"), Cases.parse("val:3")
    options = {"futures": 3}
    together, alone = (
        [rollout(load_planner("mppi_interactive", options), scenario, each) for each in parts]
        for parts in ([cases], [Cases("val", k, k + 1) for k in range(3)])
    )
    assert (together[0].outcome > 0).all()
    for k, trace in enumerate(alone):
        steps = trace.steps[0]
        assert together[0].outcome[k] == trace.outcome[0]
        np.testing.assert_array_equal(together[0].command[k, :steps], trace.command[0, :steps])
