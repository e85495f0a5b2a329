"""The forces that hold a group of pedestrians together (Moussaïd et al. 2010), compiled.

A member ahead of the others slows down, so as to see them (gaze); a member far from the group's centre is drawn
to it (attraction); members that come too near push each other away (repulsion). All other forces act within a group
too.

The values are the paper's best fit to the groups that it observed: beta 1 = 4, beta 2 = 3, beta 3 = 1, d0 = 0.8 m,
phi = 90 degrees (caption of its figure 4).
"""

from __future__ import annotations

import math
from typing import no_type_check

from crowdbench.utils.compiled import njit

GAZE = 4.0
"""The paper's beta 1, in 1/(rad s)."""

ATTRACTION = 3.0
"""The paper's beta 2, in m/s^2."""

REPULSION = 1.0
"""The paper's beta 3, in m/s^2."""

SIGHT = math.pi / 2
"""The paper's phi: others are seen up to this angle on both sides of the walking direction, in radians."""

SAFETY = 0.2
"""Gap in metres between rims below which members repel each other. The paper's d0 of 0.8 m is a body of 0.6 m and this
gap."""


@no_type_check
@njit
def group_force(i, position, velocity, radius, present, group, gaze, attraction, repulsion):
    """Return the forces of its group on an agent: the paper's f_vis, f_att and f_rep.

    In a group of N, attraction acts on agents farther than (N - 1) / 2 metres from the group's centre.

    Args:
        i (int): Index of the agent.
        position (array): `[agent, 2]`, in metres.
        velocity (array): `[agent, 2]`, in m/s.
        radius (array): `[agent]`, in metres.
        present (array): `[agent]`.
        group (array): `[agent]`, the index of each agent's group, negative without a group.
        gaze (float): The strength of the gaze, in 1/(rad s).
        attraction (float): The strength of the attraction, in m/s^2.
        repulsion (float): The strength of the repulsion, in m/s^2.

    Returns:
        force (tuple): x and y of an acceleration in m/s^2.
    """
    if group[i] < 0:
        return 0.0, 0.0
    x, y = position[i, 0], position[i, 1]
    others, cx, cy, ax, ay = 0, 0.0, 0.0, 0.0, 0.0
    for j in range(len(radius)):
        if j == i or group[j] != group[i] or not present[j]:
            continue
        others, cx, cy = others + 1, cx + position[j, 0], cy + position[j, 1]
        dx, dy = x - position[j, 0], y - position[j, 1]
        distance = math.sqrt(dx * dx + dy * dy)
        if 0.0 < distance < radius[i] + radius[j] + SAFETY:
            ax, ay = ax + repulsion * dx / distance, ay + repulsion * dy / distance
    if others == 0:
        return 0.0, 0.0
    dx, dy = (cx + x) / (others + 1) - x, (cy + y) / (others + 1) - y
    distance = math.sqrt(dx * dx + dy * dy)
    if distance > 0.5 * others:
        ax, ay = ax + attraction * dx / distance, ay + attraction * dy / distance
    vx, vy = velocity[i, 0], velocity[i, 1]
    dx, dy = cx / others - x, cy / others - y
    angle = abs(math.atan2(vx * dy - vy * dx, vx * dx + vy * dy))
    if angle > SIGHT:
        ax, ay = ax - gaze * (angle - SIGHT) * vx, ay - gaze * (angle - SIGHT) * vy
    return ax, ay
