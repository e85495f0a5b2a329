"""The environments' observations: a vector of `6 * agents` float64 numbers per observing agent.

The first six numbers are of the observing agent, the next six of each other agent, in metres and m/s. Positions are
relative to the observing agent; the axes are those of the world, not turned with the agent. The goal is the local goal
(`crowdbench.geometry.local_goals`):

    observing agent: goal x, goal y, velocity x, velocity y, radius, preferred speed
    other agent:     position x, position y, velocity x, velocity y, radius, 1.0

All six numbers of an agent that is not seen are 0.0. The vehicle observes the pedestrians in their order; a pedestrian
observes the vehicle first, then the other pedestrians in their order.
"""

from __future__ import annotations

from typing import no_type_check

import numpy as np
from jaxtyping import Float

from crowdbench.compiled import njit
from crowdbench.sim.routes import goals_on_way
from crowdbench.sim.simulator import with_hull
from crowdbench.types import Observation, World

AGENT_FEATURES = 6
"""Numbers per agent in an observation."""


def flatten(obs: Observation) -> Float[np.ndarray, "world features"]:
    """What a planner sees, as the vector that the environments return for the vehicle."""
    position, velocity, radius, present = obs.everybody()
    goal = np.ascontiguousarray(obs.vehicle.local_goal[:, None])
    speed = np.ascontiguousarray(obs.vehicle.preferred_speed[:, None])
    out = np.zeros((len(obs), 1, AGENT_FEATURES * radius.shape[1]))
    _flatten(position, velocity, radius, present, goal, speed, True, out)
    return out[:, 0]


def flatten_everybody(world: World) -> Float[np.ndarray, "world agent features"]:
    """The observation of each agent; zeros for agents that are not present.

    Row 0 is `flatten(observe(world))`. Pedestrians do not see a vehicle that is not visible.
    """
    worlds, agents = world.radius.shape
    out = np.zeros((worlds, agents, AGENT_FEATURES * agents))
    shown = with_hull(world)
    _flatten(
        shown.position,
        world.velocity,
        shown.radius,
        world.present,
        goals_on_way(world),
        world.preferred_speed,
        world.rules.visible,
        out,
    )
    return out


@no_type_check
@njit
def _flatten(position, velocity, radius, present, goal, preferred_speed, visible, out):
    """Write observations.

    Args:
        position: `[world, agent, 2]`, in metres.
        velocity: `[world, agent, 2]`, in m/s.
        radius: `[world, agent]`, in metres.
        present: `[world, agent]`, whether the agent can be seen and observes.
        goal: `[world, observer, 2]`, in metres.
        preferred_speed: `[world, observer]`, in m/s.
        visible: Whether pedestrians see the vehicle.
        out: `[world, observer, features]`, zeros, filled. The observers are the first agents.
    """
    worlds, observers, _ = out.shape
    for w in range(worlds):
        for i in range(observers):
            if not present[w, i]:
                continue
            row = out[w, i]
            x, y = position[w, i, 0], position[w, i, 1]
            row[0], row[1] = goal[w, i, 0] - x, goal[w, i, 1] - y
            row[2], row[3] = velocity[w, i, 0], velocity[w, i, 1]
            row[4], row[5] = radius[w, i], preferred_speed[w, i]
            k = 0
            for j in range(radius.shape[1]):
                if j == i:
                    continue
                k += AGENT_FEATURES
                if present[w, j] and (j > 0 or visible):
                    row[k], row[k + 1] = position[w, j, 0] - x, position[w, j, 1] - y
                    row[k + 2], row[k + 3] = velocity[w, j, 0], velocity[w, j, 1]
                    row[k + 4], row[k + 5] = radius[w, j], 1.0
