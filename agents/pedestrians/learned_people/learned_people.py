"""Pedestrians with a network that was trained on recorded people, and ORCA as its filter, see studies/people.

The network predicts a pedestrian's mean velocity over the next 1.2 s from its own motion, its goal and the nearest
agents. The preferred velocity of ORCA (van den Berg et al. 2011) approaches this prediction.
"""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, no_type_check

import numpy as np
from safetensors.numpy import load_file

from agents.pedestrians.orca_people import VARIED, ORCAPeople, avoid_people
from crowdbench import PedestrianPolicy, World
from crowdbench.sim import Parameters, Velocities, goals_on_way
from crowdbench.utils import njit

WEIGHTS = Path(__file__).with_name("learned_people.safetensors")

NEAREST, REACH = 6, 6.0
"""Number of other agents that a pedestrian observes, and the distance in metres within which it does."""

FAR = 10.0
"""Distance in metres beyond which goals are equally far."""

APPROACH = 0.6
"""Time in seconds in which the prediction is reached: the middle of the time over which it is the mean."""

STANDS, WALKS = 0.6, 0.9
"""Shares of the preferred speed: the network counts above the first one, and fully above the second one."""

TINY = 1e-9
"""Replacement of 0 in numbers by which a formula divides."""

FEATURES = 4 + 5 * NEAREST


class LearnedPeople(PedestrianPolicy):
    """ORCA whose preferred velocities come from a network that was trained on recorded people."""

    parameters: ClassVar[Mapping[str, float]] = {
        **ORCAPeople.parameters,
        "time_horizon": 1.7,
        "neighbor_distance": 4.0,
        "personal_space": 1.1,
    }
    population: ClassVar[Mapping[str, Any]] = {
        "noise": 0.474,
        "noise_time": 0.69,
        "inertia": 3.6,
        "shrinkage": 0.026,
        "spread": {"preferred_speed": 0.33, "inertia": 0.57, **dict.fromkeys(VARIED, 0.635)},
    }

    def __init__(self) -> None:
        weights = load_file(WEIGHTS)
        self.weights = [np.ascontiguousarray(weights[name].T, np.float64) for name in sorted(weights)]

    def velocities(self, world: World, parameters: Parameters) -> Velocities:
        """See `PedestrianPolicy`."""
        here = world.position, world.velocity, goals_on_way(world), world.preferred_speed, world.present
        predicted = predict_velocities(observe(*here), *here, *self.weights)
        share = min(world.rules.dt / APPROACH, 1.0)
        return avoid_people(world, world.velocity + share * (predicted - world.velocity), parameters)


@no_type_check
@njit
def observe(position, velocity, goal, speed, present):
    """Return what each agent observes, in its frame: x points to its goal.

    Args:
        position: `[world, agent, 2]`, in metres.
        velocity: `[world, agent, 2]`, in m/s.
        goal: `[world, agent, 2]`, in metres.
        speed: `[world, agent]`, preferred speeds in m/s.
        present: `[world, agent]`.

    Returns:
        `[world, agent, feature]`: velocity, preferred speed, and distance to the goal in `FAR`; then of each of the
        nearest agents the position in `REACH`, velocity, and 1 if there is one.
    """
    worlds, agents = speed.shape
    observed = np.zeros((worlds, agents, FEATURES))
    for w in range(worlds):
        for i in range(agents):
            if not present[w, i]:
                continue
            to_goal = goal[w, i] - position[w, i]
            distance = np.sqrt(to_goal[0] ** 2 + to_goal[1] ** 2)
            x, y = (to_goal[0] / distance, to_goal[1] / distance) if distance > 1e-9 else (1.0, 0.0)
            row = observed[w, i]
            row[0] = x * velocity[w, i, 0] + y * velocity[w, i, 1]
            row[1] = x * velocity[w, i, 1] - y * velocity[w, i, 0]
            row[2] = speed[w, i]
            row[3] = min(distance / FAR, 1.0)
            _observe_nearest(position[w], velocity[w], present[w], i, x, y, row[4:])
    return observed


@no_type_check
@njit
def _observe_nearest(position, velocity, present, i, x, y, row):
    """Fill what an agent observes of the nearest others, the nearest first."""
    nearest = np.full(NEAREST, REACH)
    number = np.full(NEAREST, -1)
    for j in range(len(position)):
        if j == i or not present[j]:
            continue
        distance = np.sqrt((position[j, 0] - position[i, 0]) ** 2 + (position[j, 1] - position[i, 1]) ** 2)
        rank = NEAREST
        while rank > 0 and distance < nearest[rank - 1]:
            rank -= 1
        if rank < NEAREST:
            nearest[rank + 1 :] = nearest[rank:-1].copy()
            number[rank + 1 :] = number[rank:-1].copy()
            nearest[rank], number[rank] = distance, j
    for rank in range(NEAREST):
        if number[rank] >= 0:
            apart, moving = position[number[rank]] - position[i], velocity[number[rank]]
            row[5 * rank] = (x * apart[0] + y * apart[1]) / REACH
            row[5 * rank + 1] = (x * apart[1] - y * apart[0]) / REACH
            row[5 * rank + 2] = x * moving[0] + y * moving[1]
            row[5 * rank + 3] = x * moving[1] - y * moving[0]
            row[5 * rank + 4] = 1.0


@no_type_check
@njit
def predict_velocities(observed, position, velocity, goal, speed, present, b0, b1, b2, w0, w1, w2):
    """Return the network's velocity of each agent in m/s, `[world, agent, 2]`.

    The outputs are the changes, in the frame of `observe`, of the velocity towards the goal at the preferred speed.
    They count in full for people who walk. Recorded people who stand want to stand, but others have to start.
    Rows are computed separately, because matrix products depend on the batch.
    """
    wanted = np.zeros(position.shape)
    for w in range(len(observed)):
        for i in range(observed.shape[1]):
            to_goal = goal[w, i] - position[w, i]
            distance = np.sqrt(to_goal[0] ** 2 + to_goal[1] ** 2)
            if distance < 1e-9 or not present[w, i]:
                continue
            change = _network(observed[w, i], b0, b1, b2, w0, w1, w2)
            pace = math.sqrt(velocity[w, i, 0] ** 2 + velocity[w, i, 1] ** 2) / max(speed[w, i], TINY)
            share = min(max((pace - STANDS) / (WALKS - STANDS), 0.0), 1.0)
            x, y = to_goal[0] / distance, to_goal[1] / distance
            ahead, left = min(speed[w, i], distance) + share * change[0], share * change[1]
            wanted[w, i, 0] = x * ahead - y * left
            wanted[w, i, 1] = y * ahead + x * left
    return wanted


@no_type_check
@njit
def _network(values, b0, b1, b2, w0, w1, w2):
    """Return the output of a network with two hidden layers of tanh; weights are `[input, unit]`."""
    for layer, (weight, bias) in enumerate(((w0, b0), (w1, b1), (w2, b2))):
        out = bias.copy()
        for index in range(len(values)):
            for unit in range(len(out)):
                out[unit] += weight[index, unit] * values[index]
        values = np.tanh(out) if layer < 2 else out
    return values


def policy() -> LearnedPeople:
    """Make the policy. Its parameters are set in the scenario, in `[pedestrians.learned_people]`.

    Parameters:
        neighbor_distance: Distance within which a pedestrian avoids others [m].
        max_neighbors: Number of nearest neighbours that a pedestrian avoids [1].
        time_horizon: Time horizon for collisions with other agents: the paper's tau [s].
        safety_space: Margin that is added to every radius [m].
        time_horizon_obst: Time horizon for collisions with obstacles [s].
        line_of_sight: 1 if a pedestrian ignores agents behind obstacles; 0 if it avoids them, as in RVO2 [1].
        personal_space: Distance between the centres of two pedestrians that a pedestrian keeps, in diameters of its
            body [1].

    Returns:
        The policy.
    """
    return LearnedPeople()
