"""The social force model of pedestrians (Helbing and Molnár 1995), compiled. Equation numbers are that paper's.

A pedestrian accelerates towards its desired velocity within a relaxation time (equation 2). The others repel it: each
is surrounded by elliptical equipotential lines that reach ahead over its next step (equations 3 and 4), and repels
less where the pedestrian does not see it (equations 7 and 8). Borders repel with their nearest point (equation 5). A
fluctuation is added (equation 10). Attractions (equation 6) are left out.

This differs from the paper:

- Pedestrians are discs here and points in the paper: repulsion depends on the distance minus the radii, see
  `_rim_vector`. Only borders repel the centre, as in the paper. With its parameters, a pedestrian that walks at 1 m/s
  against a wall stops 0.64 m before it. If borders repelled the rim, the nearer of two walls would block a doorway.
- The ellipse points in the walking direction of a pedestrian, in the paper in its desired direction. A vehicle cannot
  measure desired directions, and discs that meet would block each other in pairs: in circle_crossing_5_social_force,
  34 % instead of 97 % of the pedestrians would come within 0.3 m of their goals in time.
- As everywhere in crowdbench, the speed limit is the preferred speed; in the paper it is 1.3 times as high. A world has
  one velocity per pedestrian. In the paper, the limit applies to the actual velocity, and forces accumulate in another
  one (equations 11 and 12).
- Over the last metre the desired speed decreases with the distance to the goal, so that pedestrians come to rest.
- The size of the fluctuation is ours, because the paper gives none.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar, no_type_check

import numpy as np
from jaxtyping import Float, Int

from crowdbench.core import rng
from crowdbench.core.arrays import AgentPoints
from crowdbench.core.types import World
from crowdbench.sim.obstacles import nearest_on_segment, number_of_corners
from crowdbench.sim.pedestrians.forces import TINY, Walkers, compile_model, fill_traits, integrate, walkers_of
from crowdbench.sim.pedestrians.group_force import ATTRACTION, GAZE, REPULSION, group_force
from crowdbench.sim.pedestrians.policy import Parameters, PedestrianPolicy, Velocities
from crowdbench.utils.compiled import njit

SIGHT_ANGLE = math.radians(200.0)
"""The paper's 2 phi in radians."""

FLUCTUATION = 0.05
"""Size of the fluctuation in m/s. It turns a pedestrian at 1 m/s by 3 degrees, enough to choose a side."""

SOFTNESS = 0.025
"""Distance in metres at which repulsion acts between two rims that touch. Pedestrians overlap in 43 of the 500 cases of
circle_crossing_5_social_force if this is 0.1, in 3 if it is 0.05, and in none if it is 0.025 or 0.01."""

_HEAD_ON = 1e-7
"""Semi-minor axis in metres below which two pedestrians meet head-on: a few times its rounding error."""


PARAMETERS: Mapping[str, float] = {
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
"""The parameters with their defaults, which are the papers', except that of `fluctuation`."""

_ALONE: Mapping[str, float] = {name: value for name, value in PARAMETERS.items() if not name.startswith("group_")}
"""The parameters of pedestrians without a group."""


class SocialForce(PedestrianPolicy):
    """The social force model (Helbing and Molnár 1995), with the paper's parameters; the fluctuation's size is ours.

    In groups, the forces of Moussaïd et al. (2010) are added, see `crowdbench.sim.pedestrians.group_force`.
    """

    parameters: ClassVar[Mapping[str, float]] = PARAMETERS

    def velocities(self, world: World, parameters: Parameters) -> Velocities:
        """See `PedestrianPolicy`, and `social_force_velocities` for the parameters."""
        noise, dt = np.zeros_like(world.position), world.rules.dt
        noise[:, 1:] = rng.normal(world.key, "social_force", world.step, (noise.shape[1] - 1, 2))
        walkers = walkers_of(world)
        return social_force_velocities(walkers, noise, world.group, time_step=dt, parameters=parameters)[:, 1:]


def social_force_velocities(
    walkers: Walkers,
    noise: AgentPoints,
    group: Int[np.ndarray, "world pedestrian"] | None = None,
    *,
    time_step: float = 0.25,
    parameters: Mapping[str, float | Float[np.ndarray, "_ _"]] = PARAMETERS,
) -> AgentPoints:
    """Return the velocity that each agent has at the end of the step, see `forces.integrate`.

    Args:
        noise: Standard normal numbers, one per agent and axis, for the fluctuation during this step.
        group: The index of each pedestrian's group, negative without a group; None if there are no groups.
        time_step: Length of the step in seconds.
        parameters: Parameters of `PARAMETERS` that differ from the defaults, of the agent on which the force acts, one
            number or one per agent. In the papers' symbols they are tau in seconds, V0 in m^2/s^2, sigma in metres,
            Delta t in seconds, 2 phi in radians, c, the standard deviation in m/s of the lateral velocity of a single
            agent (it does not depend on the time step, and decreases over the last metre as the desired speed does), U0
            in m^2/s^2, R in metres, and the parameters of `group_force`.

    Returns:
        Velocities in m/s; 0 for agents that do not move.
    """
    groups: np.ndarray | None = None
    names = _ALONE
    if group is not None and group.max(initial=-1) >= 0:
        groups, names = np.full(walkers.radius.shape, -1), PARAMETERS
        groups[:, 1:] = group
    traits = fill_traits(names, parameters, walkers.radius.shape)
    relaxation = np.maximum(parameters.get("relaxation_time", PARAMETERS["relaxation_time"]), TINY)
    traits[..., 4] = np.cos(np.multiply(parameters.get("sight_angle", SIGHT_ANGLE), 0.5))
    traits[..., 6] = parameters.get("fluctuation", FLUCTUATION) * _acceleration(relaxation, time_step)
    return integrate(_MODEL, walkers, traits, time_step, np.ascontiguousarray(noise), groups)


def _acceleration(relaxation: float | np.ndarray, time_step: float) -> float | np.ndarray:
    """Return the standard deviation of the acceleration that gives the velocity a standard deviation of 1.

    The acceleration is constant during a step and changes the velocity by acceleration * relaxation * (1 - decay). The
    effect of earlier steps decays: an Ornstein-Uhlenbeck process, sampled at every step.

    Args:
        relaxation: Relaxation time in seconds, a number or `[world, agent]`.
        time_step: Length of a step in seconds.

    Returns:
        In 1/s: an acceleration per velocity.
    """
    decay = np.exp(-time_step / relaxation)
    return np.sqrt((1.0 + decay) / (1.0 - decay)) / relaxation


@no_type_check
@njit(forceinline=True)
def _social_force(i, position, velocity, desired, radius, seen, traits, obstacles, w, noise, group):
    """Return all forces on agent i of world w, see `compile_model`."""
    gx, gy, eagerness = desired
    fx, fy = _repulsion(i, position, velocity, gx, gy, radius, seen, traits)
    if obstacles.shape[0] > 0:
        bx, by = _border_repulsion(position[i, 0], position[i, 1], obstacles, traits[i, 7], max(traits[i, 8], TINY))
        fx, fy = fx + bx, fy + by
    if group is not None:  # for None, another kernel is compiled
        bx, by = group_force(i, position, velocity, radius, seen, group[w], traits[i, 9], traits[i, 10], traits[i, 11])
        fx, fy = fx + bx, fy + by
    push = traits[i, 6]
    return fx + eagerness * push * noise[w, i, 0], fy + eagerness * push * noise[w, i, 1], 1.0


_MODEL = compile_model(_social_force)


@no_type_check
@njit(forceinline=True)
def _repulsion(i, position, velocity, gx, gy, radius, seen, traits):
    """Return the sum of the repulsion of all others on agent i, weighted by whether it sees them (equations 7 and 8).

    Args:
        i: Index of the agent.
        position: `[agent, 2]`, in metres.
        velocity: `[agent, 2]`, in m/s.
        gx, gy: The agent's desired velocity in m/s.
        radius: `[agent]`, in metres.
        seen: `[agent]`, whether the agent repels others.
        traits: The parameters of all agents, in the order of `PARAMETERS`; the sight angle is the cosine of its half.

    Returns:
        x and y of an acceleration in m/s^2.
    """
    strength, reach, look_ahead = traits[i, 1], max(traits[i, 2], TINY), traits[i, 3]
    sight, behind = traits[i, 4], traits[i, 5]
    ax, ay = 0.0, 0.0
    desired = math.sqrt(gx * gx + gy * gy)
    for j in range(len(position)):
        if j == i or not seen[j]:
            continue
        x, y = _rim_vector(position[i, 0] - position[j, 0], position[i, 1] - position[j, 1], radius[i] + radius[j])
        fx, fy = _force(x, y, look_ahead * velocity[j, 0], look_ahead * velocity[j, 1], strength, reach)
        toward = -(gx * fx + gy * fy)
        weight = 1.0 if toward >= desired * math.sqrt(fx * fx + fy * fy) * sight else behind
        ax, ay = ax + weight * fx, ay + weight * fy
    return ax, ay


@no_type_check
@njit(forceinline=True)
def _rim_vector(x, y, radii):
    """Return the vector between two centres, shortened by the radii: the paper's r for pedestrians that are discs.

    Its length is almost the gap between the rims if they are apart, `SOFTNESS` if they touch, and decreases smoothly to
    0 with increasing overlap.

    Args:
        x, y: The vector between the centres in metres.
        radii: Sum of the radii in metres.

    Returns:
        x and y of the shortened vector in metres.
    """
    distance = math.sqrt(x * x + y * y)
    if distance == 0.0:
        return 0.0, 0.0
    gap = distance - radii
    length = 0.5 * (gap + math.sqrt(gap * gap + 4.0 * SOFTNESS * SOFTNESS))
    return x * (length / distance), y * (length / distance)


@no_type_check
@njit(forceinline=True)
def _force(x, y, sx, sy, strength, reach):
    """Return the repulsion at (x, y) by a pedestrian at the origin.

    It is minus the gradient of strength * exp(-b / reach) (equation 3), where b is the semi-minor axis of the ellipse
    through (x, y) with the foci (0, 0) and (sx, sy) (equation 4).

    Args:
        x, y: Position at which the repulsion acts, in metres.
        sx, sy: The displacement of that pedestrian within the look-ahead, in metres.
        strength: V0, in m^2/s^2.
        reach: sigma, in metres.

    Returns:
        x and y of an acceleration in m/s^2.
    """
    tx, ty = x - sx, y - sy
    here, there = math.sqrt(x * x + y * y), math.sqrt(tx * tx + ty * ty)
    total = here + there
    b = 0.5 * math.sqrt(max(total * total - (sx * sx + sy * sy), 0.0))
    # Exactly in front of the other the gradient does not exist, and the fluctuation determines the side.
    if b < _HEAD_ON or here == 0.0 or there == 0.0:
        return 0.0, 0.0
    scale = strength / reach * math.exp(-b / reach) * total / (4.0 * b)
    return scale * (x / here + tx / there), scale * (y / here + ty / there)


@no_type_check
@njit(forceinline=True)
def _border_repulsion(x, y, polygons, strength, reach):
    """Return the sum of the repulsion of all borders (equation 5), each from its point nearest to the centre.

    It is minus the gradient of strength * exp(-distance / reach).

    Args:
        x, y: The agent's centre in metres.
        polygons: `[polygon, corner, 2]`, in metres, NaN after the last corner.
        strength: U0, in m^2/s^2.
        reach: R, in metres.

    Returns:
        x and y of an acceleration in m/s^2.
    """
    ax, ay = 0.0, 0.0
    for polygon in polygons:
        corners = number_of_corners(polygon)
        least, dx, dy = math.inf, 0.0, 0.0
        for k in range(corners if corners > 2 else corners - 1):
            first, second = polygon[k], polygon[(k + 1) % corners]
            px, py = nearest_on_segment(x, y, first[0], first[1], second[0], second[1])
            distance = math.sqrt((x - px) * (x - px) + (y - py) * (y - py))
            if distance < least:
                least, dx, dy = distance, x - px, y - py
        # On the border itself there is no direction away from it.
        if 0.0 < least < math.inf:
            scale = strength / reach * math.exp(-least / reach) / least
            ax, ay = ax + scale * dx, ay + scale * dy
    return ax, ay
