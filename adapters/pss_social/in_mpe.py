"""Planners of crowdbench in the scene of PSS-Social: commands become forces, as MPE limits them.

crowdbench run --planner adapters/pss_social/in_mpe.py --option name=mppi --scenario adapters/pss_social/square.toml
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from mpe_physics import DAMPING, DT, GAIN, pairs, positions_of_mpe, velocities_after

from crowdbench import Observation, Planner, load_planner


class InMPE(Planner):
    """Planner whose command is executed by the forces that come nearest to it.

    It observes positions as the scenario has them: where agents will be after the step that MPE has already decided.

    Args:
        planner: The planner behind the forces.
        speed: Preferred speed that it observes, in m/s of the scene.
        scale: Metres that it observes per metre of the scene, such as 2 for networks trained with a radius of 0.3 m.
    """

    def __init__(self, planner: Planner, speed: float, scale: float) -> None:
        self.planner, self.speed, self.scale = planner, speed, scale
        self.facts = planner.facts
        self.trained_pedestrians, self.trained_dt = planner.trained_pedestrians, planner.trained_dt

    def reset(self, rows: Int[np.ndarray, "world"]) -> None:
        """See `Planner`."""
        self.planner.reset(rows)

    def plan(self, obs: Observation) -> Float[np.ndarray, "world 2"]:
        """See `Planner`."""
        wish = self.planner.plan(self._enlarge(obs)) / self.scale
        position, velocity, _, seen = obs.everybody()
        away, distance = (part[:, :1] for part in pairs(positions_of_mpe(position, velocity), seen))
        action = np.clip((wish - (1.0 - DAMPING) * velocity[:, 0]) / (DT * GAIN), -1.0, 1.0)
        command = velocities_after(velocity[:, :1], action[:, None], away, distance)[:, 0]
        speed = np.linalg.norm(command, axis=1)
        return command / np.maximum(speed / obs.vehicle.preferred_speed, 1.0)[:, None]

    def _enlarge(self, obs: Observation) -> Observation:
        """Return what the planner observes."""
        k, vehicle, crowd = self.scale, obs.vehicle, obs.pedestrians
        tolerance = None if vehicle.goal_tolerance is None else k * vehicle.goal_tolerance
        lengths = {name: k * getattr(vehicle, name) for name in ("position", "velocity", "goal", "route", "radius")}
        speed = np.full_like(vehicle.preferred_speed, k * self.speed)
        shown = dataclasses.replace(vehicle, **lengths, preferred_speed=speed, goal_tolerance=tolerance)
        theirs = {name: k * getattr(crowd, name) for name in ("position", "velocity", "radius", "history")}
        return dataclasses.replace(obs, vehicle=shown, pedestrians=dataclasses.replace(crowd, **theirs), logs=None)


def planner(name: str, speed: float = 1.0, scale: float = 1.0, options: Mapping[str, Any] | None = None) -> InMPE:
    """Make the planner.

    Args:
        name: The planner behind the forces.
        speed: Preferred speed that it observes [m/s].
        scale: Metres that it observes per metre of the scene.
        options: Options of the planner behind the forces.

    Returns:
        The planner.
    """
    return InMPE(load_planner(name, options), speed, scale)
