"""Random scenes, and a slow reference implementation of their joint states."""

import math

import numpy as np


def slow_joint_states(position, velocity, radius, present, goal, preferred_speed):
    """Of one world, as CrowdNav's `rotate` computes them."""
    dx, dy = goal - position[0]
    angle = math.atan2(dy, dx)
    turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
    vehicle = [math.hypot(dx, dy), preferred_speed, 0.0, radius[0], *(turn @ velocity[0])]
    rows = [
        [
            *vehicle,
            *(turn @ (position[p] - position[0])),
            *(turn @ velocity[p]),
            radius[p],
            math.dist(position[p], position[0]),
            radius[p] + radius[0],
        ]
        if present[p]
        else [*vehicle, *[0.0] * 7]
        for p in range(1, len(radius))
    ]
    return np.array(rows or [[*vehicle, *[0.0] * 7]])


def scenes(rng, shape=(), pedestrians=4):
    """Random arguments of `joint_states`; somebody is absent every now and then."""
    agents = pedestrians + 1
    return {
        "position": rng.normal(0.0, 3.0, (*shape, agents, 2)),
        "velocity": rng.normal(0.0, 1.0, (*shape, agents, 2)),
        "radius": rng.uniform(0.2, 0.6, (*shape, agents)),
        "present": rng.random((*shape, agents)) < 0.7,
        "goal": rng.normal(0.0, 5.0, (*shape, 2)),
        "preferred_speed": np.asarray(rng.uniform(0.5, 1.5, shape)),
    }
