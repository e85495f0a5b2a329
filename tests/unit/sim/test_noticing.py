"""The model of attention: who notices the vehicle, and who adapts to it."""

import copy
import math
from pathlib import Path

import numpy as np
import pytest
from helpers import world

from agents.pedestrians.orca_people import ORCAPeople
from crowdbench.catalog import load_planner, load_scenario
from crowdbench.core.types import Rules
from crowdbench.core.types.attention import ATTRACTED, AVOIDS, IGNORES, YIELDS_LATE, Attention
from crowdbench.planners.driver import Driver
from crowdbench.runs.rollout import rollout
from crowdbench.scenario.cases import Cases
from crowdbench.sim.attention import AttentionState, adapted_view, init_attention, update_attention
from crowdbench.sim.pedestrians import ORCA
from crowdbench.sim.simulator import ATTENTION, crowd_decisions, init_memories
from crowdbench.utils.errors import InputError

ALERT = Attention(distracted=0.0)
WALL = np.array([[[[1.0, -1.0], [1.0, 1.0]]]])


def rules(attention=ALERT):
    return Rules(visible=True, attention=attention)


def scene(vehicle, velocity=(0.0, 0.0), attention=ALERT, walking=(1.0, 0.0)):
    """A pedestrian at the origin who walks along x, and the vehicle somewhere."""
    return world([vehicle, [0.0, 0.0]], [velocity, walking], [[0.0, 0.0], [20.0, 0.0]], rules=rules(attention))


def watch(world, steps, state=None):
    """Whether the pedestrian adapts in each of some steps in which nothing moves, and the state after them."""
    state, adapts = state or init_attention(world), []
    for step in range(steps):
        adapt, state = update_attention(world.replace(step=world.step + step), world.velocity[:, 1:], state)
        adapts.append(bool(adapt[0, 0]))
    return adapts, state


# Noticing.


@pytest.mark.parametrize(
    ("vehicle", "obstacles", "is_noticed"),
    [
        ((3.0, 0.0), None, True),
        ((9.99, 0.0), None, True),
        ((10.01, 0.0), None, False),
        ((3.0 * math.cos(1.30), 3.0 * math.sin(1.30)), None, True),
        ((3.0 * math.cos(1.32), 3.0 * math.sin(1.32)), None, False),
        ((-1.0, 0.0), None, False),
        ((3.0, 0.0), WALL, False),
    ],
)
def test_a_vehicle_in_view_is_noticed_after_the_delay(vehicle, obstacles, is_noticed):
    seen = scene(vehicle)
    if obstacles is not None:
        seen = seen.replace(obstacles=obstacles)
    remaining, state = [], init_attention(seen)
    for _ in range(4):
        state = update_attention(seen, seen.velocity[:, 1:], state)[1]
        remaining.append(state.remaining[0, 0])
    # First seen at 0 s, and the delay of 0.4 s has passed at 0.5 s.
    assert remaining == ([0.0, 0.0, 5.0, 5.0] if is_noticed else [0.0] * 4)


def test_a_noticed_vehicle_is_kept_in_mind_for_five_seconds():
    state = watch(scene((3.0, 0.0)), 3)[1]
    behind = scene((-0.7, 0.0))
    adapts, state = watch(behind, 25, state)
    assert adapts == [True] * 19 + [False] * 6
    # It has to be noticed again.
    assert watch(scene((3.0, 0.0)), 3, state)[0] == [False, False, True]


def test_somebody_else_in_the_same_place_of_the_arrays_has_noticed_nothing():
    before = scene((3.0, 0.0))
    state = watch(before, 3)[1]
    assert watch(before.replace(person=before.person + 7), 3, state)[0] == [False, False, True]


def test_a_pedestrian_who_stands_faces_where_it_walked():
    state = watch(scene((-0.9, 0.0), walking=(-1.0, 0.0)), 1)[1]
    assert watch(scene((-0.9, 0.0), walking=(0.0, 0.0)), 3, state)[0] == [False, True, True]


# Adapting.


@pytest.mark.parametrize(
    ("vehicle", "velocity", "adapts"),
    [
        ((4.0, 0.0), (-1.0, 0.0), True),  # head-on
        ((4.0, 0.9), (-1.0, 0.0), True),
        ((4.0, 1.1), (-1.0, 0.0), False),  # passes at more than 1 m
        ((4.0, 0.0), (1.0, 0.0), False),  # as fast ahead
        ((4.0, 0.0), (0.0, 0.0), True),  # stands in the way
        ((0.8, 0.0), (2.0, 0.0), True),  # leaves, but is within 1 m
    ],
)
def test_pedestrians_adapt_where_the_closest_approach_is_below_one_metre(vehicle, velocity, adapts):
    assert watch(scene(vehicle, velocity), 3)[0][-1] == adapts


def test_the_limit_of_the_approach_grows_with_the_vehicle():
    large = scene((4.0, 1.5), (-1.0, 0.0))
    assert not watch(large, 3)[0][-1]
    radius = large.radius.copy()
    radius[:, 0] += 0.6
    assert watch(large.replace(radius=radius), 3)[0][-1]


@pytest.mark.parametrize(("speed", "adapts"), [(0.25, False), (0.15, True)])
def test_pedestrians_who_ignore_the_vehicle_adapt_only_where_it_stands(speed, adapts):
    ignoring = Attention(ignores=1.0, distracted=0.0)
    assert watch(scene((1.0, 0.0), (0.0, speed), ignoring), 3)[0] == [False, False, adapts]


@pytest.mark.parametrize(("distance", "adapts"), [(3.1, False), (2.9, True)])
def test_pedestrians_who_yield_late_adapt_shortly_before(distance, adapts):
    late = Attention(yields_late=1.0, distracted=0.0)
    assert watch(scene((distance, 0.0), (-1.0, 0.0), late), 3)[0][-1] == adapts


def test_attracted_pedestrians_come_and_lose_interest():
    seen = scene((5.0, 3.0), attention=Attention(attracted=1.0, distracted=0.0))
    state = init_attention(seen)
    goals = []
    for _ in range(40):
        _, state = update_attention(seen, seen.velocity[:, 1:], state)
        goals.append(adapted_view(seen, state).goal[0, 1])
    beside = np.array([5.0, 3.0]) * (1.0 - 1.8 / math.hypot(5.0, 3.0))  # 1.2 m between two rims of 0.3 m
    assert np.array_equal(goals[1], seen.goal[0, 1])
    np.testing.assert_allclose(goals[2:33], np.tile(beside, (31, 1)))
    assert np.array_equal(goals[33], seen.goal[0, 1])


def test_traits_are_drawn_by_their_shares():
    crowd = load_scenario(
        "circle_crossing_5_visible",
        {
            "pedestrians.number": 40,
            "layout.circle_radius": 20.0,
            "pedestrians.attention": {"ignores": 0.1, "yields_late": 0.2, "attracted": 0.3, "distracted": 0.25},
        },
    ).worlds(Cases.parse("val:40"))
    state = update_attention(crowd, crowd.velocity[:, 1:], AttentionState(**crowd.memory[ATTENTION]))[1]
    for reaction, share in ((AVOIDS, 0.4), (IGNORES, 0.1), (YIELDS_LATE, 0.2), (ATTRACTED, 0.3)):
        assert (state.reaction == reaction).mean() == pytest.approx(share, abs=0.04)
    is_distracted = ~np.isnan(state.phase)
    assert is_distracted.mean() == pytest.approx(0.25, abs=0.04)
    assert np.ptp(state.phase[is_distracted]) > 9.0


def test_distracted_pedestrians_look_away_for_four_seconds_of_ten():
    beside = scene((3.0, 2.0), attention=Attention(distracted=1.0))  # at 34 degrees
    state, views = init_attention(beside), []
    for step in range(80):
        state = update_attention(beside.replace(step=np.array([step])), beside.velocity[:, 1:], state)[1]
        views.append(state.in_view[0, 0] >= 0.0)
    assert np.mean(views) == pytest.approx(0.6, abs=0.03)
    ahead = scene((3.0, 0.0), attention=Attention(distracted=1.0))
    assert watch(ahead, 80)[0] == [False] * 2 + [True] * 78


# In the simulator.


def test_pedestrians_walk_as_in_a_crowd_with_the_vehicle_or_as_in_one_without_it():
    before = init_memories(scene((1.5, 0.1), (-1.0, 0.0)), {"orca": ORCA()})
    velocities = []
    for _ in range(3):
        velocity, before = crowd_decisions(before, {"orca": ORCA()})
        velocities.append(velocity)
    radius = before.radius.copy()
    radius[:, 0] += 0.2
    before = before.replace(radius=radius)
    with_vehicle, without = (
        crowd_decisions(before.replace(rules=Rules(visible=visible)), {"orca": ORCA()})[0] for visible in (True, False)
    )
    assert not np.array_equal(with_vehicle, without)
    np.testing.assert_array_equal(velocities, [without, without, with_vehicle])


def crossing(attention, visible=True):
    changes = {"pedestrians.number": 12, "pedestrians.policy": {"orca": 0.5, "stop_and_go": 0.5}}
    return load_scenario(
        "circle_crossing_5", {"vehicle.visible": visible, "pedestrians.attention": attention, **changes}
    )


def drive(scenario, cases="val:0:12"):
    planner = load_planner("straight")
    return rollout(Driver(planner, "straight"), scenario, Cases.parse(cases))


def test_a_crowd_that_ignores_the_vehicle_walks_as_if_it_were_invisible():
    ignoring, blind = crossing({"ignores": 1.0}), crossing({}, visible=False)
    np.testing.assert_array_equal(drive(ignoring).position, drive(blind).position)
    assert not np.array_equal(drive(crossing({})).position, drive(blind).position)


def test_a_case_does_not_depend_on_its_batch():
    scenario = crossing({"ignores": 0.2, "yields_late": 0.2, "attracted": 0.2, "distracted": 0.5})
    together, alone = drive(scenario), drive(scenario, "val:5:6")
    steps = alone.position.shape[1]
    np.testing.assert_array_equal(together.position[5, :steps], alone.position[0])
    np.testing.assert_array_equal(together.noticed[5, :steps], alone.noticed[0])
    assert 0.1 < together.noticed.mean() < 0.99


@pytest.mark.parametrize(
    ("changes", "error"),
    [
        ({"pedestrians.attention.ignores": 1.5}, r"attention\.ignores is 1\.5, but must be a share from 0 to 1"),
        ({"pedestrians.attention.ignores": 0.6, "pedestrians.attention.attracted": 0.6}, r"sum to 1 at most"),
        ({"pedestrians.attention.sees": 0.6}, r"attention\.sees"),
    ],
)
def test_impossible_attention_is_refused(changes, error):
    with pytest.raises(InputError, match=error):
        load_scenario("door_10", changes)


# Clearance, and the attention that a policy brings.


def test_people_who_adapt_keep_the_clearance_and_adapt_at_a_distance_that_grows_with_it():
    near, far = (scene((3.0, 1.3), attention=Attention(distracted=0.0, clearance=each)) for each in (0.5, 0.6))
    assert not any(watch(near, 5)[0])  # passes at 1.3 m: adapts below 1 + 0.5 - 0.2 m
    assert watch(far, 5)[0] == [False, False, True, True, True]
    for before, clearance in ((near, 0.5), (far, 0.6), (scene((3.0, 1.3)), 0.2)):
        after = adapted_view(before, watch(before, 5)[1])
        assert after.radius[0].tolist() == pytest.approx([0.3 + clearance, 0.3])


CARS = {"vehicle.visible": True, "pedestrians.policy": "./own.py"}


def write_policy(name, attention):
    Path(f"{name}.py").write_text(
        f"from crowdbench import ORCA\n\n\nclass Own(ORCA):\n    attention = {attention}\n\n\n"
        "def policy():\n    return Own()\n"
    )


@pytest.fixture
def own_attention(tmp_path, monkeypatch):
    """Two policies that bring an attention, in files."""
    monkeypatch.chdir(tmp_path)
    for name, attention in (("own", {"clearance": 0.9, "ignores": 0.3}), ("other", {"clearance": 0.4})):
        write_policy(name, attention)


def attention_of(**changes):
    return load_scenario("circle_crossing_5", CARS | {f"pedestrians.{key}": changes[key] for key in changes}).table[
        "pedestrians"
    ]["attention"]


def test_a_policy_brings_its_attention_and_keys_of_the_scenario_replace_it(own_attention):
    assert attention_of() == Attention(clearance=0.9, ignores=0.3).complete()
    table = {"clearance": 0.2, "delay": 0.0}
    assert attention_of(attention=table) == Attention(clearance=0.2, ignores=0.3, delay=0.0).complete()
    assert attention_of(policy={"orca": 0.5, "./own.py": 0.5})["clearance"] == 0.9
    assert attention_of(policy="orca") is None


def test_the_complete_table_of_a_scenario_makes_the_same_scenario(own_attention):
    scenario = load_scenario("circle_crossing_5", CARS | {"pedestrians.attention": {"clearance": 0.2}})
    again = load_scenario("circle_crossing_5", {**copy.deepcopy(scenario.table), "pedestrians.policy": "./own.py"})
    assert again.table == scenario.table
    assert again.rules.attention.distance == 0.2
    assert "clearance" not in load_scenario("door_10").table["pedestrians"]["attention"]


def test_policies_that_bring_different_attention_are_refused(own_attention):
    with pytest.raises(InputError, match="pedestrian policies other, own have different attention"):
        attention_of(policy={"./own.py": 0.5, "./other.py": 0.5})


@pytest.mark.parametrize(
    ("attention", "message"),
    [
        ({"clearance": -1}, "pedestrian policy wrong: attention.clearance is -1, but"),
        (0.9, "is 0.9, but must be a table"),
    ],
)
def test_a_wrong_attention_of_a_policy_gets_one_sentence(attention, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_policy("wrong", attention)
    with pytest.raises(InputError, match=message):
        attention_of(policy="./wrong.py")


def test_orca_people_cars_avoids_three_discs_of_a_car_and_is_orca_people_beside_a_disc():
    name, cases = "pedestrians.policy", Cases.parse("val:2")
    crowd = load_scenario("circle_crossing_5_visible", {name: "orca_people_cars"})
    policy = crowd.policies["orca_people_cars"]
    now = crowd.worlds(cases)
    parameters = now.parameters["orca_people_cars"]
    assert np.array_equal(policy.velocities(now, parameters), ORCAPeople().velocities(now, parameters))
    # A car of 4.2 m x 1.6 m drives along x at y = 0. Its smallest disc reaches to y = 2.1 m, its body to 0.8 m.
    body = (-1.3, 0.0, 1.3)
    passing = world([[0.0, 0.0], [3.5, 1.6]], [[1.0, 0.0], [-1.0, 0.0]], [[9.0, 0.0], [-9.0, 1.6]])
    passing = passing.replace(radius=np.array([[2.1, 0.2]]), heading=np.zeros(1), rules=Rules(visible=True, body=body))
    values = {key: np.full((1, 2), value) for key, value in policy.parameters.items()}
    assert policy.velocities(passing, values)[0, 0] == pytest.approx([-1.0, 0.0])
    assert ORCAPeople().velocities(passing, values)[0, 0, 1] > 0.05
    onto = passing.replace(position=np.array([[[0.0, 0.0], [3.5, 0.1]]]), goal=np.array([[[9.0, 0.0], [-9.0, 0.1]]]))
    assert policy.velocities(onto, values)[0, 0, 1] > 0.05
