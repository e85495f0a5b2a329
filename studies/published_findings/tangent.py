"""Tangent actions around groups (TAGA, Roy and Rahman 2025) for any planner.

Roy and Rahman, "TAGA: A Tangent-Based Reactive Approach for Socially Compliant Robot Navigation Around Human Groups",
2025, arXiv:2503.21168.

    crowdbench run --planner studies/published_findings/tangent.py --option name=orca --scenario groups_12
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench import Observation, Planner, load_planner
from crowdbench.core import norm

NEIGHBOURS = 1.5
"""Largest distance in metres between two neighbours of a group."""

NEAR_GOAL = 3.0
"""Distance in metres from the goal below which a goal in front of a group has priority."""

CRITICAL, PERSONAL = 0.3, 0.5
"""Gaps in metres to the nearest pedestrian: below the first the vehicle only moves away, below the second mostly."""

TANGENT_SHARE = 0.3
"""Share of the tangent action between the two gaps."""


class TangentPlanner(Planner):
    """Planner that takes the tangent of a group in its way, and the command of another planner otherwise.

    Groups are the clusters of observed pedestrians. A group is a disc around the mean of its members' positions.

    Args:
        planner: The other planner.
        margin: Gap in metres to the disc below which the tangent is taken.
    """

    def __init__(self, planner: Planner, margin: float) -> None:
        self.planner, self.margin = planner, margin
        self.facts = planner.facts
        self.trained_pedestrians, self.trained_dt = planner.trained_pedestrians, planner.trained_dt

    def reset(self, rows: Int[np.ndarray, "world"]) -> None:
        """See `Planner`."""
        self.planner.reset(rows)

    def plan(self, obs: Observation) -> Float[np.ndarray, "world 2"]:
        """See `Planner`."""
        command = self.planner.plan(obs)
        vehicle, people = obs.vehicle, obs.pedestrians
        if people.position.shape[1] < 2:
            return command
        member = find_groups(people.position, people.seen)
        centre, reach = enclose(people.position, people.radius, member)
        to_goal, to_group = vehicle.local_goal - vehicle.position, centre - vehicle.position[:, None]
        away, left = norm(to_group), norm(to_goal)
        goal_to_group = norm(centre - vehicle.local_goal[:, None])
        has_priority = (left[:, None] < goal_to_group) & (left[:, None] < NEAR_GOAL)
        is_ahead = (to_group * to_goal[:, None]).sum(axis=2) > 0.0
        is_near = away - reach - vehicle.radius[:, None] < self.margin
        blocks = (member.sum(axis=2) > 1) & is_ahead & is_near & ~has_priority
        nearest = np.where(blocks, away - reach, np.inf).argmin(axis=1)
        row = np.arange(len(nearest))
        tangent = find_tangent(to_group[row, nearest], to_goal) * vehicle.preferred_speed[:, None]
        return np.where(blocks.any(axis=1)[:, None], keep_distance(obs, tangent), command)


def find_groups(
    position: Float[np.ndarray, "world pedestrian 2"], seen: Bool[np.ndarray, "world pedestrian"]
) -> Bool[np.ndarray, "world pedestrian pedestrian"]:
    """Return which pedestrians are in the group of each one: those that a chain of neighbours connects with it."""
    connected = norm(position[:, :, None] - position[:, None]) < NEIGHBOURS
    connected &= seen[:, :, None] & seen[:, None]
    for _ in range(int(np.ceil(np.log2(position.shape[1])))):
        connected = connected @ connected
    return connected


def enclose(
    position: Float[np.ndarray, "world pedestrian 2"],
    radius: Float[np.ndarray, "world pedestrian"],
    member: Bool[np.ndarray, "world pedestrian pedestrian"],
) -> tuple[Float[np.ndarray, "world pedestrian 2"], Float[np.ndarray, "world pedestrian"]]:
    """Return centre and radius in metres of the disc around the group of each pedestrian."""
    centre = (member[..., None] * position[:, None]).sum(axis=2) / np.maximum(member.sum(axis=2), 1)[..., None]
    reach = norm(position[:, None] - centre[:, :, None]) + radius[:, None]
    return centre, np.where(member, reach, 0.0).max(axis=2)


def find_tangent(
    to_group: Float[np.ndarray, "world 2"], to_goal: Float[np.ndarray, "world 2"]
) -> Float[np.ndarray, "world 2"]:
    """Return the unit vector across the way to a group, on the side of the goal."""
    across = np.stack([-to_group[:, 1], to_group[:, 0]], axis=1) / np.maximum(norm(to_group), 1e-9)[:, None]
    is_left = (across * to_goal).sum(axis=1) >= 0.0
    return np.where(is_left[:, None], across, -across)


def keep_distance(obs: Observation, tangent: Float[np.ndarray, "world 2"]) -> Float[np.ndarray, "world 2"]:
    """Return the tangent action, away from the nearest pedestrian if that one is close; velocities in m/s."""
    vehicle, people = obs.vehicle, obs.pedestrians
    offset = vehicle.position[:, None] - people.position
    distance = np.where(people.seen, norm(offset), np.inf)
    nearest = distance.argmin(axis=1)
    row = np.arange(len(nearest))
    gap = distance[row, nearest] - people.radius[row, nearest] - vehicle.radius
    back = offset[row, nearest] / np.maximum(norm(offset[row, nearest]), 1e-9)[:, None]
    back = back * vehicle.preferred_speed[:, None]
    share = np.where(gap < CRITICAL, 0.0, np.where(gap < PERSONAL, TANGENT_SHARE, 1.0))[:, None]
    return share * tangent + (1.0 - share) * back


def planner(name: str, weights: str = "", margin: float = 0.25) -> TangentPlanner:
    """Make the planner.

    Args:
        name: The other planner.
        weights: The file of its weights, if it needs one.
        margin: Gap to the disc around a group below which the tangent is taken [m].

    Returns:
        The planner.
    """
    return TangentPlanner(load_planner(name, {"weights": weights} if weights else {}), margin)
