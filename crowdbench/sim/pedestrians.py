"""Pedestrian policies: what moves the pedestrians."""

from __future__ import annotations

import abc
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float

from crowdbench import rng
from crowdbench.sim.group_force import ATTRACTION, GAZE, REPULSION
from crowdbench.sim.orca_crowd import orca_pedestrians
from crowdbench.sim.power_law import power_law_velocities
from crowdbench.sim.presence import track_at
from crowdbench.sim.routes import goals_on_way
from crowdbench.sim.social_force import FLUCTUATION, SIGHT_ANGLE, social_force_velocities
from crowdbench.types import World

ORCA_MARGIN = 0.01
"""Safety margin in metres that CrowdNav adds to each radius for ORCA."""

TIME_HORIZON_OBST = 1.0
"""How far ahead ORCA avoids obstacles, in seconds. With 5 s, as in the examples of RVO2, agents keep so far away from
walls that they go past goals beside them: the planner `orca` takes 13.0 s in `room` then, and 9.1 s with 1 s."""


Memory = Mapping[str, Any]
"""What a policy remembers: arrays `[world, ...]` by name, in mappings that may be nested."""


class PedestrianPolicy(abc.ABC):
    """Moves pedestrians. A subclass lists its parameters in `parameters` and implements `velocities`.

    A policy has no state and changes nothing: what it returns depends only on the world, or else a case would depend on
    the cases that run beside it (`crowdbench check` finds that). It takes noise from
    `crowdbench.rng.normal(world.key, purpose, world.step, ...)`. In the world that it is given, a vehicle that
    pedestrians cannot see is not `present`. A policy that must remember something is a `PolicyWithMemory`.
    """

    parameters: ClassVar[Mapping[str, float]] = {}
    """The parameters that a scenario can set, with their defaults."""

    stands: ClassVar[bool] = False
    """Whether its pedestrians stand all the time. A scenario places them somewhere on the way from start to goal."""

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


class PolicyWithMemory(PedestrianPolicy):
    """Moves pedestrians by what it remembers of them, which the world carries: it still keeps nothing in itself.

    A pedestrian whose number in `world.person` is another than in the step before is somebody else, of whom nothing is
    remembered yet. A policy with such pedestrians keeps their numbers in its memory to notice it.
    """

    @abc.abstractmethod
    def memory(self, world: World, parameters: Mapping[str, Float[np.ndarray, "world agent"]]) -> Memory:
        """What is remembered at the start of the episodes.

        Args:
            world: The worlds at their start.
            parameters: As for `velocities`.

        Returns:
            Arrays `[world, ...]`, whose other axes do not depend on how many worlds there are.
        """

    @abc.abstractmethod
    def velocities(  # type: ignore[override]  # it is given and returns a memory too
        self, world: World, parameters: Mapping[str, Float[np.ndarray, "world agent"]], memory: Memory
    ) -> tuple[Float[np.ndarray, "world pedestrian 2"], Memory]:
        """The velocities that the pedestrians take next, and what is remembered after that.

        Args:
            world: The worlds as they are now.
            parameters: For each parameter a value per agent; column 0, the vehicle's, is not used.
            memory: What was returned in the step before. It must not be changed: return other arrays.

        Returns:
            A velocity in m/s for every pedestrian, as for any policy, and a memory with the same names, shapes and
            types.
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
        return orca_pedestrians(world, ORCA_MARGIN, parameters)


class ORCAPlus(PedestrianPolicy):
    """ORCA as the pedestrians of CrowdNav++ follow it (Liu et al. 2023): with a margin, towards the goal at 1 m/s."""

    parameters: ClassVar[Mapping[str, float]] = {
        **ORCA.parameters,
        "max_neighbors": 1000,
        "safety_space": 0.15,
    }

    def velocities(
        self, world: World, parameters: Mapping[str, Float[np.ndarray, "world agent"]]
    ) -> Float[np.ndarray, "world pedestrian 2"]:
        """See `PedestrianPolicy`. The velocity towards the goal is 1 m/s fast, whatever the preferred speed is."""
        return orca_pedestrians(world, ORCA_MARGIN, parameters, pace=np.ones_like(world.preferred_speed))


class Recorded(PedestrianPolicy):
    """Walks as recorded people walked, whatever happens around: they react to nobody."""

    def velocities(
        self, world: World, parameters: Mapping[str, Float[np.ndarray, "world agent"]]
    ) -> Float[np.ndarray, "world pedestrian 2"]:
        """See `PedestrianPolicy`: to where they were at the next step; 0 where they were not there any more."""
        ahead = track_at(world, world.step + 1) - world.position[:, 1:]
        return np.where(np.isnan(ahead), 0.0, ahead / world.rules.dt)


class SocialForce(PedestrianPolicy):
    """The social force model (Helbing and Molnár 1995), with the paper's parameters; the fluctuation's size is ours.

    In groups there are the forces of Moussaïd et al. (2010) besides, see `crowdbench.sim.group_force`.
    """

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
        "group_gaze": GAZE,
        "group_attraction": ATTRACTION,
        "group_repulsion": REPULSION,
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
            group=world.group,
            group_gaze=parameters["group_gaze"],
            group_attraction=parameters["group_attraction"],
            group_repulsion=parameters["group_repulsion"],
            seen=world.present,
            moves=pedestrian,
        )[:, 1:]


class PowerLaw(PedestrianPolicy):
    """The power law of the time to collision (Karamouzas et al. 2014), with the paper's parameters."""

    parameters: ClassVar[Mapping[str, float]] = {
        "relaxation_time": 0.54,
        "interaction_energy": 1.5,
        "interaction_horizon": 3.0,
        "max_acceleration": 20.0,
    }

    def velocities(
        self, world: World, parameters: Mapping[str, Float[np.ndarray, "world agent"]]
    ) -> Float[np.ndarray, "world pedestrian 2"]:
        """See `PedestrianPolicy`. The parameters are those of `power_law_velocities`."""
        pedestrian = world.present.copy()
        pedestrian[:, 0] = False
        return power_law_velocities(
            world.position,
            world.velocity,
            goals_on_way(world),
            world.radius,
            world.preferred_speed,
            time_step=world.rules.dt,
            relaxation_time=parameters["relaxation_time"],
            interaction_energy=parameters["interaction_energy"],
            interaction_horizon=parameters["interaction_horizon"],
            max_acceleration=parameters["max_acceleration"],
            obstacles=world.obstacles,
            seen=world.present,
            moves=pedestrian,
        )[:, 1:]
