"""Several vehicles in a world: each is the vehicle of a row, and an agent among the pedestrians of the other rows."""

import dataclasses
import functools

import numpy as np
import pytest

import crowdbench
from crowdbench.catalog import load_planner, load_scenario
from crowdbench.core.types import Outcome
from crowdbench.metrics.registry import METRICS, OF_FLEETS
from crowdbench.metrics.user_metrics import load_metrics
from crowdbench.planners.driver import Driver
from crowdbench.runs.rollout import rollout
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.placement import Placement
from crowdbench.scenario.scenario import Scenario
from crowdbench.scenario.starts import LayoutStarts
from crowdbench.sim.fleet import end_episodes, in_whole_worlds
from crowdbench.sim.sensor import observe
from crowdbench.utils.errors import InputError

FEW = Cases("test", 0, 6)
WHEELS = {"vehicle.dynamics": "unicycle", "vehicle.max_acceleration": 1.0}


def drive(planner, scenario, cases=FEW, others=None):
    """Return the trace of a planner, and of another one for all vehicles except the first."""
    drivers = [Driver(load_planner(name), name) if name else None for name in (planner, others)]
    return rollout(drivers[0], scenario, cases, others=drivers[1])


def placed(start, goal, **overrides):
    """Return a scenario in which a vehicle starts at each of these points, without pedestrians."""
    keys = {"vehicle.number": len(start), "pedestrians.number": 0, "time_limit_factor": 4.0, **overrides}
    scenario = load_scenario("fleet_4", {name.replace("__", "."): value for name, value in keys.items()})

    def layout(rng, radius, preferred_speed):
        return Placement(np.array(start, float), np.array(goal, float))

    return dataclasses.replace(scenario, starts=LayoutStarts(functools.partial(layout)))


def same(a, b, rows_a, rows_b, *names):
    """Return whether traces have the same bits in some of their rows."""
    return all(np.array_equal(getattr(a, name)[rows_a], getattr(b, name)[rows_b], equal_nan=True) for name in names)


OWN = ("outcome", "steps", "heading", "command", "gap")


@pytest.mark.slow
@pytest.mark.parametrize("overrides", [{}, WHEELS], ids=["holonomic", "wheels"])
def test_vehicles_out_of_range_have_the_bits_of_each_alone(monkeypatch, overrides):
    sensing = {"sensor.range": 8.0, "sensor.missed": 0.1, "sensor.noise.position": 0.1}
    scenario = placed([[0, 0], [30, 0]], [[0, 8], [30, 8]], **sensing, **overrides)
    both = drive("mppi", scenario, Cases("test", 0, 1))
    assert not np.array_equal(both.command[0], both.command[1]), "each vehicle has its own noise"
    draw = Scenario.draw
    for alone in range(2):
        other = np.where(np.arange(2) == alone, Outcome.RUNNING, Outcome.SUCCESS)
        monkeypatch.setattr(Scenario, "draw", lambda self, *case, other=other: end_episodes(draw(self, *case), other))
        trace = drive("mppi", scenario, Cases("test", 0, 1))
        assert same(both, trace, alone, alone, *OWN)
        assert np.array_equal(both.position[alone, :, 0], trace.position[alone, :, 0], equal_nan=True)


@pytest.mark.parametrize("name", ["fleet_4", "fleet_door_3"])
def test_a_case_has_the_same_bits_in_any_batch(name):
    scenario = load_scenario(name, {"sensor.range": 6.0, "sensor.missed": 0.1})
    together = drive("orca_margin", scenario)
    vehicles = scenario.rules.vehicles
    for case in (0, 3, 5):
        alone, rows = drive("orca_margin", scenario, Cases("test", case, case + 1)), np.arange(vehicles)
        assert same(together, alone, case * vehicles + rows, rows, "position", "velocity", "present", "seen", *OWN)


def test_the_order_of_vehicles_changes_nothing_but_their_streams():
    scenario, order = load_scenario("fleet_4"), np.array([2, 0, 3, 1])
    layout = scenario.starts.layout

    def reordered(*arguments):
        placement = layout(*arguments)
        agents = np.append(order, np.arange(4, len(placement.start)))
        return Placement(placement.start[agents], placement.goal[agents])

    other = dataclasses.replace(scenario, starts=LayoutStarts(functools.partial(reordered)))
    before, after = drive("orca", scenario), drive("orca", other)
    for k, vehicle in enumerate(order):
        rows = slice(k, None, 4), slice(vehicle, None, 4)
        assert same(after, before, *rows, *OWN)
        for people in ([0], np.arange(4, 16)):
            ours, theirs = after.position[rows[0], :, people], before.position[rows[1], :, people]
            assert np.array_equal(ours, theirs, equal_nan=True)


def test_all_vehicles_of_a_world_live_among_the_same_pedestrians():
    trace = drive("orca", load_scenario("fleet_4", {"pedestrians.arrival": "respawn"}))
    for name in ("position", "radius", "goal", "present"):
        rows = getattr(trace, name).reshape(6, 4, *getattr(trace, name).shape[1:])
        for t in range(int(trace.steps.min()) + 1):
            assert np.array_equal(rows[:, 0, t, 4:], rows[:, 1, t, 4:], equal_nan=True)
    assert (trace.person[:, -1, 3:] > 15).any(), "somebody was replaced"


def test_arrived_vehicles_leave_and_others_stand_in_the_way_of_all():
    trace = drive("straight", load_scenario("fleet_4"))
    seen = set()
    for row in range(len(trace)):
        first = row - row % 4
        for column, other in enumerate([k for k in range(first, first + 4) if k != row], start=1):
            later = slice(trace.steps[other] + 1, trace.steps[row] + 1)
            seen.add((trace.outcome[other], later.stop > later.start))
            if trace.outcome[other] == Outcome.SUCCESS:
                assert not trace.present[row, later, column].any()
            else:
                end = trace.position[other, trace.steps[other], 0]
                assert (trace.position[row, later, column] == end).all()
                assert trace.present[row, later, column].all()
    assert {(Outcome.SUCCESS, True), (Outcome.COLLISION, True)} <= seen


@pytest.mark.parametrize("overrides", [{}, WHEELS], ids=["holonomic", "wheels"])
def test_a_collision_of_vehicles_counts_for_both_with_their_shares(overrides):
    trace = drive("straight", placed([[0, 0], [0, 6]], [[0, 6], [0, 0]], **overrides), Cases("test", 0, 1))
    assert trace.outcome.tolist() == [Outcome.COLLISION] * 2
    assert trace.steps[0] == trace.steps[1]
    assert np.allclose(METRICS["vehicle_share"](trace), 0.5, atol=1e-6)
    assert METRICS["at_fault_rate"](trace).all()
    assert METRICS["impact_speed"](trace) == pytest.approx([2.0, 2.0], abs=0.3)
    assert np.isnan(METRICS["minimum_gap"](trace)).all(), "other vehicles are no pedestrians"


def test_only_the_moving_vehicle_collides_with_one_that_stands():
    start, goal = [[0, 0], [0, 3], [0, 20]], [[0, 8], [0, 0], [0, 0]]
    trace = drive("straight", placed(start, goal), Cases("test", 0, 1))
    assert trace.outcome.tolist() == [Outcome.COLLISION] * 3
    assert trace.steps[0] == trace.steps[1] < trace.steps[2]
    assert METRICS["vehicle_share"](trace)[2] == pytest.approx(1.0)


def test_vehicles_on_arcs_meet_in_both_rows_or_in_none():
    scenario = load_scenario("fleet_door_3", {"pedestrians.number": 0, "layout.door_width": 0.8})
    trace = drive("orca", scenario, Cases("test", 0, 30))
    last = trace.position[np.arange(len(trace)), trace.steps]
    struck = trace.outcome == Outcome.COLLISION
    assert struck.any()
    for row in np.flatnonzero(struck):
        distance = np.linalg.norm(last[row, 1:3] - last[row, 0], axis=1)
        partner = [k for k in range(row - row % 3, row - row % 3 + 3) if k != row][int(np.nanargmin(distance))]
        assert trace.outcome[partner] == Outcome.COLLISION
        assert trace.steps[partner] <= trace.steps[row]


def test_other_vehicles_are_marked_in_observations():
    world = load_scenario("fleet_4").worlds(Cases("test", 0, 2))
    crowd = observe(world).pedestrians
    assert crowd.is_vehicle.tolist() == [[True] * 3 + [False] * 12] * 8
    assert np.array_equal(crowd.position[0, 0], world.position[1, 0])
    nearest = observe(load_scenario("fleet_4", {"sensor.nearest": 5}).worlds(Cases("test", 0, 2))).pedestrians
    for row in range(8):
        others = world.position[row - row % 4 : row - row % 4 + 4, 0].tolist()
        assert nearest.is_vehicle[row].tolist() == [point in others for point in nearest.position[row].tolist()]
    assert observe(load_scenario("circle_20").worlds(FEW)).pedestrians.is_vehicle is None


def test_another_planner_drives_the_other_vehicles():
    scenario = load_scenario("fleet_4")
    orca, straight = drive("orca", scenario), drive("straight", scenario)
    mixed = drive("straight", scenario, others="orca")
    named = crowdbench.rollout("straight", scenario, str(FEW), others="orca")
    np.testing.assert_array_equal(named.position, mixed.position)
    with pytest.raises(InputError, match="circle_20 has one"):
        crowdbench.rollout("straight", "circle_20", 1, others="orca")
    first = np.arange(len(mixed)) % 4 == 0
    assert np.array_equal(mixed.command[first, 0], straight.command[first, 0])
    assert np.array_equal(mixed.command[~first, 0], orca.command[~first, 0])


def test_metrics_of_pedestrians_leave_out_other_vehicles():
    trace = drive("orca", load_scenario("fleet_4"))
    people = trace.of_pedestrians
    assert people.of_pedestrians is people
    assert people.position.shape[2] == people.radius.shape[2] == people.seen.shape[2] + 1 == 13
    assert np.array_equal(people.position[:, :, 1:], trace.position[:, :, 4:], equal_nan=True)
    for name in ("score", "t_close", "minimum_gap", "imposed_delay", "discomfort"):
        assert np.array_equal(METRICS[name](trace), METRICS[name](people), equal_nan=True), name
    score = METRICS["score"](trace).reshape(-1, 4)
    assert np.array_equal(
        OF_FLEETS["worst_score"](trace).reshape(-1, 4), np.repeat(score.min(axis=1)[:, None], 4, axis=1)
    )
    assert load_metrics([], vehicles=4).keys() - load_metrics([]).keys() == {"worst_score"}


def test_rows_of_whole_worlds_stay_together():
    rows = np.array([False, True, False, False, False, False])
    assert in_whole_worlds(rows, 2).tolist() == [True, True, False, False, False, False]
    assert in_whole_worlds(rows, 3).tolist() == [True, True, True, False, False, False]
    assert in_whole_worlds(rows, 1).tolist() == rows.tolist()


@pytest.mark.parametrize(
    ("overrides", "key"),
    [
        ({"collision": "crowdnav"}, "collision"),
        ({"pedestrians.attention": {"ignores": 0.1}}, "pedestrians.attention"),
        ({"pedestrians.groups": {"2": 1.0}}, "pedestrians.groups"),
        ({"vehicle.dynamics": "unicycle", "vehicle.length": 1.0}, "vehicle.length"),
        ({"crowdnav_cases": 5, "pedestrians.clear_space": None}, "crowdnav_cases"),
    ],
)
def test_keys_of_one_vehicle_are_refused_with_several(overrides, key):
    with pytest.raises(InputError, match=f"vehicle.number is 4, but must be 1 with this {key}"):
        load_scenario("fleet_4", overrides)
