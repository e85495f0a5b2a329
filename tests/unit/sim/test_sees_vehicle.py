"""Crowds of which only some see the vehicle."""

import numpy as np
import pytest

from crowdbench.catalog import load_planner, load_scenario
from crowdbench.planners.driver import Driver
from crowdbench.runs.rollout import rollout
from crowdbench.scenario.cases import Cases
from crowdbench.sim.simulator import crowd_velocities, sees_vehicle
from crowdbench.utils.errors import InputError

CROWD = {"pedestrians.number": 12, "pedestrians.policy": {"orca": 0.5, "distracted": 0.5}}


def crossing(visible=True, **share):
    return load_scenario("circle_crossing_5", {"vehicle.visible": visible, **CROWD, **share})


def positions(scenario, cases="val:0:12"):
    name, planner = load_planner("straight")
    return rollout(Driver(planner, name), scenario, Cases.parse(cases)).position


def test_each_pedestrian_walks_as_in_a_crowd_that_sees_or_as_in_one_that_does_not():
    scenario = crossing(**{"pedestrians.sees_vehicle": 0.5})
    world = scenario.worlds(Cases.parse("val:40"))
    sees = sees_vehicle(world.key, world.person, world.rules)
    blind = crossing(False).worlds(Cases.parse("val:40"))
    nobody_sees = crowd_velocities(blind, scenario.policies)
    all_see = crowd_velocities(crossing().worlds(Cases.parse("val:40")), scenario.policies)
    found = crowd_velocities(world, scenario.policies)
    np.testing.assert_array_equal(found, np.where(sees[..., None], all_see, nobody_sees))
    assert (all_see != nobody_sees).any(axis=2)[sees].any()
    assert (all_see != nobody_sees).any(axis=2)[~sees].any()
    assert 0.4 < sees.mean() < 0.6


def test_a_share_of_none_is_an_invisible_vehicle():
    blind, none = crossing(False), crossing(**{"pedestrians.sees_vehicle": 0.0})
    np.testing.assert_array_equal(positions(none), positions(blind))
    assert not np.array_equal(positions(none), positions(crossing()))


def test_a_case_does_not_depend_on_its_batch():
    scenario = crossing(**{"pedestrians.sees_vehicle": 0.5})
    together, alone = positions(scenario), positions(scenario, "val:5:6")
    steps = alone.shape[1]
    np.testing.assert_array_equal(together[5, :steps], alone[0])


def test_a_share_of_an_invisible_vehicle_is_refused():
    with pytest.raises(InputError, match=r"vehicle\.visible is false, but must be true where .*sees_vehicle says how"):
        crossing(False, **{"pedestrians.sees_vehicle": 0.5})
