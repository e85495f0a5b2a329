"""Policies with CrowdNav's interface, and equivalent planners. All are written here; CrowdNav is not needed."""

import abc
import math
from collections import namedtuple

import numpy as np

from crowdbench.planners.planner import Planner

ActionXY = namedtuple("ActionXY", ["vx", "vy"])
ActionRot = namedtuple("ActionRot", ["v", "r"])


class Policy:
    """What the policies here have in common with CrowdNav's."""

    def __init__(self):
        self.phase = self.device = self.env = self.last_state = None
        self.time_step = 0.25

    def set_phase(self, phase):
        self.phase = phase

    def set_device(self, device):
        self.device = device


class Says(Policy):
    """Answers by a function of the state."""

    def __init__(self, answer):
        super().__init__()
        self.answer = answer

    def predict(self, state):
        return self.answer(state)


class Straight(Policy):
    def predict(self, state):
        own = state.self_state
        x, y = own.gx - own.px, own.gy - own.py
        distance = math.sqrt(x * x + y * y)
        return ActionXY(x * own.v_pref / distance, y * own.v_pref / distance)


class NativeStraight(Planner):
    def plan(self, obs):
        offset = obs.vehicle.goal - obs.vehicle.position
        distance = np.sqrt(offset[:, 0] * offset[:, 0] + offset[:, 1] * offset[:, 1])
        return offset * obs.vehicle.preferred_speed[:, None] / distance[:, None]


def pushed(joint):
    """A velocity in m/s away from pedestrians, from joint states `[..., pedestrian, 14]` in CrowdNav's order."""
    offset, radii = joint[..., 0:2] - joint[..., 9:11], joint[..., 4] + joint[..., 13]
    push = offset * (0.01 * radii * joint[..., 7] / (offset**2).sum(axis=-1))[..., None]
    return 0.1 * (joint[..., 11:13] + joint[..., 2:4]) + push


class Pushed(Policy):
    """Adds states, as CrowdNav's networks do."""

    def predict(self, state):
        joint = np.array([state.self_state + human for human in state.human_states])
        return ActionXY(*pushed(joint).mean(axis=0))


class NativePushed(Planner):
    def plan(self, obs):
        vehicle, crowd = obs.vehicle, obs.pedestrians
        own = [vehicle.position, vehicle.velocity, vehicle.radius[:, None], vehicle.goal]
        own += [vehicle.preferred_speed[:, None], vehicle.heading[:, None]]
        own = np.broadcast_to(np.concatenate(own, axis=1)[:, None], (*crowd.seen.shape, 9))
        joint = np.concatenate([own, crowd.position, crowd.velocity, crowd.radius[..., None]], axis=2)
        return pushed(joint).mean(axis=1, where=crowd.seen[..., None])


class Restless(Policy):
    """Turns further away from its goal with every step that it remembers."""

    def __init__(self):
        super().__init__()
        self.states = []

    def predict(self, state):
        self.states.append(state)
        angle = state.self_state.theta + 0.02 * len(self.states)
        return ActionXY(0.9 * math.cos(angle), 0.9 * math.sin(angle))


class Abstract(Policy):
    @abc.abstractmethod
    def predict(self, state):
        return


class Uncopied:
    """As the simulators of RVO2: cannot be copied."""

    def __reduce_ex__(self, protocol):
        raise TypeError("no default __reduce__")


MINE = '''
"""A policy with a memory and with states of its own, which it tests for."""

import math
from collections import namedtuple

from crowdnav import CrowdNavPlanner

FullState = namedtuple("FullState", "px py vx vy radius gx gy v_pref theta")
ObservableState = namedtuple("ObservableState", "px py vx vy radius")
ActionRot = namedtuple("ActionRot", "v r")


class Hesitant:
    phase = None
    last_turn = 0.0

    def set_phase(self, phase):
        self.phase = phase

    def predict(self, state):
        assert self.phase == "test"
        own = state.self_state
        assert isinstance(own, FullState) and all(isinstance(human, ObservableState) for human in state.human_states)
        gap = min(math.hypot(own.px - human.px, own.py - human.py) for human in state.human_states)
        turn = math.remainder(math.atan2(own.gy - own.py, own.gx - own.px) - own.theta, 2 * math.pi)
        self.last_turn = 0.5 * self.last_turn + 0.5 * turn + 0.1 / gap
        return ActionRot(0.9 if gap > 1.0 else 0.0, self.last_turn)


def planner():
    return CrowdNavPlanner(LOADED)


LOADED = Hesitant()
'''
