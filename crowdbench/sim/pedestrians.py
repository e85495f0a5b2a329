"""Pedestrian policies: what moves the pedestrians."""

from __future__ import annotations

import abc
from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from crowdbench import rng
from crowdbench.geometry import toward_goal
from crowdbench.sim.orca import orca_velocities
from crowdbench.sim.routes import goals_on_way
from crowdbench.sim.social_force import FLUCTUATION, SIGHT_ANGLE, social_force_velocities
from crowdbench.types import World

ORCA_MARGIN = 0.01
"""Safety margin in metres that CrowdNav adds to each radius for ORCA."""

TIME_HORIZON_OBST = 1.0
"""How far ahead ORCA avoids obstacles, in seconds. With 5 s, as in the examples of RVO2, agents keep so far away from
walls that they go past goals beside them: the planner `orca` takes 13.0 s in `room` then, and 9.1 s with 1 s."""


class PedestrianPolicy(abc.ABC):
    """Moves pedestrians. A subclass lists its parameters in `parameters` and implements `velocities`.

    A policy has no state and changes nothing: what it returns depends only on the world, or else a case would depend on
    the cases that run beside it (`crowdbench check` finds that). It takes noise from
    `crowdbench.rng.normal(world.key, purpose, world.step, ...)`. In the world that it is given, a vehicle that
    pedestrians cannot see is not `present`.
    """

    parameters: ClassVar[Mapping[str, float]] = {}
    """The parameters that a scenario can set, with their defaults."""

    @abc.abstractmethod
    def velocities(
        self, world: World, parameters: Mapping[str, Float[np.ndarray, "world agent"]]
    ) -> Float[np.ndarray, "world pedestrian 2"]:
        """The velocities that the pedestrians take next.

        Args:
            world: The worlds as they are now.
            parameters: For each parameter a value per agent; column 0, the vehicle's, is not used.

        Returns:
            A velocity in m/s for every pedestrian. Those of pedestrians that another policy moves, or that are not
            present, are ignored.
        """


class ORCA(PedestrianPolicy):
    """Optimal reciprocal collision avoidance (van den Berg et al. 2011), with CrowdNav's parameters."""

    parameters: ClassVar[Mapping[str, float]] = {
        "neighbor_distance": 10.0,
        "max_neighbors": 10,
        "time_horizon": 5.0,
        "safety_space": 0.0,
        "time_horizon_obst": TIME_HORIZON_OBST,
        "line_of_sight": 0,
    }

    def velocities(
        self, world: World, parameters: Mapping[str, Float[np.ndarray, "world agent"]]
    ) -> Float[np.ndarray, "world pedestrian 2"]:
        """See `PedestrianPolicy`. `safety_space`, in metres, is added to each radius for avoidance.

        With `line_of_sight` = 1 pedestrians avoid only those whom no obstacle hides; with 0 they avoid others through
        walls too, as in RVO2.
        """
        pedestrian = world.present.copy()
        pedestrian[:, 0] = False
        return orca_velocities(
            world.position,
            world.velocity,
            toward_goal(world.position, goals_on_way(world), world.preferred_speed),
            world.radius + (ORCA_MARGIN + parameters["safety_space"]),
            world.preferred_speed,
            time_step=world.rules.dt,
            neighbor_distance=parameters["neighbor_distance"],
            max_neighbors=parameters["max_neighbors"],
            time_horizon=parameters["time_horizon"],
            obstacles=world.obstacles,
            time_horizon_obst=parameters["time_horizon_obst"],
            line_of_sight=parameters["line_of_sight"],
            seen=world.present,
            moves=pedestrian,
        )[:, 1:]


class SocialForce(PedestrianPolicy):
    """The social force model (Helbing and Molnár 1995), with the paper's parameters; the fluctuation's size is ours."""

    parameters: ClassVar[Mapping[str, float]] = {
        "relaxation_time": 0.5,
        "repulsion_strength": 2.1,
        "repulsion_range": 0.3,
        "look_ahead": 2.0,
        "sight_angle": SIGHT_ANGLE,
        "behind_weight": 0.5,
        "fluctuation": FLUCTUATION,
        "wall_strength": 10.0,
        "wall_range": 0.2,
    }

    def velocities(
        self, world: World, parameters: Mapping[str, Float[np.ndarray, "world agent"]]
    ) -> Float[np.ndarray, "world pedestrian 2"]:
        """See `PedestrianPolicy`. The parameters are those of `social_force_velocities`."""
        pedestrian = world.present.copy()
        pedestrian[:, 0] = False
        noise = np.zeros_like(world.position)
        noise[:, 1:] = rng.normal(world.key, "social_force", world.step, (pedestrian.shape[1] - 1, 2))
        return social_force_velocities(
            world.position,
            world.velocity,
            goals_on_way(world),
            world.radius,
            world.preferred_speed,
            noise,
            time_step=world.rules.dt,
            relaxation_time=parameters["relaxation_time"],
            repulsion_strength=parameters["repulsion_strength"],
            repulsion_range=parameters["repulsion_range"],
            look_ahead=parameters["look_ahead"],
            sight_angle=parameters["sight_angle"],
            behind_weight=parameters["behind_weight"],
            fluctuation=parameters["fluctuation"],
            obstacles=world.obstacles,
            wall_strength=parameters["wall_strength"],
            wall_range=parameters["wall_range"],
            seen=world.present,
            moves=pedestrian,
        )[:, 1:]
