"""What becomes of pedestrians who arrive, and of those who change their minds on the way."""

import dataclasses
import itertools

import numpy as np
import pytest
from helpers import Still, drive, failed_checks, fixture, same
from helpers import trace as trace_of

from crowdbench.catalog import load_scenario
from crowdbench.check.checks import Subject
from crowdbench.check.drives import SCENARIO
from crowdbench.cli.app import app
from crowdbench.core import rng
from crowdbench.core.geometry import norm
from crowdbench.envs.parallel import parallel_env
from crowdbench.envs.vector import VehicleVectorEnv
from crowdbench.metrics.registry import deflection, time_to_collision
from crowdbench.predict import ConstantVelocity
from crowdbench.record.entities import draw_episode
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.layouts import LAYOUTS
from crowdbench.scenario.placement import LayoutCall
from crowdbench.scenario.population import ARRIVALS
from crowdbench.scenario.respawn import LayoutWithRespawn, Surroundings
from crowdbench.sim.sensor import observe
from crowdbench.sim.simulator import crowd_decisions, step
from crowdbench.train.replay_memory import transitions
from crowdbench.utils.errors import InputError
from studies.social_gan.prediction_errors import on_scenario

MINDS = {"period": 1.0, "chance": 0.3}
FAST = {"mean": 1.5, "std": 0.4, "low": 1.0, "high": 2.0}


def restless(arrival, cases="12", scenario="circle_crossing_5", planner=None, **overrides):
    """Episodes to the time limit, in which pedestrians arrive; the vehicle stands where nobody walks."""
    changes = {"layout__circle_radius": 6.0, "time_limit": 15.0, "pedestrians__preferred_speed": FAST}
    changes = changes if scenario.startswith("circle") else {"time_limit": 15.0}
    return drive(planner or Still(), cases, scenario, pedestrians__arrival=arrival, **changes | overrides)


def arrivals(trace):
    """Where a pedestrian was nearer to its goal than its radius: whether, `[world, time, pedestrian]`."""
    return (norm(trace.position - trace.goal) < trace.radius)[:, :, 1:]


@pytest.mark.slow
@pytest.mark.parametrize("arrival", ARRIVALS)
def test_a_case_is_the_same_alone_and_in_a_batch(arrival):
    together = restless(arrival, scenario="circle_crossing_mixed", pedestrians__goal_change=MINDS)
    for case in (0, 7):
        alone = restless(
            arrival, f"{case}:{case + 1}", scenario="circle_crossing_mixed", pedestrians__goal_change=MINDS
        )
        for name in ("position", "goal", "radius", "present", "person"):
            one, other = getattr(alone, name)[0], getattr(together, name)[case]
            assert np.array_equal(one, other, equal_nan=True), name


@pytest.mark.parametrize("arrival", ["new_goal", "respawn", "back_and_forth"])
def test_a_case_among_walls_is_the_same_alone_and_in_a_batch(arrival):
    together = restless(arrival, "4", fixture("corridor"), planner="straight", pedestrians__goal_change=MINDS)
    assert (np.diff(together.goal[:, :, 1:], axis=1) != 0.0).any()
    alone = restless(arrival, "2:3", fixture("corridor"), planner="straight", pedestrians__goal_change=MINDS)
    assert np.array_equal(alone.position[0], together.position[2], equal_nan=True)


def test_who_stops_stands_where_it_has_arrived():
    trace = restless("stop")
    row, time, who = np.argwhere(arrivals(trace))[0]
    path = trace.position[row, time : trace.steps[row] + 1, 1 + who]
    assert len(path) > 5
    assert (path == path[0]).all()


def test_who_leaves_is_gone():
    trace = restless("leave")
    gone = trace.present[:, :1, 1:] & ~trace.present[:, :, 1:]
    assert gone.any()
    assert not (gone[:, :-1] & ~gone[:, 1:]).any()
    assert (trace.person[gone] == -1).all()
    assert np.isnan(trace.position[:, :, 1:][gone]).all()
    running = np.arange(trace.gap.shape[1]) < trace.steps[:, None]
    empty = gone[:, :-1].all(axis=2) & running
    assert empty.any()
    assert np.isinf(trace.gap[empty]).all()


def test_who_gets_a_new_goal_walks_on_to_it():
    trace = restless("new_goal")
    changed = (np.diff(trace.goal[:, :, 1:], axis=1) != 0.0).any(axis=3)
    assert changed.sum() > 10
    assert (trace.person == trace.person[:, :1]).all()
    row, time, who = np.argwhere(changed).T
    arrived = norm(trace.position[row, time + 1, who + 1] - trace.goal[row, time, who + 1])
    assert (arrived < trace.radius[row, time, who + 1]).all()
    assert (norm(trace.goal[row, time + 1, who + 1] - trace.position[row, time + 1, who + 1]) >= 1.0).all()


def test_who_walks_back_and_forth_has_two_goals():
    trace = restless("back_and_forth", time_limit=40.0)
    goals = trace.goal[0, :, 1]
    assert len(np.unique(goals, axis=0)) == 2
    assert any((goals == trace.position[0, 0, 1]).all(axis=1))
    assert (np.diff(goals, axis=0) != 0.0).any(axis=1).sum() >= 2


def test_somebody_new_comes_in_clear_of_everybody_and_at_rest():
    trace = restless("respawn", pedestrians__radius={"mean": 0.3, "std": 0.1, "low": 0.2, "high": 0.4})
    new = np.argwhere(np.diff(trace.person, axis=1) != 0)
    assert len(new) > 10
    for row, time, who in new + np.array([0, 1, 0]):
        assert trace.person[row, time, who] == trace.person[row, time - 1, who] + 5
        assert (trace.velocity[row, time, 1 + who] == 0.0).all()
        distance = norm(trace.position[row, time] - trace.position[row, time, 1 + who])
        gap = np.delete(distance - trace.radius[row, time] - trace.radius[row, time, 1 + who], 1 + who)
        assert (gap >= 0.2 - 1e-9).all() or len(new[(new[:, 0] == row) & (new[:, 1] == time - 1)]) > 1
    assert len(np.unique(trace.radius[0, :, 1:])) > 5
    for row in range(len(trace)):
        assert len(np.unique(trace.person[row])) == 5 + (new[:, 0] == row).sum()


def test_somebody_new_has_no_past():
    place = load_scenario("circle_crossing_5", {"pedestrians.arrival": "respawn", "pedestrians.preferred_speed": 2.0})
    world = place.worlds(Cases.parse("20"))
    came = 0
    for _ in range(25):
        crowd, decided = crowd_decisions(world, place.policies)
        before, (world, _) = world, step(decided, np.zeros((20, 2)), crowd, place.post_step_rule)
        new = before.person != world.person
        came += new.sum()
        seen = observe(world).pedestrians
        assert (seen.observed[new] == 1).all()
        assert (seen.observed[~new] > 1).all()
        where = world.position[:, 1:][new]
        assert (seen.history.swapaxes(1, 2)[new] == where[:, None]).all()
        assert (world.origin[:, 1:][new] == where).all()
        assert (world.since[new] == world.step[0]).all()
    assert came > 20


@pytest.mark.slow
def test_goals_change_at_multiples_of_the_period_by_chance():
    trace = restless("walk_on", "60", pedestrians__goal_change={"period": 2.0, "chance": 0.5}, time_limit=6.5)
    changed = (np.diff(trace.goal[:, :, 1:], axis=1) != 0.0).any(axis=3)
    steps = np.unique(np.nonzero(changed)[1]) + 1
    assert steps.tolist() == [8, 16]
    assert changed[:, steps - 1].mean() == pytest.approx(0.5, abs=0.08)
    assert not (np.diff(trace.goal[:, :, 0], axis=1) != 0.0).any()


def test_nothing_happens_where_nobody_arrives_or_changes_its_mind():
    never = {"period": 1.0, "chance": 0.0}
    plain = drive("orca", "10")
    assert same(plain, drive("orca", "10", pedestrians__goal_change=never))


def test_a_period_is_a_multiple_of_dt():
    with pytest.raises(InputError, match=r"goal_change.period is 0.3, but must be a multiple of dt, 0.25 s"):
        load_scenario("circle_crossing_5", {"pedestrians.goal_change": {"period": 0.3, "chance": 0.5}})
    with pytest.raises(InputError, match=r"arrival is 'sit', but must be one of \"walk_on\", \"stop\""):
        load_scenario("circle_crossing_5", {"pedestrians.arrival": "sit"})


def test_a_crowd_moved_by_another_policy_keeps_its_habits():
    here = {"pedestrians.arrival": "stop", "pedestrians.goal_change": MINDS}
    assert load_scenario("circle_crossing_5", here, "social_force").crowd.arrival == "stop"


def test_the_goal_of_an_agent_of_pettingzoo_that_goes_on_does_not_terminate_it():
    place = {"pedestrians.arrival": "respawn", "pedestrians.preferred_speed": 2.0, "time_limit": 12.0}
    env = parallel_env(load_scenario("circle_crossing_5", place), reward="progress", observation="goal_frame")
    env.reset(options={"case": "test/3"})
    outcomes, paid = [], []
    while env.agents:
        _, rewards, _, _, infos = env.step({"vehicle": np.zeros(2)})
        outcomes += [infos[agent]["is_success"] for agent in infos if agent != "vehicle"]
        paid += [rewards[agent] for agent in rewards if agent != "vehicle"]
        assert len(env.agents) in (0, 6)
    assert sum(outcomes) >= 5
    assert max(map(abs, paid)) < 1.5


@pytest.mark.parametrize("arrival", ["walk_on", "stop", "leave"])
def test_an_agent_of_pettingzoo_that_has_arrived_for_good_never_comes_back(arrival):
    place = {"pedestrians.arrival": arrival, "pedestrians.preferred_speed": 2.0, "time_limit": 12.0}
    env = parallel_env(load_scenario("circle_crossing_5", place))
    env.reset(options={"case": "test/3"})
    seen = [set(env.agents)]
    while env.agents:
        env.step({"vehicle": np.zeros(2)})
        seen.append(set(env.agents))
    assert all(after <= before for before, after in itertools.pairwise(seen))
    assert seen[-2] == {"vehicle"}


def test_vehicle_environments_have_the_people_of_a_rollout():
    trace = restless("respawn", "3")
    place = {"layout.circle_radius": 6.0, "time_limit": 15.0, "pedestrians.preferred_speed": FAST}
    envs = VehicleVectorEnv(3, load_scenario("circle_crossing_5", {**place, "pedestrians.arrival": "respawn"}))
    envs.reset(options={"case": [f"test/{case}" for case in range(3)]})
    for t in range(1, 30):
        envs.step(np.zeros((3, 2)))
        running = trace.steps > t
        assert np.array_equal(envs._worlds.position[running], trace.position[running, t])


def test_metrics_compare_nobody_with_somebody_else():
    path = [[[0.0, 0.0], [5.0, 0.0]], [[0.0, 0.0], [0.7, 0.0]]]
    jump = trace_of(path, undisturbed=[[[5.0, 0.0]], [[np.nan, np.nan]]])
    velocity = jump.velocity.copy()
    velocity[0, 1] = [[1.0, 0.0], [0.0, 0.0]]
    jump = dataclasses.replace(jump, velocity=velocity)
    assert time_to_collision(jump)[0] == pytest.approx(4.4)
    person = jump.person.copy()
    person[:, 1:] = 7
    assert np.isnan(time_to_collision(dataclasses.replace(jump, person=person))[0])
    assert np.isnan(deflection(jump)[0])


def test_the_way_without_the_vehicle_is_compared_as_long_as_the_people_are_the_same():
    trace = restless("respawn", "6", "circle_crossing_5_visible", planner="orca")
    known = np.isfinite(trace.undisturbed).all(axis=3)
    there = np.isfinite(trace.position[:, :, 1:]).all(axis=3)
    assert known[:, 0].all()
    assert (known <= there).all()
    assert np.isfinite(deflection(trace)).all()


def test_a_predictor_is_measured_on_people_who_go_on():
    place = {"layout.circle_radius": 6.0, "time_limit": 15.0, "pedestrians.preferred_speed": FAST}
    errors = [
        on_scenario("cv", ConstantVelocity(), load_scenario("circle_crossing_5", {**place, **more}), Cases.parse("4"))
        for more in ({}, {"pedestrians.arrival": "respawn"})
    ]
    first, second = (error.first.ade[-1] for error in errors)
    assert second.mean < 1.0
    assert second.n == first.n == 4
    assert first.mean != second.mean


def test_transitions_know_who_has_left():
    found = transitions(restless("leave", "4"), 3)
    assert found.present.any()
    assert found.next_present.sum() < found.present.sum()
    assert not (found.next_present & ~found.present).any()


@pytest.mark.parametrize("arrival", ["leave", "respawn"])
def test_runs_with_them_are_recorded_and_replayed(arrival, tmp_path, capsys):
    run = ["run", "--planner", "orca", "--scenario", "circle_crossing_5", "--cases", "3", "--record", "all"]
    settings = [f"pedestrians.arrival={arrival}", "pedestrians.goal_change={period=1.0,chance=0.3}"]
    out = str(tmp_path / "run")
    app([*run, *(part for each in settings for part in ("--set", each)), "--out", out], standalone_mode=False)
    app(["score", out], standalone_mode=False)
    assert "All agree" in capsys.readouterr().out.replace("\n", " ")


def test_no_line_of_a_picture_leads_from_one_person_to_another():
    trace = restless("respawn", "1")
    drawn = [chunk for chunk in draw_episode(trace, 0, "", {}) if chunk.entity_path == "/world/trails"]
    lines = drawn[1].to_record_batch().column("LineStrips2D:strips").to_pylist()
    steps = [np.hypot(*np.subtract(*stroke)) for strokes in lines for stroke in strokes]
    assert max(steps) < 2.0 * 0.25 + 1e-6


def draw_corner(rng, room, radius, preferred_speed, position, *, circle_radius=4.0, **others):
    """Somebody new comes from the right, and all go far to the left."""
    start = np.array([circle_radius + rng.random(), 0.0]) if position is None else position
    return (start, np.array([-20.0, 0.0])) if room.is_clear(start, radius) or position is not None else None


def test_a_layout_can_say_how_people_come_again():
    layout = LayoutWithRespawn(LAYOUTS["circle_crossing"], draw_corner)
    place = load_scenario("circle_crossing_5", {"pedestrians.arrival": "respawn", "pedestrians.preferred_speed": 2.0})
    starts = dataclasses.replace(place.starts, layout=LayoutCall(layout, **place.layout.keywords))
    place = dataclasses.replace(place, starts=starts)
    world = place.worlds(Cases.parse("1"))
    for _ in range(24):
        crowd, decided = crowd_decisions(world, place.policies)
        world, _ = step(decided, np.zeros((1, 2)), crowd, place.post_step_rule)
    new = world.person[0] >= 5
    assert new.any()
    assert (world.goal[0, 1:][new] == [-20.0, 0.0]).all()
    assert not failed_checks(Subject(SCENARIO, lambda: place, "corner", {"": place}))


def draw_by_dice(rng, room, radius, preferred_speed, position, **options):
    """Somebody new comes from anywhere beyond all others, and nobody gets another goal."""
    farthest = room.position[:, 0].max() + 2.0 + np.random.random()  # noqa: NPY002
    return (np.array([farthest, 0.0]), np.zeros(2)) if position is None else None


AGAIN = {
    "raises": (lambda *_, **__: 1 / 0, "the layout raised ZeroDivisionError"),
    "no way": (lambda *_, **__: (np.zeros(2),), "but must draw a start and a goal, two points in metres"),
    "not a number": (lambda *_, **__: (np.zeros(2), np.full(2, np.nan)), "but must draw a start and a goal"),
    "inside": (lambda rng, room, *_, **__: (room.position[0], np.ones(2)), "overlaps another agent"),
    "dice": (draw_by_dice, "differ when repeated, first in the episode of case "),
}


@pytest.mark.parametrize("name", AGAIN)
def test_an_offence_when_people_are_drawn_again_is_found(name):
    again, expected = AGAIN[name]
    place = load_scenario("circle_crossing_5", {"pedestrians.arrival": "respawn", "pedestrians.preferred_speed": 2.0})
    layout = LayoutCall(LayoutWithRespawn(LAYOUTS["circle_crossing"], again))
    place = dataclasses.replace(place, starts=dataclasses.replace(place.starts, layout=layout))
    failed = failed_checks(Subject(SCENARIO, lambda: place, "mine", {"": place}, neural=False))
    assert expected in next(iter(failed.values()))


def test_room_is_clear_away_from_people_goals_and_walls():
    box = np.array([[[5.0, 5.0], [7.0, 5.0], [7.0, 7.0], [5.0, 7.0]]])
    room = Surroundings(np.zeros((1, 2)), np.array([[0.0, 3.0]]), np.array([0.3]), np.ones(1), box)
    assert room.is_clear(np.array([0.85, 0.0]), 0.3)
    assert not room.is_clear(np.array([0.75, 0.0]), 0.3)
    assert not room.is_clear(np.array([0.75, 3.0]), 0.3)
    assert not room.is_clear(np.array([6.0, 6.0]), 0.3)
    assert not room.is_clear(np.array([4.3, 6.0]), 0.3)
    assert room.is_clear(np.array([4.1, 6.0]), 0.3)


def test_uniform_numbers_are_uniform_and_of_their_own():
    person = np.tile(np.arange(5), (2000, 1))
    drawn = rng.draw_uniforms(np.arange(2000, dtype=np.uint64), "mind", np.zeros(2000, np.int64), person)
    assert ((drawn >= 0.0) & (drawn < 1.0)).all()
    assert drawn.mean() == pytest.approx(0.5, abs=0.02)
    alone = rng.draw_uniforms(np.arange(7, 8, dtype=np.uint64), "mind", np.zeros(1, int), np.array([[3, 1]]))
    assert np.array_equal(alone, drawn[7:8, [3, 1]])
    streams = [rng.generator(np.uint64(1), "x", step, person).random() for step in range(3) for person in range(3)]
    assert len(set(streams)) == 9
