"""Rollouts of a pedestrian policy from the observation of a vehicle, towards assumed goals."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from jaxtyping import Float

from crowdbench import Observation, PedestrianPolicy, Prediction, Rules, World
from crowdbench.core import WalkingLimits, continuation_keys
from crowdbench.sim import advance, crowd_decisions, init_memories
from crowdbench.utils import require

Goals = Float[np.ndarray, "world mode pedestrian 2"]


def roll_out(
    policy: PedestrianPolicy,
    obs: Observation,
    goals: Goals | Callable[[Goals], Goals],
    speed: Float[np.ndarray, "world mode pedestrian"],
    steps: int,
    *,
    plan: Float[np.ndarray, "world time 2"] | None = None,
    parameters: Mapping[str, float] | None = None,
    limits: tuple[float, float, float] = (np.inf, np.inf, np.inf),
) -> Prediction:
    """Return futures in which the observed pedestrians walk by a policy among the obstacles.

    Args:
        obs: The observation of every world. Pedestrians that are not seen neither walk nor are avoided.
        goals: Goals in metres, or a function that returns the next points to walk to from given positions, such as the
            next corners of paths around obstacles.
        speed: Preferred and largest speed of each pedestrian in each future, in m/s.
        steps: Number of steps, each of `obs.dt` seconds.
        plan: Commands of the vehicle, to which the policy reacts; without them no pedestrian sees the vehicle.
        parameters: Parameters of the policy that differ from its defaults.
        limits: Largest acceleration, braking and sideways acceleration of pedestrians, in m/s^2.

    Returns:
        The futures, one for each mode of `speed`. The futures of a world do not depend on the batch.

    Raises:
        InputError: The goals or the speeds have other shapes, or the policy fails.
    """
    worlds, pedestrians = obs.pedestrians.seen.shape
    shape = (worlds, *speed.shape[1:2], pedestrians)
    require("shape of speed", list(speed.shape), speed.shape == shape, "[world, mode, pedestrian]")
    ahead = goals if callable(goals) else lambda position: goals
    names, row = {"policy": policy}, np.repeat(np.arange(worlds), shape[1])
    world = init_memories(_worlds(policy, obs, speed, plan is not None, parameters or {}, limits), names)
    position, velocity = np.empty((2, *shape[:2], steps, pedestrians, 2))
    for t in range(steps):
        goal, points = world.goal.copy(), ahead(world.position[:, 1:].reshape(*shape, 2))
        require("shape of goals", list(points.shape), points.shape == (*shape, 2), "[world, mode, pedestrian, 2]")
        goal[:, 1:] = points.reshape(-1, pedestrians, 2)
        crowd, world = crowd_decisions(world.replace(goal=goal), names)
        # Without `move`, which would find other routes: the goals already are the next points.
        after, _ = advance(world, np.zeros((len(row), 2)) if plan is None else plan[row, t], crowd)
        world = world.replace(**after._asdict())
        position[:, :, t], velocity[:, :, t] = (
            each[:, 1:].reshape(*shape, 2) for each in (world.position, world.velocity)
        )
    return Prediction(position, velocity)


def _worlds(
    policy: PedestrianPolicy,
    obs: Observation,
    speed: Float[np.ndarray, "world mode pedestrian"],
    visible: bool,
    parameters: Mapping[str, float],
    limits: tuple[float, float, float],
) -> World:
    """Return one world for each mode of each observed world, ordered by world and mode, without routes and goals."""
    modes, vehicle = speed.shape[1], obs.vehicle
    rows = obs.rows(lambda array: np.repeat(array, modes, axis=0), logs=None)
    position, velocity, radius, present = rows.everybody()
    position[:, 0], radius[:, 0] = rows.vehicle.position, rows.vehicle.radius
    worlds, agents = radius.shape
    keys = np.stack([continuation_keys(obs.noise_key, 0, mode) for mode in range(modes)], axis=1).ravel()
    values = {**policy.parameters, **parameters}
    return World.create(
        key=keys,
        noise_key=rows.noise_key,
        step=rows.step,
        position=position,
        velocity=velocity,
        heading=rows.vehicle.heading,
        angular_speed=rows.vehicle.angular_speed,
        goal=np.concatenate([rows.vehicle.goal[:, None], position[:, 1:]], axis=1),
        radius=radius,
        preferred_speed=np.column_stack([rows.vehicle.preferred_speed, speed.reshape(worlds, -1)]),
        present=present,
        history=rows.pedestrians.history,
        obstacles=rows.obstacles,
        parameters={"policy": {name: np.full((worlds, agents), float(value)) for name, value in values.items()}},
        rules=Rules(
            obs.dt, visible=visible, dynamics=vehicle.dynamics, body=vehicle.body, walking=WalkingLimits(*limits)
        ),
    )
