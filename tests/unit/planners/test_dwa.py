"""The dynamic window approach: what makes a command good, worked out by hand, and what it does when nothing is."""

import dataclasses

import numpy as np
import pytest
from lookahead_scenes import DT, Says, lone_vehicle

from agents.planners.dwa import DWAPlanner, Objective
from crowdbench.catalog import load_planner
from crowdbench.core.dynamics import Unicycle
from crowdbench.utils.errors import InputError

OBJECTIVE = Objective(heading=2.0, clearance=3.0, room=0.5, speed=0.25, free=0.4, margin=0.1)


@pytest.mark.slow
def test_a_command_is_as_good_as_its_progress_the_time_until_it_touches_its_room_and_its_speed():
    obs = lone_vehicle()
    obs.pedestrians.position[:] = [0.0, 0.9]
    planner = DWAPlanner(Says([[[0.0, 0.9]]] * 4), OBJECTIVE, horizon=4)
    # Somebody of 0.3 + 0.1 m stands 0.9 m to the left, which leaves 0.2 m.
    window = np.array([[[1.0, 0.0], [0.0, 0.5], [0.0, 0.0]]])
    ahead, left, stand = planner.rate(obs, window)[0]
    assert ahead == pytest.approx(2.0 * 1.0 + 3.0 + 0.5 * 0.2 / 0.4 + 0.25)
    assert stand == pytest.approx(3.0 + 0.5 * 0.2 / 0.4)
    nearer = 4.0 - np.hypot(4.0, 4 * DT * 0.5)
    # It touches in the second step, and after one step it can stop.
    assert left == pytest.approx(2.0 * nearer / (4 * DT) + 3.0 * 1 / 4 + 0.25 * 0.5)


def test_a_command_after_which_the_vehicle_cannot_stop_in_time_is_not_admissible():
    planner = DWAPlanner(Says([[[1.2, 0.0]]] * 8), OBJECTIVE, horizon=8)
    obs = lone_vehicle()
    obs.pedestrians.position[:] = [1.2, 0.0]
    window = np.array([[[1.0, 0.0]]])
    assert np.isfinite(planner.rate(obs, window)).all()
    slow = dataclasses.replace(obs.vehicle, dynamics=Unicycle(0.5), velocity=np.array([[1.0, 0.0]]))
    assert planner.rate(dataclasses.replace(obs, vehicle=slow), window)[0, 0] == -np.inf


def test_where_no_command_is_admissible_it_brakes():
    obs = lone_vehicle()
    vehicle = dataclasses.replace(obs.vehicle, dynamics=Unicycle(0.5), velocity=np.array([[1.0, 0.0]]))
    obs.pedestrians.position[:] = [0.95, 0.0]
    planner = DWAPlanner(Says([[[0.95, 0.0]]] * 8), horizon=8)
    np.testing.assert_array_equal(planner.plan(dataclasses.replace(obs, vehicle=vehicle)), [[0.0, 0.0]])


def test_without_anybody_it_drives_to_the_goal():
    planner = DWAPlanner(Says([[[9.0, 9.0]]] * 14))
    command = planner.plan(lone_vehicle())
    np.testing.assert_allclose(command, [[1.0, 0.0]], atol=1e-12)


@pytest.mark.parametrize(
    ("wrong", "right"),
    [
        ({"objective": {"free": 0.0}}, "free is 0.0, but must be above 0"),
        ({"objective": {"heading": -1.0}}, "heading is -1.0, but must be a number, 0 or more"),
        ({"horizon": 0}, "horizon is 0, but must be a whole number, 1 or more"),
    ],
)
def test_wrong_options_are_refused(wrong, right):
    with pytest.raises(InputError, match=right):
        load_planner("dwa", wrong)
