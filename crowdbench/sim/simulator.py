"""One step of a batch of worlds."""

from __future__ import annotations

import operator
from collections import namedtuple
from collections.abc import Callable, Mapping
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Bool, Float

from crowdbench.core.dynamics import DISC, hull
from crowdbench.core.dynamics.kernels import HOLONOMIC, Motion, drive, limit_change, limit_speed
from crowdbench.core.types import Outcome, RuleNumbers, Rules, World
from crowdbench.sim import fleet
from crowdbench.sim.attention import AttentionState, adapted_view, init_attention, update_attention
from crowdbench.sim.episode import StepCheck, check_disc, check_step
from crowdbench.sim.intention import IntentionState, init_intentions, update_intentions
from crowdbench.sim.obstacles import slide
from crowdbench.sim.pedestrians import Memory, PedestrianPolicy, PolicyWithMemory
from crowdbench.sim.pedestrians.policy import Velocities, init_memory, query_policy
from crowdbench.sim.routes import follow_routes
from crowdbench.sim.sight import look
from crowdbench.utils.compiled import njit

PostStepRule = Callable[[World, Bool[np.ndarray, "world"]], World]
"""Rule applied after each step: arrivals, respawn, goal changes. Arguments: the worlds, a mask of the running ones.

See `crowdbench.scenario.post_step_rule`.
"""


BLIND, ATTENTION, INTENTION = "without the vehicle", "attention", "intention"
"""Keys of a world's memory: the policies' memories for a crowd in which no pedestrian sees the vehicle, and the states
of the pedestrians' attention and of their intentions."""


def crowd_velocities(world: World, policies: Mapping[str, PedestrianPolicy]) -> Velocities:
    """Return the velocities of `crowd_decisions`, for worlds that are not simulated further."""
    return crowd_decisions(world, policies)[0]


def crowd_decisions(world: World, policies: Mapping[str, PedestrianPolicy]) -> tuple[Velocities, World]:
    """Return the decisions of the pedestrians' policies: velocities and memories.

    Policies are queried only here. In their input, an invisible vehicle is not `present`, and a visible one is the
    smallest disc around its body. With a model of attention, policies are queried once with the vehicle and once
    without it, with a separate memory for each. With `Rules.intentions`, goals and preferred speeds in their input
    express the intended velocities.

    Args:
        world: The worlds as they are now.
        policies: The scenario's policies by name.

    Returns:
        A velocity in m/s per pedestrian, computed by its policy, and the worlds with the memories of the policies and
        the states of attention and intentions after this decision.

    Raises:
        InputError: A policy raises an exception, or does not return a finite velocity per pedestrian or a memory.
    """
    if world.rules.vehicles > 1:
        return fleet.spread_decisions(world, *_decide(fleet.first_rows(world), policies))
    return _decide(world, policies)


def _decide(world: World, policies: Mapping[str, PedestrianPolicy]) -> tuple[Velocities, World]:
    """Return `crowd_decisions`, with a row for each world."""
    intending = world
    if world.rules.intentions:
        intending, intentions = update_intentions(world, IntentionState(**world.memory[INTENTION]))
        world = _with_memories(world, {INTENTION: intentions._asdict()})
    view = _policy_view(intending)
    if not has_attention(world.rules):
        velocity, memories = _query_policies(view, policies)
        return velocity, _with_memories(world, memories)
    blind = intending.replace(memory=world.memory[BLIND])
    intended, blind_memories = _query_policies(_without_vehicle(blind), policies)
    adapts, state = update_attention(view, intended, AttentionState(**world.memory[ATTENTION]))
    velocity, memories = _query_policies(adapted_view(view, state), policies)
    memories |= {BLIND: {**blind.memory, **blind_memories}, ATTENTION: state._asdict()}
    return np.where(adapts[:, :, None], velocity, intended), _with_memories(world, memories)


def init_memories(world: World, policies: Mapping[str, PedestrianPolicy]) -> World:
    """Return worlds at their start with the initial memory of the policies.

    Args:
        world: The worlds, in which the memory of each policy is empty.
        policies: The scenario's policies by name.

    Raises:
        InputError: A policy raises an exception, or returns no memory.
    """
    remembering = {name: policy for name, policy in policies.items() if isinstance(policy, PolicyWithMemory)}

    def memories_of(view: World) -> dict[str, Memory]:
        return {name: init_memory(policy, name, view) for name, policy in remembering.items()}

    memories = memories_of(_policy_view(world))
    if has_attention(world.rules):
        memories[BLIND] = {**world.memory, **memories_of(_without_vehicle(world))}
    if world.rules.intentions:
        memories[INTENTION] = init_intentions(world)._asdict()
    return forget_vehicle(_with_memories(world, memories))


def forget_vehicle(world: World) -> World:
    """Return worlds in which no pedestrian has noticed the vehicle yet; see `has_attention`."""
    if not has_attention(world.rules):
        return world
    return _with_memories(world, {ATTENTION: init_attention(world)._asdict()})


def without_intentions(world: World, pedestrians: list[int]) -> World:
    """Return worlds in which some pedestrians are at most as fast as their preferred speed in the next step."""
    if not world.rules.intentions:
        return world
    max_speed = world.memory[INTENTION]["max_speed"].copy()
    max_speed[:, pedestrians] = 0.0
    return _with_memories(world, {INTENTION: {**world.memory[INTENTION], "max_speed": max_speed}})


def with_bounding_disc(world: World) -> World:
    """Return worlds in which the vehicle is the smallest disc around its body, as pedestrians see it."""
    if world.rules.body == DISC:
        return world
    position, radius = world.position.copy(), world.radius.copy()
    position[:, 0], radius[:, 0] = hull(world.rules.body, position[:, 0], world.heading, radius[:, 0])
    return world.replace(position=position, radius=radius)


def has_attention(rules: Rules) -> bool:
    """Return whether pedestrians must notice the vehicle before they adapt to it."""
    return rules.visible and rules.attention is not None


def _query_policies(view: World, policies: Mapping[str, PedestrianPolicy]) -> tuple[Velocities, dict[str, Memory]]:
    """Return each pedestrian's velocity in m/s, computed by its policy, and the memory of each policy by name."""
    velocities, memories = [], {}
    for name, policy in policies.items():
        velocity, memory = query_policy(policy, name, view)
        velocities.append(velocity)
        if memory is not None:
            memories[name] = memory
    return velocities[0] if len(velocities) == 1 else np.choose(view.policy[:, :, None], velocities), memories


def _policy_view(world: World) -> World:
    """Return worlds as input of the policies."""
    return with_bounding_disc(world) if world.rules.visible else _without_vehicle(world)


def _without_vehicle(world: World) -> World:
    present = world.present.copy()
    present[:, : world.rules.vehicles] = False
    return world.replace(present=present)


def _with_memories(world: World, memories: Mapping[str, Memory]) -> World:
    return world.replace(memory={**world.memory, **memories}) if memories else world


Before = namedtuple(
    "Before",
    "step max_steps position velocity heading angular_speed preferred_speed radius present policy goal history "
    "obstacles",
)
"""The arrays of a `World` that a step reads."""

After = namedtuple("After", "step position velocity heading angular_speed history")
"""The arrays of a `World` that a step replaces."""


class Commands(NamedTuple):
    """Commands of agents in a step.

    Attributes:
        vehicle: The vehicle's command.
        crowd: The pedestrians' velocities in m/s.
    """

    vehicle: Float[np.ndarray, "world 2"]
    crowd: Velocities


state_before = operator.attrgetter(*Before._fields)
"""Return the fields of `Before` of a world."""


@no_type_check
@njit(inline="always")
def name_fields(rules, before, commands, after, check):
    """Return the arguments of a step as named tuples.

    Python calls kernels with plain tuples: numba takes about a microsecond to receive a named tuple of arrays, and the
    arguments of a step would take a third of its time in one world.
    """
    return RuleNumbers(*rules), Before(*before), Commands(*commands), After(*after), StepCheck(*check)


def step(
    world: World, command: Float[np.ndarray, "world 2"], crowd: Velocities, post_step_rule: PostStepRule | None = None
) -> tuple[World, StepCheck]:
    """Simulate one step, for rollouts and for environments.

    The parts are: motion, check of the outcome, post-step rule, and measurement of the vehicle's sensor.

    The simulator limits speeds only here, to the preferred speed of each agent, or to the intended speed of a
    pedestrian if that is larger. In a run, the `Driver` has already rejected faster commands of a planner. Other
    limits of the vehicle, and the limits of `Rules.walking` for pedestrians, are enforced too. Pedestrians overlap if
    these limits prevent avoidance.

    Pedestrians cannot pass walls: they slide along a wall that their rim touches, and have the velocity of this motion.
    The vehicle is not stopped by walls, because a collision ends its episode.

    Args:
        world: The worlds before the step.
        command: The vehicle's command, see `core.dynamics`.
        crowd: The pedestrians' velocities in m/s.
        post_step_rule: Applied to the worlds that are still running, if given.

    Returns:
        The worlds one step later, and the result of the check.
    """
    after, check = move(world, command, crowd)
    return finish_step(after, check, post_step_rule), check


def move(world: World, command: Float[np.ndarray, "world 2"], crowd: Velocities) -> tuple[World, StepCheck]:
    """Compute the first part of a step: motion, and check of the outcome; see `step`."""
    command, actuation = world.rules.actuation.execute(world.actuation, command, world.rules.dt)
    if world.rules.vehicles > 1:
        after, check = advance(fleet.without_other_vehicles(world), command, crowd)
        hits = fleet.join_vehicles(world, after) & world.rules.collision_ends & (check.outcome != Outcome.TIMEOUT)
        check = check._replace(outcome=np.where(hits, Outcome.COLLISION, check.outcome))
    else:
        after, check = advance(world, command, crowd)
    routes, sizes = (world.goal, world.route, world.waypoint), (world.radius, world.obstacles, world.present)
    route, waypoint = follow_routes(after.position, *routes, *sizes)
    return world.replace(**after._asdict(), route=route, waypoint=waypoint, actuation=actuation), check


def finish_step(after: World, check: StepCheck, post_step_rule: PostStepRule | None) -> World:
    """Compute the second part of a step: post-step rule, and measurement of the vehicle's sensor.

    Args:
        after: The worlds after the first part.
        post_step_rule: Applied to the worlds that are still running, if given.
    """
    if after.rules.vehicles > 1:
        after = fleet.end_episodes(after, check.outcome)
    return look(_apply(post_step_rule, after, check.outcome == Outcome.RUNNING))


def _apply(rule: PostStepRule | None, world: World, running: Bool[np.ndarray, "world"]) -> World:
    """Apply the post-step rule, if there is one."""
    if rule is None or world.rules.vehicles == 1:
        return world if rule is None else rule(world, running)
    first = fleet.hold_vehicles(fleet.first_rows(world))
    after = rule(first, fleet.in_whole_worlds(running, world.rules.vehicles)[:: world.rules.vehicles])
    return world if after is first else fleet.with_pedestrians_of(world, after)


def step_pedestrians(world: World, crowd: Velocities, post_step_rule: PostStepRule | None) -> World:
    """Simulate one step without a check, in which the vehicle stands.

    Args:
        world: The worlds before the step.
        crowd: The pedestrians' velocities in m/s.
        post_step_rule: Applied after it, if given.

    Returns:
        The worlds after it.
    """
    after, _ = move(world, np.zeros((len(world), 2)), crowd)
    return _apply(post_step_rule, after, np.ones(len(after), bool))


def limit_velocities(world: World, crowd: Velocities) -> Velocities:
    """Return the velocities in m/s of pedestrians in the next step, from those in m/s that their policies request."""
    return advance(world, np.zeros((len(world), 2)), crowd)[0].velocity[:, 1:]


def advance(world: World, command: Float[np.ndarray, "world 2"], crowd: Velocities) -> tuple[After, StepCheck]:
    """Return the worlds after a step, and the result of its check."""
    worlds, points = len(world), world.position.shape
    steps, heading, angular_speed = np.empty(worlds, np.int64), np.empty(worlds), np.empty(worlds)
    after = steps, np.empty(points), np.empty(points), heading, angular_speed, np.empty(world.history.shape)
    check = np.empty(worlds, np.int64), np.empty(worlds), np.empty(worlds)
    commands = np.ascontiguousarray(command), np.ascontiguousarray(crowd)
    is_free = world.rules.dynamics.code == HOLONOMIC and not world.obstacles.shape[1]
    kernel = _step_in_the_open if is_free else _step
    kernel(tuple(world.rules.numbers), state_before(_with_max_speeds(world)), commands, after, check)
    return After(*after), StepCheck(*check)


def _with_max_speeds(world: World) -> World:
    """Return worlds in which pedestrians that intend to be faster than their preferred speed have this limit."""
    if not world.rules.intentions:
        return world
    speed = world.preferred_speed.copy()
    np.maximum(speed[:, 1:], world.memory[INTENTION]["max_speed"], out=speed[:, 1:])
    return world.replace(preferred_speed=speed)


@no_type_check
@njit(nogil=True)
def _step(rules, before, commands, after, check):
    """Compute motion and check of a step in one kernel: a kernel call takes as long as the work in one world."""
    numbers, start, orders, end, result = name_fields(rules, before, commands, after, check)
    move_agents(numbers, start, orders, end)
    _slide_pedestrians(numbers.dt, start, end)
    check_step(numbers, start, end, result)


@no_type_check
@njit(nogil=True)
def _step_in_the_open(rules, before, commands, after, check):
    """Compute `_step` for discs without walls, as in most scenarios: this kernel compiles in half the time."""
    numbers, start, orders, end, result = name_fields(rules, before, commands, after, check)
    move_agents(numbers, start, orders, end)
    check_disc(numbers, start, end, result)


@no_type_check
@njit
def _slide_pedestrians(dt, before, after):
    """Let pedestrians slide along the walls that their rims touch."""
    worlds, agents = before.radius.shape
    last = before.history.shape[1] - 1
    for w in range(worlds):
        for a in range(1, agents):
            x, y = before.position[w, a, 0], before.position[w, a, 1]
            dx, dy = after.velocity[w, a, 0] * dt, after.velocity[w, a, 1] * dt
            touched, end_x, end_y = slide(x, y, dx, dy, before.radius[w, a], before.obstacles[w])
            if touched:
                after.position[w, a, 0], after.position[w, a, 1] = end_x, end_y
                after.velocity[w, a, 0], after.velocity[w, a, 1] = (end_x - x) / dt, (end_y - y) / dt
                after.history[w, last, a - 1, 0], after.history[w, last, a - 1, 1] = end_x, end_y


@no_type_check
@njit(inline="always")
def move_agents(rules, before, commands, after):
    """Move all agents, limit their speeds and accelerations, and update heading and history."""
    worlds, agents = before.radius.shape
    dt, length = rules.dt, before.history.shape[1]
    for w in range(worlds):
        after.step[w] = before.step[w] + 1
        for t in range(length - 1):
            for p in range(agents - 1):
                after.history[w, t, p, 0] = before.history[w, t + 1, p, 0]
                after.history[w, t, p, 1] = before.history[w, t + 1, p, 1]
        first, second = commands.vehicle[w, 0], commands.vehicle[w, 1]
        if not before.present[w, 0]:
            first, second = 0.0, 0.0
        x, y = before.position[w, 0, 0], before.position[w, 0, 1]
        vx, vy = before.velocity[w, 0, 0], before.velocity[w, 0, 1]
        motion = Motion(x, y, vx, vy, before.heading[w], before.angular_speed[w])
        driven = drive(rules.code, rules.limits, motion, (first, second), before.preferred_speed[w, 0], dt)
        x, y, vx, vy, after.heading[w], after.angular_speed[w] = driven
        after.position[w, 0, 0], after.position[w, 0, 1] = x, y
        after.velocity[w, 0, 0], after.velocity[w, 0, 1] = vx, vy
        for a in range(1, agents):
            vx, vy = commands.crowd[w, a - 1, 0], commands.crowd[w, a - 1, 1]
            if not before.present[w, a]:
                vx, vy = 0.0, 0.0
            vx, vy = limit_speed(vx, vy, before.preferred_speed[w, a])
            if before.present[w, a] and before.policy[w, a - 1] != rules.walking.exempt:
                was_x, was_y = before.velocity[w, a, 0], before.velocity[w, a, 1]
                vx, vy = limit_change(vx, vy, was_x, was_y, rules.walking, dt)
            x, y = before.position[w, a, 0] + vx * dt, before.position[w, a, 1] + vy * dt
            after.position[w, a, 0], after.position[w, a, 1] = x, y
            after.velocity[w, a, 0], after.velocity[w, a, 1] = vx, vy
            after.history[w, length - 1, a - 1, 0], after.history[w, length - 1, a - 1, 1] = x, y
