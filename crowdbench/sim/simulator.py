"""One step of the world and the rules of an episode: batched, pure, compiled."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import no_type_check

import numpy as np
from jaxtyping import Float, Int
from numba import njit

from crowdbench.errors import InputError
from crowdbench.geometry import nearest_in_step
from crowdbench.sim.pedestrians import PedestrianPolicy
from crowdbench.types import HISTORY, Observation, Outcome, Pedestrians, Rules, Vehicle, World

SPEED_TOLERANCE = 1e-6
"""A speed above the preferred speed by no more than this share is rounding, not speeding."""


def crowd_velocities(world: World, policies: Mapping[str, PedestrianPolicy]) -> Float[np.ndarray, "world pedestrian 2"]:
    """The velocities that the pedestrians' policies ask for, each pedestrian by its own policy.

    The only place that hides an invisible vehicle from policies: in the world they are shown it is not present.
    Raises InputError, naming the policy, where one raises or does not return a finite velocity per pedestrian.
    """
    shown = world if world.rules.visible else _without_vehicle(world)
    asked = [_asked(shown, name, policy) for name, policy in policies.items()]
    return asked[0] if len(asked) == 1 else np.choose(world.policy[:, :, None], asked)


def _without_vehicle(world: World) -> World:
    present = world.present.copy()
    present[:, 0] = False
    return world.replace(present=present)


def _asked(world: World, name: str, policy: PedestrianPolicy) -> Float[np.ndarray, "world pedestrian 2"]:
    try:
        velocity = policy.velocities(world, world.parameters[name])
    except (Exception, SystemExit) as error:
        raise InputError(f"pedestrian policy {name} raised {type(error).__name__}: {error}") from error
    expected = (len(world), world.position.shape[1] - 1, 2)
    if not isinstance(velocity, np.ndarray) or velocity.shape != expected or velocity.dtype != np.float64:
        found = f"{velocity.dtype} of shape {velocity.shape}" if isinstance(velocity, np.ndarray) else repr(velocity)
        raise InputError(f"pedestrian policy {name} returned {found}, but must return float64 of shape {expected}")
    # A sum is finite only where all its terms are, and takes half the time of asking each.
    if not math.isfinite(velocity.sum()) and len(wrong := np.argwhere(~np.isfinite(velocity))):
        row, pedestrian, _ = wrong[0]
        raise InputError(
            f"pedestrian policy {name} returned {velocity[row, pedestrian].tolist()} for pedestrian {pedestrian} "
            f"of case {world.case[row]}, but a velocity must be finite"
        )
    return velocity


def advance(world: World, velocity: Float[np.ndarray, "world agent 2"]) -> World:
    """The world one step later, everybody moving at once with the given velocity (holonomic discs).

    The only place where speed is limited: whoever is faster than its preferred speed is slowed down to it.
    """
    position = np.empty_like(world.position)
    limited = np.empty_like(world.velocity)
    history = np.empty_like(world.history)
    _advance(
        world.position,
        np.ascontiguousarray(velocity),
        world.preferred_speed,
        world.present,
        world.history,
        world.rules.dt,
        position,
        limited,
        history,
    )
    return World(
        case=world.case,
        key=world.key,
        step=world.step + 1,
        position=position,
        velocity=limited,
        goal=world.goal,
        radius=world.radius,
        preferred_speed=world.preferred_speed,
        present=world.present,
        history=history,
        policy=world.policy,
        parameters=world.parameters,
        rules=world.rules,
    )


def step(
    world: World, command: Float[np.ndarray, "world 2"], crowd: Float[np.ndarray, "world pedestrian 2"]
) -> tuple[World, Int[np.ndarray, "world"], Float[np.ndarray, "world"]]:
    """The world one step later, the outcome of the step, and the vehicle's gap in it in metres.

    `command` is the vehicle's velocity and `crowd` the pedestrians', in m/s; `advance` limits both. Rollouts
    and environments all step by this.
    """
    after = advance(world, np.concatenate([command[:, None], crowd], axis=1))
    return after, *judge(world, after)


def judge(before: World, after: World) -> tuple[Int[np.ndarray, "world"], Float[np.ndarray, "world"]]:
    """The outcome of a step and the closest distance, in metres, between the vehicle's rim and another's in it.

    The vehicle collides where its disc touches a pedestrian's during the step: under the rule "swept" in
    their true relative motion; under "crowdnav" with the pedestrian's velocity from before the step,
    as CrowdNav does. It succeeds where its centre ends nearer to its goal than its radius. The step after
    which `Rules.max_steps` are done is a time-out, whatever happens in it. CrowdNav's order of precedence:
    time-out, collision, success.
    """
    outcome = np.empty(len(before), np.int64)
    gap = np.empty(len(before))
    _judge(
        before.position,
        swept_motion(before.position, after.position, before.velocity, before.rules),
        after.position,
        before.goal,
        before.radius,
        before.present,
        before.step,
        before.rules.max_steps,
        outcome,
        gap,
    )
    return outcome, gap


def swept_motion(
    before: Float[np.ndarray, "world agent 2"],
    after: Float[np.ndarray, "world agent 2"],
    velocity_before: Float[np.ndarray, "world agent 2"],
    rules: Rules,
) -> Float[np.ndarray, "world agent 2"]:
    """How the judge sees everybody move in a step, in metres, from the positions before and after it."""
    motion = after - before
    if rules.collision == "crowdnav":
        motion[:, 1:] = velocity_before[:, 1:] * rules.dt
    return motion


def observe(
    world: World,
    future: Float[np.ndarray, "world pedestrian 2"] | None = None,
    record: Callable[[str, np.ndarray], None] | None = None,
) -> Observation:
    """What the vehicle sees, in arrays of its own.

    `future` is the pedestrians' next velocities, where the planner may see them; `record` keeps what it logs.
    """
    # Copies: what a planner does to its observation must not reach the world.
    return Observation(
        vehicle=Vehicle(
            world.position[:, 0].copy(),
            world.velocity[:, 0].copy(),
            world.goal[:, 0].copy(),
            world.radius[:, 0].copy(),
            world.preferred_speed[:, 0].copy(),
        ),
        pedestrians=Pedestrians(
            world.position[:, 1:].copy(),
            world.velocity[:, 1:].copy(),
            world.radius[:, 1:].copy(),
            world.present[:, 1:].copy(),
            world.history.copy(),
            np.minimum(world.step + 1, HISTORY),
        ),
        case=world.case.copy(),
        key=world.key.copy(),
        step=world.step.copy(),
        dt=world.rules.dt,
        future=future,
        record=record,
    )


@no_type_check
@njit(cache=True)
def _advance(position, velocity, max_speed, present, history, dt, new_position, limited, new_history):
    worlds, agents = max_speed.shape
    length = history.shape[1]
    for w in range(worlds):
        for t in range(length - 1):
            for p in range(agents - 1):
                new_history[w, t, p, 0] = history[w, t + 1, p, 0]
                new_history[w, t, p, 1] = history[w, t + 1, p, 1]
        for a in range(agents):
            x, y = velocity[w, a, 0], velocity[w, a, 1]
            if not present[w, a]:
                x, y = 0.0, 0.0
            speed = math.sqrt(x * x + y * y)
            if speed > max_speed[w, a] * (1.0 + SPEED_TOLERANCE):
                x, y = x * (max_speed[w, a] / speed), y * (max_speed[w, a] / speed)
            limited[w, a, 0], limited[w, a, 1] = x, y
            new_position[w, a, 0] = position[w, a, 0] + x * dt
            new_position[w, a, 1] = position[w, a, 1] + y * dt
            if a > 0:
                new_history[w, length - 1, a - 1, 0] = new_position[w, a, 0]
                new_history[w, length - 1, a - 1, 1] = new_position[w, a, 1]


@no_type_check
@njit(cache=True)
def _judge(position, motion, end, goal, radius, present, step, max_steps, outcome, gap):
    for w in range(len(radius)):
        gap[w], _ = nearest_in_step(0, position[w], motion[w], radius[w], present[w])
        left = math.hypot(end[w, 0, 0] - goal[w, 0, 0], end[w, 0, 1] - goal[w, 0, 1])
        if step[w] + 1 >= max_steps:
            outcome[w] = Outcome.TIMEOUT.value
        elif gap[w] < 0.0:
            outcome[w] = Outcome.COLLISION.value
        elif left < radius[w, 0]:
            outcome[w] = Outcome.SUCCESS.value
        else:
            outcome[w] = Outcome.RUNNING.value
