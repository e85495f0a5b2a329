"""Check the worlds of a scenario for gaps in their walls, pedestrians that never arrive, and exact symmetry."""

from __future__ import annotations

import contextlib
import dataclasses

import numpy as np
import shapely
from jaxtyping import Int

from crowdbench.check.checks import CheckResult
from crowdbench.core.types import World
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.post_step_rule import find_arrived, find_walking
from crowdbench.scenario.scenario import Scenario
from crowdbench.sim.simulator import crowd_decisions, init_memories, move
from crowdbench.sim.visibility_graph import find_routes
from crowdbench.utils.errors import InputError

ARRIVALS = 0.5
"""Smallest share of pedestrians that must arrive in a world without the vehicle."""

MOST_TURNS = 24
"""The smallest rotation in the search for symmetry is a 24th of a turn."""

_TOLERANCE = 1e-6


def check_worlds(scenario: Scenario, cases: Cases) -> list[CheckResult]:
    """Check the worlds of a scenario; no checks if pedestrians are recorded."""
    if scenario.layout is None:
        return []
    world = scenario.worlds(cases)
    return [_check_bounds(world), _check_arrivals(scenario, world), _check_symmetry(world)]


def _check_bounds(world: World) -> CheckResult:
    """Search for a path of the vehicle out of the walls around its start."""
    enclosed = 0
    for row, walls in enumerate(world.obstacles):
        start, corners = world.position[row, :1], walls[np.isfinite(walls[:, :, 0])]
        hull = shapely.MultiPoint(corners).convex_hull
        if not hull.contains(shapely.Point(start[0])):
            continue
        outside = corners.max(axis=0, keepdims=True) + 2.0 * world.radius[row, 0] + 1.0
        with contextlib.suppress(InputError):  # there is no path
            path = np.concatenate([find_routes(start, outside, world.radius[row, :1], walls)[0], outside])
            x, y = path[~shapely.contains_xy(hull, *path.T)][0]
            gap = f"in case {world.case[row]}, the vehicle can leave the walls around it, at ({x:.3g}, {y:.3g})"
            return CheckResult("bounds", False, f"{gap}: pedestrians may push it out, so close them")
        enclosed += 1
    return CheckResult(
        "bounds",
        True,
        f"the vehicle cannot leave the walls around it; {enclosed} of {len(world)} cases have such walls",
    )


def _check_arrivals(scenario: Scenario, world: World) -> CheckResult:
    """Simulate the pedestrians of all cases without a vehicle until the time limit, and count arrivals."""
    world = init_memories(world.replace(rules=dataclasses.replace(world.rules, visible=False)), scenario.policies)
    case, everywhere, rule = world.case, np.ones(len(world), bool), scenario.post_step_rule
    walking = find_walking(world, everywhere) & ~scenario.crowd.stands[world.policy]
    arrived = np.zeros_like(walking)
    for _ in range(int(world.max_steps.max())):
        crowd, world = crowd_decisions(world, scenario.policies)
        world, _ = move(world, np.zeros((len(world), 2)), crowd)
        arrived |= find_arrived(world, everywhere)
        if rule is not None:
            world = rule(world, everywhere)
    number, most = (arrived & walking).sum(axis=1), walking.sum(axis=1)
    worst = (number - most).argmin()
    passed = bool(number.sum() >= ARRIVALS * most.sum())
    counts = (
        f"{number.sum()} of {most.sum()} pedestrians arrive in time without a vehicle, "
        f"{number[worst]} of {most[worst]} in case {case[worst]}"
    )
    cause = "" if passed else ": they block each other, or have too little time"
    return CheckResult("arrivals", passed, counts + cause)


def _check_symmetry(world: World) -> CheckResult:
    """Search for a rotation that maps starts and goals of all agents, or of all pedestrians, onto each other.

    Two agents that meet head-on do not count: rounding decides on which side they pass.
    """
    for row, first in np.ndindex(len(world), 2):
        agents = np.flatnonzero(world.present[row])[first:]
        order = _find_order(world, row, agents) if len(agents) > 2 else 0
        if order:
            turn = f"a turn by {360.0 / order:.3g} degrees maps {len(agents)} agents onto each other"
            advice = "they may stand forever: add noise to their starts"
            return CheckResult("symmetry", False, f"in case {world.case[row]}, {turn}, and {advice}")
    return CheckResult("symmetry", True, "no turn maps starts and goals onto each other")


def _find_order(world: World, row: int, agents: Int[np.ndarray, "agent"]) -> int:
    """Return the order of the rotational symmetry; 0 if there is none."""
    start = world.position[row, agents] @ [1.0, 1.0j]
    goal = world.goal[row, agents] @ [1.0, 1.0j]
    traits = [start - start.mean(), goal - start.mean(), world.radius[row, agents], world.preferred_speed[row, agents]]
    original = np.stack(traits, axis=1)
    for order in range(min(len(agents), MOST_TURNS), 1, -1):
        angle = 2j * np.pi / order
        turned = original * np.exp([angle, angle, 0.0, 0.0])
        difference = np.abs(turned[:, None] - original).max(axis=2)
        if (difference.min(axis=1) < _TOLERANCE).all():
            return order
    return 0
