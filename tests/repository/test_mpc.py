"""MPC: that its program drives to the goal, keeps away from people and walls, and what it is solved for."""

import dataclasses
import itertools
import sys

import numpy as np
import pytest
from lookahead_scenes import DT, Says, lone_vehicle

from agents.planners.mpc import mpc
from crowdbench.catalog import load_planner
from crowdbench.core.dynamics import Bicycle, Holonomic, Unicycle
from crowdbench.core.geometry import norm
from crowdbench.predict.linear import ConstantVelocity
from crowdbench.sim.obstacles import wall_gap_in_step
from crowdbench.utils.errors import InputError

pytest.importorskip("casadi", reason="CasADi is not installed: pip install 'crowdbench[mpc]'")
pytestmark = pytest.mark.slow


def drive(planner, obs, steps=30):
    """The positions of a vehicle whose pedestrians stand, up to its goal."""
    planner.reset(obs.row)
    vehicle, ways = obs.vehicle, [obs.vehicle.position[0]]
    for step in range(steps):
        command = planner.plan(dataclasses.replace(obs, vehicle=vehicle, step=np.array([step])))
        assert vehicle.dynamics.is_within(command, vehicle.preferred_speed).all()
        after = vehicle.dynamics.step(vehicle.state, command, vehicle.preferred_speed, DT)
        vehicle = dataclasses.replace(vehicle, **after._asdict())
        ways.append(vehicle.position[0])
        if norm(vehicle.goal - vehicle.position)[0] < 0.3:
            return np.array(ways)
    raise AssertionError(f"at {vehicle.position} after {steps} steps")


@pytest.mark.parametrize("dynamics", [Holonomic(), Holonomic(1.0), Unicycle(), Bicycle(1.0)])
def test_without_anybody_it_drives_to_the_goal(dynamics):
    obs = lone_vehicle()
    obs = dataclasses.replace(obs, vehicle=dataclasses.replace(obs.vehicle, dynamics=dynamics))
    assert np.abs(drive(mpc.MPCPlanner(ConstantVelocity()), obs)[:, 1]).max() < 0.05


@pytest.mark.parametrize("dynamics", [Holonomic(), Unicycle()])
def test_it_drives_around_somebody_who_stands_in_the_way(dynamics):
    obs = lone_vehicle()
    obs = dataclasses.replace(obs, vehicle=dataclasses.replace(obs.vehicle, dynamics=dynamics))
    obs.pedestrians.position[:] = [2.0, 0.05]
    way = drive(mpc.MPCPlanner(Says([[[2.0, 0.05]]] * 14)), obs)
    assert norm(way - [2.0, 0.05]).min() > 0.6


def test_it_drives_around_a_block():
    block = np.array([[1.5, -0.4], [2.5, -0.4], [2.5, 0.4], [1.5, 0.4]])[None]
    obs = dataclasses.replace(lone_vehicle(), obstacles=block[None])
    way = drive(mpc.MPCPlanner(ConstantVelocity()), obs)
    gaps = [wall_gap_in_step(*start, *(end - start), 0.3, block) for start, end in itertools.pairwise(way)]
    assert min(gaps) > 0.0


def test_wrong_options_and_a_missing_casadi_are_told_in_a_sentence(monkeypatch):
    with pytest.raises(InputError, match=r"in terms, near is -1\.0, but must be a number, 0 or more"):
        load_planner("mpc", {"terms": {"near": -1}})
    with pytest.raises(InputError, match="horizon is 14, but must be 20 or more, the steps that are asked for at once"):
        mpc.MPCPlanner(ConstantVelocity()).plan_ahead(lone_vehicle(), 20)
    monkeypatch.setitem(sys.modules, "casadi", None)
    with pytest.raises(InputError, match="needs CasADi: pip install 'crowdbench"):
        load_planner("mpc")
