import numba
import numpy as np
import pytest
from helpers import Still, drive, same

from crowdbench.catalog import load_planner, load_scenario
from crowdbench.core.types import Outcome
from crowdbench.planners.driver import Driver
from crowdbench.planners.planner import Planner
from crowdbench.runs import rollout as rollouts
from crowdbench.runs.rollout import rollout
from crowdbench.runs.spec import Replanning
from crowdbench.scenario.cases import Cases
from crowdbench.sim.pedestrians import PedestrianPolicy
from crowdbench.sim.sensor import observe
from crowdbench.sim.simulator import crowd_velocities, step, step_pedestrians
from crowdbench.utils.errors import InputError
from crowdbench.views.ego import flatten

SCENARIOS = ["circle_crossing_5", *(f"circle_crossing_5_{kind}" for kind in ("visible", "gaussian", "social_force"))]


def rows(trace, chosen):
    """The trace of some of its episodes, as far as `same` looks."""
    import dataclasses

    changes = {
        field.name: getattr(trace, field.name)[chosen]
        for field in dataclasses.fields(trace)
        if isinstance(getattr(trace, field.name), np.ndarray)
    }
    return dataclasses.replace(trace, **changes)


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_a_case_does_not_depend_on_its_batch(scenario):
    together = drive("orca", "120", scenario)
    for start in (0, 57, 119):
        assert same(drive("orca", f"{start}:{start + 1}", scenario), rows(together, slice(start, start + 1)))


def test_threads_change_nothing():
    one_thread, threads = 1, numba.get_num_threads()
    parallel = drive("orca", "150")
    numba.set_num_threads(one_thread)
    try:
        assert same(parallel, drive("orca", "150"))
    finally:
        numba.set_num_threads(threads)


@pytest.mark.parametrize("policy", ["orca", "social_force"])
@pytest.mark.parametrize("visible", [False, True])
def test_padding_changes_nothing(policy, visible):
    place = load_scenario("circle_crossing_5", {"pedestrians.policy": policy, "vehicle.visible": visible})
    tight = place.worlds(Cases.parse("val:20"))
    wide = padded(tight, 3)
    planner = load_planner("orca")
    for _ in range(20):
        moved = []
        for world in (tight, wide):
            crowd = crowd_velocities(world, place.policies)
            moved.append(step(world, planner.plan(observe(world)), crowd))
        (tight, check), (wide, check_wide) = moved
        assert np.array_equal(tight.position, wide.position[:, :6])
        assert all(map(np.array_equal, check, check_wide))
        assert np.array_equal(flatten(observe(tight)), flatten(observe(wide))[:, :36])


def padded(world, more):
    """The same worlds with absent pedestrians, who stand where they would be in everybody's way."""

    def widen(values, fill):
        axis = 2 if values is world.history else 1
        shape = (*values.shape[:axis], more, *values.shape[axis + 1 :])
        return np.concatenate([values, np.full(shape, fill, values.dtype)], axis=axis)

    fills = {"position": 0.1, "velocity": 0.5, "goal": 3.0, "radius": 1.0, "preferred_speed": 1.0, "present": False}
    fills |= {"history": 0.1, "policy": 0, "person": -1, "group": -1, "route": np.nan, "waypoint": 0}
    parameters = {
        name: {key: widen(values, values.max()) for key, values in table.items()}
        for name, table in world.parameters.items()
    }
    changes = {name: widen(getattr(world, name), fill) for name, fill in fills.items()}
    return world.replace(**changes, parameters=parameters)


def test_an_invisible_vehicle_is_hidden_from_every_policy():
    seen = []

    class Looks(PedestrianPolicy):
        def velocities(self, world, parameters):
            seen.append(world.present[:, 0].any())
            return np.zeros((len(world), world.position.shape[1] - 1, 2))

    for visible in (False, True):
        world = load_scenario("circle_crossing_5", {"vehicle.visible": visible}).worlds(Cases.parse("2"))
        crowd_velocities(world.replace(parameters={"looks": {}}), {"looks": Looks()})
    assert seen == [False, True]


def test_an_episode_is_nan_after_its_end():
    trace = drive("orca", "30")
    after = np.arange(trace.position.shape[1]) > trace.steps[:, None]
    assert np.isnan(trace.position[after]).all()
    assert np.isfinite(trace.position[~after]).all()
    assert np.isnan(trace.gap[after[:, 1:]]).all()


def test_standing_still_ends_in_time_out():
    trace = drive(Still(), "50")
    assert set(trace.outcome) == {Outcome.TIMEOUT}
    assert (trace.steps == 97).all()


def test_the_undisturbed_crowd_is_the_crowd_of_an_invisible_vehicle():
    visible, unseen = drive("orca", "30", "circle_crossing_5_visible"), drive("orca", "30")
    both = np.minimum(visible.steps, unseen.steps)
    for w in range(30):
        assert np.array_equal(visible.undisturbed[w, : both[w] + 1], unseen.position[w, : both[w] + 1, 1:])
    assert unseen.undisturbed is None


@pytest.mark.parametrize("wanted", [True, False])
def test_the_undisturbed_crowd_is_simulated_to_the_end_of_each_episode_where_it_is_wanted(wanted, monkeypatch):
    walks = []
    monkeypatch.setattr(
        rollouts,
        "step_pedestrians",
        lambda world, *others: walks.append(len(world)) or step_pedestrians(world, *others),
    )
    driver, place = Driver(load_planner("orca"), "orca"), load_scenario("circle_crossing_5_visible")
    trace = rollout(driver, place, Cases.parse("30"), undisturbed=wanted)
    assert sum(walks) == (trace.steps.sum() if wanted else 0)
    assert (trace.undisturbed is not None) == wanted
    if wanted:
        assert trace.steps.min() < trace.steps.max()
        after = np.arange(trace.position.shape[1]) > trace.steps[:, None]
        assert np.array_equal(np.isnan(trace.undisturbed).all(axis=(2, 3)), after)


def test_what_a_planner_logs_lands_at_its_case_and_step():
    class Talker(Still):
        def plan(self, obs):
            obs.log("clock", obs.row * 1000.0 + obs.step)
            return super().plan(obs)

    trace = rollout(Driver(Talker(), "talker"), load_scenario("circle_crossing_5"), Cases.parse("20"), keep_logs=True)
    steps = np.arange(trace.gap.shape[1])
    expected = np.where(steps < trace.steps[:, None], trace.case[:, None] * 1000.0 + steps, np.nan)
    assert np.array_equal(trace.logs["clock"], expected, equal_nan=True)


def test_a_privileged_planner_sees_the_true_next_velocities():
    seen = []

    class Oracle(Still):
        privileged = True

        def plan(self, obs):
            seen.append(obs.true_next().copy())
            return super().plan(obs)

    trace = drive(Oracle(), "1")
    assert np.array_equal(np.concatenate(seen), trace.velocity[0, 1 : len(seen) + 1, 1:])


def test_replanning_every_step_is_planning():
    assert same(drive("orca", replan_every=1), drive("orca"))


class Ahead(Planner):
    """Plans the same few moves again and again: odd worlds drive up, even ones wait. Keeps when it was asked what."""

    privileged = True

    def __init__(self):
        self.asked = []

    def plan(self, obs):
        raise AssertionError("only asked for several steps at once")

    def plan_ahead(self, obs, steps):
        self.asked.append((int(obs.step[0]), steps, obs.row, obs.true_next()))
        obs.log("clock", obs.row * 1000.0 + obs.step)
        return self.moves(self.number(obs), np.arange(steps)) + 1e-3 * obs.pedestrians.position[:, :1]

    @staticmethod
    def number(start):
        """A number below 100 that each case keeps in any batch."""
        return (start.noise_key % np.uint64(100)).astype(int)

    @staticmethod
    def moves(number, k):
        """The commands of worlds before a pedestrian's position is added, so that none is like another."""
        return np.stack(np.broadcast_arrays(0.01 * k, 0.9 * (number[:, None] % 2) + 1e-4 * number[:, None]), axis=2)


def test_a_plan_of_several_steps_is_carried_out_without_looking():
    planner = Ahead()
    trace = drive(planner, "40", replan_every=8)
    assert {Outcome.COLLISION, Outcome.TIMEOUT} <= set(trace.outcome)
    assert (trace.steps % 8 != 0).any()
    assert [(start, steps) for start, steps, *_ in planner.asked] == [(start, 8) for start in range(0, 97, 8)]
    for start, _, row, future in planner.asked:
        running = trace.steps > start
        assert np.array_equal(row, np.flatnonzero(running))
        assert np.array_equal(future, trace.velocity[running, start + 1, 1:])
    number = Ahead.number(load_scenario("circle_crossing_5").worlds(Cases.parse("40")))
    for w in range(40):
        t = np.arange(trace.steps[w])
        seen = trace.position[w, t - t % 8, 1]
        expected = Ahead.moves(number[w : w + 1], t % 8)[0] + 1e-3 * seen
        assert np.array_equal(trace.velocity[w, t + 1, 0], expected)


def test_a_case_planned_ahead_does_not_depend_on_its_batch():
    together = drive(Ahead(), "40", replan_every=8)
    for w in (0, 17, 39):
        assert same(drive(Ahead(), f"{w}:{w + 1}", replan_every=8), rows(together, slice(w, w + 1)))


def test_a_planner_that_plans_ahead_logs_only_when_it_is_asked():
    place, cases = load_scenario("circle_crossing_5"), Cases.parse("20")
    trace = rollout(Driver(Ahead(), "ahead"), place, cases, replanning=Replanning(8, 1), keep_logs=True)
    t = np.arange(trace.gap.shape[1])
    asked = (t < trace.steps[:, None]) & (t % 8 == 0)
    expected = np.where(asked, trace.case[:, None] * 1000.0 + t, np.nan)
    assert np.array_equal(trace.logs["clock"], expected, equal_nan=True)


class Looking(Ahead):
    """Waits at single steps, and keeps how many positions of a pedestrian it has seen at each of its decisions."""

    def plan(self, obs):
        self.asked.append((int(obs.step[0]), 1, int(obs.pedestrians.observed[0, 0])))
        return np.zeros((len(obs), 2))

    def plan_ahead(self, obs, steps):
        self.asked.append((int(obs.step[0]), steps, int(obs.pedestrians.observed[0, 0])))
        return np.zeros((len(obs), steps, 2))


@pytest.mark.parametrize("look_first", [1, 3, 8, 20])
def test_a_planner_decides_at_single_steps_until_it_has_seen_as_many_positions_as_it_is_told(look_first):
    planner = Looking()
    trace = drive(planner, "1", replan_every=4, look_first=look_first)
    single = [(t, 1, min(t + 1, 8)) for t in range(look_first - 1)]
    several = [(t, 4, min(t + 1, 8)) for t in range(look_first - 1, trace.steps[0], 4)]
    assert planner.asked == single + several


def test_where_a_planner_observes_every_step_it_does_not_matter_how_long_it_looks_first():
    assert same(drive("orca", "5", look_first=8), drive("orca", "5"))


def test_a_planner_looks_again_after_one_step_or_more_and_sees_one_position_or_more():
    with pytest.raises(InputError, match="replan_every is 0"):
        drive("orca", "1", replan_every=0)
    with pytest.raises(InputError, match="look_first is 0"):
        drive("orca", "1", look_first=0)


def test_mixed_crowds_move_each_by_its_own_policy():
    # Shares decide who follows which; in a crowd of one policy everybody moves as there.
    shares = {"orca": 1, "social_force": 1}
    both = drive("orca", "val:40", pedestrians__policy=shares)
    orca = drive("orca", "val:40")
    place = load_scenario("circle_crossing_5", {"pedestrians.policy": shares})
    policy = place.worlds(Cases.parse("val:40")).policy
    first = both.velocity[:, 1, 1:], orca.velocity[:, 1, 1:]
    alike = np.abs(first[0] - first[1]).max(axis=-1) < 1e-12
    assert np.array_equal(alike, policy == 0)


def test_planners_load_with_their_options():
    planner = load_planner("orca", {"safety_space": 0.2})
    assert planner.safety_space == 0.2
