"""One step of a batch of worlds."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, no_type_check

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench import rng
from crowdbench.compiled import njit
from crowdbench.dynamics import DISC, SPEED_TOLERANCE, hull
from crowdbench.dynamics.motion import drive
from crowdbench.sim.checked import asked, finite, kept, shaped, started
from crowdbench.sim.episode import StepCheck, check_worlds, unchecked
from crowdbench.sim.obstacles import slide
from crowdbench.sim.pedestrians import Memory, PedestrianPolicy, PolicyWithMemory
from crowdbench.sim.routes import next_waypoints
from crowdbench.sim.sight import look
from crowdbench.types import Outcome, Rules, World

Renewal = Callable[[World, Bool[np.ndarray, "world"]], World]
"""What becomes of people after a step, as a function of the worlds and of whether each is still running.

See `crowdbench.scenario.renewal`.
"""


BLIND = "without the vehicle"
"""Where a world's memory holds what policies remember of a crowd in which nobody sees the vehicle."""


def crowd_velocities(world: World, policies: Mapping[str, PedestrianPolicy]) -> Float[np.ndarray, "world pedestrian 2"]:
    """The velocities of `crowd_decisions`, for worlds that go no further."""
    return crowd_decisions(world, policies)[0]


def crowd_decisions(
    world: World, policies: Mapping[str, PedestrianPolicy]
) -> tuple[Float[np.ndarray, "world pedestrian 2"], World]:
    """What the pedestrians' policies decide: the velocities that they ask for, and what they remember.

    Policies are asked only here, in a world in which an invisible vehicle is not `present`. There a visible one is the
    smallest disc around its body. Where only some pedestrians see it, policies are asked once with the vehicle and once
    without, and remember both by themselves.

    Args:
        world: The worlds as they are now.
        policies: The scenario's policies by name.

    Returns:
        A velocity in m/s per pedestrian, by the pedestrian's own policy, and the worlds with the memories of the
        policies after this decision.

    Raises:
        InputError: A policy raises an exception, does not return a finite velocity per pedestrian, or no memory.
    """
    velocity, memories = _decided(_shown(world), policies)
    if _differ_in_sight(world.rules):
        blind = world.replace(memory=world.memory[BLIND])
        other, forgetful = _decided(_without_vehicle(blind), policies)
        velocity = np.where(sees_vehicle(world)[:, :, None], velocity, other)
        memories = {**memories, BLIND: {**blind.memory, **forgetful}}
    return velocity, world.replace(memory={**world.memory, **memories}) if memories else world


def sees_vehicle(world: World) -> Bool[np.ndarray, "world pedestrian"]:
    """Who sees a vehicle that only a share of the pedestrians sees: the same people throughout a case."""
    draws = rng.uniforms(world.key, "sees_vehicle", np.zeros_like(world.step), world.person)
    return draws < world.rules.sees_vehicle


def _differ_in_sight(rules: Rules) -> bool:
    """Whether some pedestrians see the vehicle and others do not."""
    return rules.visible and rules.sees_vehicle < 1.0


def _decided(
    shown: World, policies: Mapping[str, PedestrianPolicy]
) -> tuple[Float[np.ndarray, "world pedestrian 2"], dict[str, Memory]]:
    """The velocities in m/s that policies ask for, each pedestrian's own, and by policy what they remember."""
    memories: dict[str, Memory] = {}
    found = [_asked(shown, name, policy, memories) for name, policy in policies.items()]
    velocity = found[0] if len(found) == 1 else np.choose(shown.policy[:, :, None], found)
    return velocity, memories


def with_memories(world: World, policies: Mapping[str, PedestrianPolicy]) -> World:
    """Worlds at their start, with what the policies remember there.

    Args:
        world: The worlds, in which the memory of each policy is empty.
        policies: The scenario's policies by name.

    Raises:
        InputError: A policy raises an exception, or returns no memory.
    """
    memories = _started(_shown(world), policies)
    if _differ_in_sight(world.rules):
        memories = {**memories, BLIND: {**world.memory, **_started(_without_vehicle(world), policies)}}
    return world.replace(memory={**world.memory, **memories}) if memories else world


def _started(shown: World, policies: Mapping[str, PedestrianPolicy]) -> dict[str, Memory]:
    """By policy, what those with a memory remember at the start."""
    remembering = {name: each for name, each in policies.items() if isinstance(each, PolicyWithMemory)}
    return {name: started(policy, name, shown) for name, policy in remembering.items()}


def _shown(world: World) -> World:
    """Worlds as policies are shown them."""
    return with_hull(world) if world.rules.visible else _without_vehicle(world)


def _without_vehicle(world: World) -> World:
    present = world.present.copy()
    present[:, 0] = False
    return world.replace(present=present)


def with_hull(world: World) -> World:
    """Worlds in which the vehicle is the smallest disc around its body, as pedestrians see it."""
    if world.rules.body == DISC:
        return world
    position, radius = world.position.copy(), world.radius.copy()
    position[:, 0], radius[:, 0] = hull(world.rules.body, position[:, 0], world.heading, radius[:, 0])
    return world.replace(position=position, radius=radius)


def _asked(
    world: World, name: str, policy: PedestrianPolicy, memories: dict[str, Memory]
) -> Float[np.ndarray, "world pedestrian 2"]:
    """The velocities that a policy asks for in m/s; its memory, if it has one, is put into `memories`."""
    velocity, memory = asked(policy, name, world)
    if memory is not None:
        memories[name] = kept(memory, world.memory[name], name)
    return finite(shaped(velocity, name, world), name, world)


def advance(world: World, command: Float[np.ndarray, "world agent 2"]) -> World:
    """Move all agents by one step: the vehicle by its dynamics, pedestrians as holonomic discs.

    The simulator limits speeds only here: an agent that is faster than its preferred speed is slowed down to it. In a
    run the `Driver` has rejected such commands of a planner before. So are the vehicle's other limits enforced.

    Pedestrians cannot pass walls: whose rim touches one goes on along it, and has the velocity that this took. The
    vehicle is not stopped, because its episode ends there.

    Args:
        world: The worlds before the step.
        command: The command of the vehicle, see `crowdbench.dynamics`, and the velocity of every pedestrian in m/s.

    Returns:
        The worlds after the step.
    """
    motion = _Motion.of(world)
    _advance(*_before(world, command[:, 0], command[:, 1:]), *motion)
    return motion.after(world)


class _Motion(NamedTuple):
    """The arrays of a `World` that a step makes anew."""

    step: Int[np.ndarray, "world"]
    position: Float[np.ndarray, "world agent 2"]
    velocity: Float[np.ndarray, "world agent 2"]
    heading: Float[np.ndarray, "world"]
    angular_speed: Float[np.ndarray, "world"]
    history: Float[np.ndarray, "world time pedestrian 2"]

    @classmethod
    def of(cls, world: World) -> _Motion:
        """Arrays for a step of these worlds, which a kernel fills."""
        worlds = len(world)
        shape, history = world.position.shape, world.history.shape
        steps, heading, turning = np.empty(worlds, np.int64), np.empty(worlds), np.empty(worlds)
        return cls(steps, np.empty(shape), np.empty(shape), heading, turning, np.empty(history))

    def after(self, world: World) -> World:
        """The worlds after the step; `world` has them before it."""
        waypoint = world.waypoint
        if world.route.shape[2]:
            waypoint = next_waypoints(self.position, world.goal, world.route, waypoint, world.radius, world.obstacles)
        return world.replace(
            step=self.step,
            position=self.position,
            velocity=self.velocity,
            waypoint=waypoint,
            heading=self.heading,
            angular_speed=self.angular_speed,
            history=self.history,
        )


def _before(
    world: World, command: Float[np.ndarray, "world 2"], crowd: Float[np.ndarray, "world pedestrian 2"]
) -> tuple[Any, ...]:
    """What `_advance` takes of worlds, of commands and of velocities in m/s."""
    rules = world.rules
    dynamics = rules.dynamics
    return (
        dynamics.code,
        dynamics.limits,
        world.step,
        world.position,
        world.velocity,
        np.ascontiguousarray(command),
        np.ascontiguousarray(crowd),
        world.heading,
        world.angular_speed,
        world.preferred_speed,
        world.present,
        world.history,
        world.radius,
        world.obstacles,
        rules.dt,
    )


def taken_velocities(
    world: World, crowd: Float[np.ndarray, "world pedestrian 2"]
) -> Float[np.ndarray, "world pedestrian 2"]:
    """The velocities that pedestrians take in the next step.

    Args:
        world: The worlds before the step.
        crowd: The velocities in m/s that their policies ask for.

    Returns:
        In m/s.
    """
    motion = _Motion.of(world)
    _advance(*_before(world, np.zeros((len(world), 2)), crowd), *motion)
    return motion.velocity[:, 1:]


def walk(world: World, crowd: Float[np.ndarray, "world pedestrian 2"], renewal: Renewal | None) -> World:
    """One step in which the vehicle stands and nothing is checked.

    Args:
        world: The worlds before the step.
        crowd: The pedestrians' velocities in m/s.
        renewal: What becomes of people after it, if anything.

    Returns:
        The worlds after it.
    """
    after = advance(world, np.pad(crowd, ((0, 0), (1, 0), (0, 0))))
    return after if renewal is None else renewal(after, np.ones(len(after), bool))


def step(
    world: World,
    command: Float[np.ndarray, "world 2"],
    crowd: Float[np.ndarray, "world pedestrian 2"],
    renewal: Renewal | None = None,
) -> tuple[World, StepCheck]:
    """One step of the simulation, for rollouts and for environments.

    Motion and the check of how it ended, then what becomes of people, and the vehicle's look around.

    Args:
        world: The worlds before the step.
        command: The vehicle's command; `advance` limits it.
        crowd: The pedestrians' velocities in m/s; `advance` limits them.
        renewal: What becomes of people in the worlds that are still running, if anything.

    Returns:
        The worlds one step later, and what the check of the step found.
    """
    after, check = move(world, command, crowd)
    return settled(after, check, renewal), check


def move(
    world: World, command: Float[np.ndarray, "world 2"], crowd: Float[np.ndarray, "world pedestrian 2"]
) -> tuple[World, StepCheck]:
    """The first part of a step: motion, and the check of how it ended; see `step`."""
    motion, check, rules = _Motion.of(world), unchecked(len(world)), world.rules
    of_check = rules.discs, rules.goal_tolerance or 0.0, rules.collision_code, world.goal, rules.max_steps
    _step(*_before(world, command, crowd), *of_check, *motion, *check)
    return motion.after(world), check


def settled(after: World, check: StepCheck, renewal: Renewal | None) -> World:
    """The second part of a step: what becomes of people, and the vehicle's look around.

    Args:
        after: The worlds after the first part.
        check: What its check has found.
        renewal: What becomes of people in the worlds that are still running, if anything.
    """
    return look(after if renewal is None else renewal(after, check.outcome == Outcome.RUNNING))


@no_type_check
@njit
def _step(
    code,
    limits,
    step,
    position,
    velocity,
    command,
    crowd,
    heading,
    turn_rate,
    max_speed,
    present,
    history,
    radius,
    obstacles,
    dt,
    body,
    tolerance,
    rule,
    goal,
    max_steps,
    new_step,
    end,
    limited,
    new_heading,
    angular_speed,
    new_history,
    outcome,
    gap,
    wall_gap,
):
    """`_advance` and `check_worlds` in one call: to enter a kernel takes as long as what it does in one world."""
    moved = new_step, end, limited, new_heading, angular_speed, new_history
    commands = command, crowd
    own = heading, turn_rate, max_speed
    around = present, history, radius, obstacles, dt
    _advance(code, limits, step, position, velocity, *commands, *own, *around, *moved)
    driven = heading, limited, angular_speed
    where = position, velocity, end, goal, radius, present, obstacles
    check_worlds(code, body, tolerance, rule, dt, *driven, *where, step, max_steps, outcome, gap, wall_gap)


@no_type_check
@njit
def _advance(
    code,
    limits,
    step,
    position,
    velocity,
    command,
    crowd,
    heading,
    turn_rate,
    max_speed,
    present,
    history,
    radius,
    obstacles,
    dt,
    new_step,
    new_position,
    limited,
    new_heading,
    angular_speed,
    new_history,
):
    """Move agents, limit their speeds, and update heading and history.

    Args:
        code: The code of the vehicle's dynamics.
        limits: Its limits.
        step: `[world]`, steps done before this one.
        position: `[world, agent, 2]`, in metres.
        velocity: `[world, agent, 2]`, velocities before the step in m/s.
        command: `[world, 2]`, the vehicle's command.
        crowd: `[world, pedestrian, 2]`, the wanted velocities of pedestrians in m/s.
        heading: `[world]`, the vehicle's heading in radians.
        turn_rate: `[world]`, its angular speed before the step in rad/s.
        max_speed: `[world, agent]`, in m/s.
        present: `[world, agent]`; agents that are not present do not move.
        history: `[world, time, pedestrian, 2]`, in metres, oldest first.
        radius: `[world, agent]`, in metres.
        obstacles: `[world, polygon, corner, 2]`, in metres.
        dt: Length of the step in seconds.
        new_step: Filled, like `step`.
        new_position: Filled, like `position`.
        limited: Filled, like `velocity`: the velocities that were taken.
        new_heading: Filled, like `heading`.
        angular_speed: `[world]`, filled: the vehicle's angular speed in rad/s.
        new_history: Filled, like `history`.
    """
    worlds, agents = max_speed.shape
    length = history.shape[1]
    for w in range(worlds):
        new_step[w] = step[w] + 1
        for t in range(length - 1):
            for p in range(agents - 1):
                new_history[w, t, p, 0] = history[w, t + 1, p, 0]
                new_history[w, t, p, 1] = history[w, t + 1, p, 1]
        x, y, vx, vy = position[w, 0, 0], position[w, 0, 1], velocity[w, 0, 0], velocity[w, 0, 1]
        first, second = command[w, 0], command[w, 1]
        if not present[w, 0]:
            first, second = 0.0, 0.0
        x, y, vx, vy, new_heading[w], angular_speed[w] = drive(
            code, limits, x, y, vx, vy, heading[w], turn_rate[w], first, second, max_speed[w, 0], dt
        )
        new_position[w, 0, 0], new_position[w, 0, 1] = x, y
        limited[w, 0, 0], limited[w, 0, 1] = vx, vy
        for a in range(1, agents):
            x, y, vx, vy = position[w, a, 0], position[w, a, 1], crowd[w, a - 1, 0], crowd[w, a - 1, 1]
            if not present[w, a]:
                vx, vy = 0.0, 0.0
            speed = math.sqrt(vx * vx + vy * vy)
            if speed > max_speed[w, a] * (1.0 + SPEED_TOLERANCE):
                vx, vy = vx * (max_speed[w, a] / speed), vy * (max_speed[w, a] / speed)
            if obstacles.shape[1] > 0:
                x, y, vx, vy = _along_walls(x, y, vx, vy, radius[w, a], obstacles[w], dt)
            else:
                x, y = x + vx * dt, y + vy * dt
            new_position[w, a, 0], new_position[w, a, 1] = x, y
            limited[w, a, 0], limited[w, a, 1] = vx, vy
            new_history[w, length - 1, a - 1, 0], new_history[w, length - 1, a - 1, 1] = x, y


@no_type_check
@njit(inline="always")
def _along_walls(x, y, vx, vy, radius, obstacles, dt):
    """Move a pedestrian that cannot pass walls.

    Args:
        x, y: Its centre in metres.
        vx, vy: Its velocity in m/s.
        radius: In metres.
        obstacles: `[polygon, corner, 2]`, in metres.
        dt: Length of the step in seconds.

    Returns:
        Its centre after the step, x and y, and the velocity that it took, x and y.
    """
    touched, new_x, new_y = slide(x, y, vx * dt, vy * dt, radius, obstacles)
    if touched:
        return new_x, new_y, (new_x - x) / dt, (new_y - y) / dt
    return x + vx * dt, y + vy * dt, vx, vy
