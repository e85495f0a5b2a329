import numpy as np
import pytest
from helpers import advance, check_step, world

from crowdbench.core.geometry import toward_goal
from crowdbench.core.reward import discount, reward
from crowdbench.core.types import HISTORY, Outcome, Rules, World
from crowdbench.sim.pedestrians import ORCA, PedestrianPolicy
from crowdbench.sim.pedestrians.orca import orca_velocities
from crowdbench.sim.sensor import observe
from crowdbench.sim.simulator import crowd_velocities, step
from crowdbench.utils.errors import InputError

POLICIES = {"orca": ORCA()}


def outcome_of(before, velocity):
    after = advance(before, np.array([velocity], float))
    outcome, gap, _ = check_step(before, after)
    return Outcome(outcome[0]), gap[0]


def test_everybody_moves_with_its_velocity():
    after = advance(world([[0, 0], [3, 0]]), np.array([[[0.4, 0.2], [-1.0, 0.0]]]))
    assert after.position.tolist() == [[[0.1, 0.05], [2.75, 0.0]]]
    assert after.velocity.tolist() == [[[0.4, 0.2], [-1.0, 0.0]]]
    assert after.step.tolist() == [1]


@pytest.mark.parametrize("collision", ["swept", "crowdnav", "crowdnav_plus"])
def test_a_step_is_the_motion_and_its_check(collision):
    random = np.random.default_rng(0)
    before = world(random.normal(size=(5, 2)), random.normal(size=(5, 2)), rules=Rules(collision=collision))
    velocity = random.normal(size=(1, 5, 2))
    after, check = step(before, velocity[:, 0], velocity[:, 1:])
    moved = advance(before, velocity)
    for name, value in vars(moved).items():
        if isinstance(value, np.ndarray):
            assert np.array_equal(vars(after)[name], value)
    assert all(map(np.array_equal, check, check_step(before, moved)))


@pytest.mark.parametrize("visible", [True, False])
def test_pedestrians_get_from_orca_what_all_agents_get(visible):
    random = np.random.default_rng(0)
    now = world(3.0 * random.normal(size=(40, 2)), random.normal(size=(40, 2)), rules=Rules(visible=visible))
    present = np.arange(40) != 7
    now = now.replace(present=present[None])
    moves = present[None] & (np.arange(40) > 0)
    everybody = orca_velocities(
        now.position,
        now.velocity,
        toward_goal(now.position, now.goal, now.preferred_speed),
        now.radius + 0.01,
        now.preferred_speed,
        time_horizon_obst=1.0,
        seen=now.present & (visible | (np.arange(40) > 0)),
        moves=moves,
    )
    for _ in range(2):
        assert np.array_equal(crowd_velocities(now, POLICIES), everybody[:, 1:])
        # As many worlds as are worth several threads.
        now, everybody = now.take(np.zeros(11, np.int64)), np.repeat(everybody, 11, axis=0)


def test_speed_is_limited_to_the_preferred_speed_but_for_rounding():
    after = advance(world([[0, 0], [9, 0]]), np.array([[[3.0, 4.0], [1.0 + 5e-7, 0.0]]]))
    assert after.velocity[0, 0] == pytest.approx([0.6, 0.8], abs=1e-15)
    assert after.velocity[0, 1, 0] == 1.0 + 5e-7


def test_the_world_is_left_as_it_was():
    before = world([[0, 0], [3, 0]])
    copies = {name: getattr(before, name).copy() for name in ("position", "velocity", "history", "step")}
    advance(before, np.ones((1, 2, 2)))
    assert all(np.array_equal(getattr(before, name), copy) for name, copy in copies.items())


def test_absent_agents_do_not_move_collide_or_count():
    before = world([[0, 0], [0.1, 0]]).replace(present=np.array([[True, False]]))
    after = advance(before, np.ones((1, 2, 2)))
    assert after.position[0, 1].tolist() == [0.1, 0.0]
    outcome, gap, _ = check_step(before, after)
    assert (outcome[0], gap[0]) == (Outcome.RUNNING, np.inf)
    pedestrians = observe(after).pedestrians
    assert (pedestrians.seen[0, 0], pedestrians.observed[0, 0], pedestrians.age[0, 0]) == (False, 0, np.inf)


def test_a_world_after_a_step_is_a_world():
    after = advance(world([[0, 0], [3, 0]]), np.ones((1, 2, 2)))
    # Shapes are checked where a World is made from its fields.
    again = World(**vars(after))
    assert vars(again).keys() == vars(world([[0, 0], [3, 0]])).keys()


def test_a_world_has_no_fields_but_its_own():
    with pytest.raises(TypeError, match="a World has no field positoin"):
        world([[0, 0]]).replace(positoin=np.zeros((1, 1, 2)))


def test_history_holds_the_last_positions_and_says_how_many_are_real():
    now = world([[0, 0], [0, 5]])
    seen = [now.position[0, 1].copy()]
    for t in range(10):
        pedestrians = observe(now).pedestrians
        assert pedestrians.observed[0, 0] == min(t + 1, HISTORY)
        assert pedestrians.age[0, 0] == 0.0
        expected = ([seen[0]] * HISTORY + seen)[-HISTORY:]
        assert np.array_equal(pedestrians.history[0, :, 0], expected)
        now = advance(now, np.array([[[0, 0], [0.1 * t, -0.3]]]))
        seen.append(now.position[0, 1].copy())


def test_passing_through_somebody_within_a_step_is_a_collision():
    assert outcome_of(world([[0, 0], [0.65, 0.3]]), [[1, 0], [-1, 0]])[0] is Outcome.COLLISION
    outcome, gap = outcome_of(world([[0, 0], [2.0, 0.7]]), [[1, 0], [-1, 0]])
    assert outcome is Outcome.RUNNING
    assert gap == pytest.approx(np.hypot(1.5, 0.7) - 0.6)


def test_the_rules_differ_in_the_pedestrians_velocity():
    position, before, after = [[0, 0], [0.8, 0]], [[0, 0], [0, 0]], [[0, 0], [-1, 0]]
    swept = outcome_of(world(position, before), after)
    crowdnav = outcome_of(world(position, before, rules=Rules(collision="crowdnav")), after)
    assert swept[0] is Outcome.COLLISION
    assert crowdnav[0] is Outcome.RUNNING
    assert crowdnav[1] == pytest.approx(0.2)


def test_under_the_rule_of_crowdnav_plus_nothing_moves():
    rules = Rules(collision="crowdnav_plus")
    into, still = [[1, 0], [-1, 0]], [[0, 0], [0, 0]]
    assert outcome_of(world([[0, 0], [0.8, 0]], rules=rules), into) == (Outcome.RUNNING, pytest.approx(0.2))
    assert outcome_of(world([[0, 0], [0.5, 0]], rules=rules), still)[0] is Outcome.COLLISION
    near = world([[0, 0], [5, 5]], goal=[[0.5, 0], [9, 9]], rules=rules)
    assert outcome_of(near, into)[0] is Outcome.RUNNING
    there = world([[0.25, 0], [5, 5]], goal=[[0.5, 0], [9, 9]], rules=rules)
    assert outcome_of(there, [[-1, 0], [0, 0]])[0] is Outcome.SUCCESS


def test_touching_is_no_collision_yet():
    assert outcome_of(world([[0, 0], [0.5, 0]], radius=0.25), [[0, 0], [0, 0]]) == (Outcome.RUNNING, 0.0)


def test_the_goal_is_reached_nearer_than_the_radius():
    assert outcome_of(world([[0, 0], [5, 5]], goal=[[0.5, 0], [9, 9]]), [[1, 0], [0, 0]])[0] is Outcome.SUCCESS
    assert outcome_of(world([[0, 0], [5, 5]], goal=[[0.5501, 0], [9, 9]]), [[1, 0], [0, 0]])[0] is Outcome.RUNNING


def test_time_out_comes_before_collision_and_collision_before_success():
    into = [[1, 0], [0, 0]]
    place, goal = [[0, 0], [0.6, 0]], [[0.25, 0], [9, 9]]
    assert outcome_of(world(place, goal=goal), into)[0] is Outcome.COLLISION
    assert outcome_of(world(place, goal=goal, step=96), into)[0] is Outcome.TIMEOUT
    assert outcome_of(world([[0, 0], [9, 0]], goal=goal, step=95), into)[0] is Outcome.SUCCESS
    assert Rules().max_steps == 97


@pytest.mark.parametrize("dt", [0.1, 0.25, 0.3, 0.4, 0.7])
def test_the_last_step_starts_a_second_before_the_limit_at_any_dt(dt):
    rules = Rules(dt=dt)
    last = rules.max_steps - 1
    assert last * dt >= 24.0 - 1e-9 > (last - 1) * dt
    far = [[0, 0], [9, 9]]
    assert outcome_of(world(far, step=last, rules=rules), [[0, 0], [0, 0]])[0] is Outcome.TIMEOUT
    assert outcome_of(world(far, step=last - 1, rules=rules), [[0, 0], [0, 0]])[0] is Outcome.RUNNING


def nan_for_the_second(world):
    velocity = np.zeros((len(world), world.position.shape[1] - 1, 2))
    velocity[:, 1, 0] = np.nan
    return velocity


@pytest.mark.parametrize(
    ("answer", "expected"),
    [
        (lambda world: 1 / 0, "pedestrian policy mine raised ZeroDivisionError (case 0, step 0): division by zero"),
        (
            lambda world: np.zeros((len(world), 2)),
            "returned float64 of shape (1, 2), but must return float64 of shape (1, 2, 2)",
        ),
        (lambda world: "left", "returned 'left', but must return float64"),
        (nan_for_the_second, "returned [nan, 0.0] for pedestrian 1 of case 0, but a velocity must be finite"),
    ],
)
def test_a_broken_policy_gets_one_sentence(answer, expected):
    class Mine(PedestrianPolicy):
        def velocities(self, world, parameters):
            return answer(world)

    here = world([[0, 0], [3, 0], [6, 0]])
    with pytest.raises(InputError) as error:
        crowd_velocities(here.replace(parameters={"mine": {}}), {"mine": Mine()})
    assert expected in str(error.value)


def test_pedestrians_see_the_vehicle_only_where_it_is_visible():
    place, goal = [[0, 0.05], [2, 0]], [[9, 0], [-4, 0]]
    moving = [[1, 0], [-1, 0]]
    unseen = crowd_velocities(world(place, moving, goal), POLICIES)
    seen = crowd_velocities(world(place, moving, goal, rules=Rules(visible=True)), POLICIES)
    assert unseen[0, 0] == pytest.approx([-1, 0])
    assert abs(seen[0, 0, 1]) > 0.05


def test_the_future_is_shown_to_privileged_planners_only():
    now = world([[0, 0], [3, 0]])
    with pytest.raises(PermissionError, match="privileged"):
        observe(now).true_next()
    future = np.ones((1, 1, 2))
    assert observe(now, future=future).true_next() is future


def test_the_reward_of_each_branch():
    outcome = np.array([Outcome.RUNNING, Outcome.RUNNING, Outcome.SUCCESS, Outcome.COLLISION, Outcome.TIMEOUT])
    gap = np.array([0.1, 0.3, 0.1, -0.1, -0.1])
    assert reward(outcome, gap, 0.25) == pytest.approx([-0.1 * 0.5 * 0.25, 0, 1, -0.25, 0])
    assert reward(outcome, gap, 0.5)[0] == pytest.approx(-0.1 * 0.5 * 0.5)
    assert discount(np.array([1.0, 2.0]), 0.25) == pytest.approx([0.9**0.25, 0.9**0.5])
