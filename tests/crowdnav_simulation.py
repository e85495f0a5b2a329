"""A simulation with CrowdNav's interface: its modules, agents and loop. All is written here; CrowdNav is not needed."""

import math
from collections import namedtuple
from types import ModuleType, SimpleNamespace

import numpy as np
import torch

ActionXY = namedtuple("ActionXY", ["vx", "vy"])
ActionRot = namedtuple("ActionRot", ["v", "r"])


class ObservableState(namedtuple("ObservableState", "px py vx vy radius")):
    pass


class FullState(namedtuple("FullState", "px py vx vy radius gx gy v_pref theta")):
    pass


class Info:
    def __init__(self, min_dist=None):
        self.min_dist = min_dist


class ReachGoal(Info):
    pass


class Collision(Info):
    pass


class Timeout(Info):
    pass


class Danger(Info):
    pass


class Nothing(Info):
    pass


OUTCOMES = [Nothing, ReachGoal, Collision, Timeout, Danger]
"""Outcomes by their numbers in the reference data."""


class ORCA:
    """Decides by `rvo2` in every step, as CrowdNav's does."""

    neighbor_dist, max_neighbors, time_horizon, safety_space = 10.0, 10, 5.0, 0.0
    kinematics = "holonomic"
    sim = None

    def predict(self, state):
        import rvo2

        own, others = state.self_state, state.human_states
        params = self.neighbor_dist, self.max_neighbors, self.time_horizon, 5.0
        agents = [own, *others]
        if self.sim is None:
            self.sim = rvo2.PyRVOSimulator(0.25, *params, 0.3, 1.0)
            for agent in agents:
                self.sim.addAgent(agent[0:2], *params, agent.radius + 0.01 + self.safety_space, 1.0, agent[2:4])
        x, y = own.gx - own.px, own.gy - own.py
        length = max(math.hypot(x, y), 1.0)
        for i, agent in enumerate(agents):
            self.sim.setAgentPosition(i, agent[0:2])
            self.sim.setAgentVelocity(i, agent[2:4])
            self.sim.setAgentPrefVelocity(i, (0.0, 0.0) if i else (x / length, y / length))
        self.sim.doStep()
        return ActionXY(*self.sim.getAgentVelocity(0))


class Agent:
    """The robot, or a human."""

    def __init__(self, start, goal, policy, visible=True):
        (self.px, self.py), (self.gx, self.gy) = start, goal
        self.vx, self.vy, self.theta, self.radius, self.v_pref = 0.0, 0.0, math.pi / 2, 0.3, 1.0
        self.policy, self.visible, self.kinematics = policy, visible, policy.kinematics

    def seen(self, ob):
        return SimpleNamespace(self_state=self.get_full_state(), human_states=ob)

    def act(self, ob):
        return self.policy.predict(self.seen(ob))

    def get_full_state(self):
        return FullState(*(getattr(self, name) for name in FullState._fields))

    def get_observable_state(self):
        return ObservableState(*(getattr(self, name) for name in ObservableState._fields))

    def _after(self, action):
        if self.kinematics == "holonomic":
            return self.px + 0.25 * action.vx, self.py + 0.25 * action.vy, action.vx, action.vy
        vx, vy = action.v * math.cos(self.theta + action.r), action.v * math.sin(self.theta + action.r)
        return self.px + 0.25 * vx, self.py + 0.25 * vy, vx, vy

    def get_next_observable_state(self, action):
        return ObservableState(*self._after(action), self.radius)

    def step(self, action):
        self.px, self.py, self.vx, self.vy = self._after(action)
        self.theta += getattr(action, "r", 0.0)


class Lookahead:
    """A value network that is asked for one action after the other, as CrowdNav's are."""

    phase, device, epsilon, gamma, time_step, with_om, kinematics = "test", "cpu", None, 0.9, 0.25, False, "holonomic"

    def __init__(self, env, query_env):
        self.env, self.query_env = env, query_env
        angles = np.arange(16) * math.pi / 8
        self.action_space = [ActionXY(0.0, 0.0), *(ActionXY(math.cos(a), math.sin(a)) for a in angles.tolist())]
        torch.manual_seed(0)
        self.layers = torch.nn.Sequential(torch.nn.Linear(14, 20), torch.nn.Tanh(), torch.nn.Linear(20, 1))

    def model(self, inputs):
        return self.layers(inputs).mean(dim=1)

    def rotate(self, joint):
        return joint - joint[:, 8:9]

    def transform(self, state):
        return state

    def reach_destination(self, state):
        own = state.self_state
        return math.dist((own.px, own.py), (own.gx, own.gy)) < own.radius

    def propagate(self, own, action):
        return own._replace(px=own.px + 0.25 * action.vx, py=own.py + 0.25 * action.vy, vx=action.vx, vy=action.vy)

    def compute_reward(self, own, humans):
        return min(math.dist((own.px, own.py), (human.px, human.py)) for human in humans) / 10

    def predict(self, state):
        self.action_values = []
        for action in self.action_space:
            own = self.propagate(state.self_state, action)
            if self.query_env:
                humans, reward, _, _ = self.env.onestep_lookahead(action)
            else:
                humans = [self.propagate(human, human) for human in state.human_states]
                reward = self.compute_reward(own, humans)
            joint = torch.tensor([[*own, *human] for human in humans])
            value = self.model(self.rotate(joint)[None]).item()
            self.action_values.append(reward + 0.9 ** (0.25 * state.self_state.v_pref) * value)
        return self.action_space[int(np.argmax(self.action_values))]


class CrowdSim:
    """What a fork has beside the step."""

    time_step, time_limit = 0.25, 25
    success_reward, collision_penalty, discomfort_dist, discomfort_penalty_factor = 1, -0.25, 0.2, 0.5

    def set_robot(self, robot):
        self.robot = robot

    def put(self, position, goal, policy=ORCA):
        """In the place of `reset`: start there, the robot first."""
        self.global_time, self.states, self.human_times = 0, [], [0] * (len(position) - 1)
        self.action_values = []
        (self.robot.px, self.robot.py), (self.robot.gx, self.robot.gy) = position[0], goal[0]
        self.robot.vx = self.robot.vy = 0.0
        self.robot.theta = math.pi / 2
        self.humans = [Agent(*ends, policy()) for ends in zip(position[1:], goal[1:], strict=True)]
        return [human.get_observable_state() for human in self.humans]

    def step(self, action, update=True):
        return "a step of its own"

    def onestep_lookahead(self, action):
        return self.step(action, update=False)


def modules():
    """The modules of a fork."""
    action, info, envs = (ModuleType(name) for name in ("action", "info", "envs"))
    action.ActionXY, envs.CrowdSim = ActionXY, CrowdSim
    vars(info).update({kind.__name__: kind for kind in OUTCOMES})
    parents = {name: ModuleType(name) for name in ("crowd_sim", "crowd_sim.envs.utils")}
    policy = ModuleType("policy")
    policy.MultiHumanRL = Lookahead
    return parents | {
        "crowd_nav.policy.multi_human_rl": policy,
        "crowd_sim.envs": envs,
        "crowd_sim.envs.utils.action": action,
        "crowd_sim.envs.utils.info": info,
    }


def drive(env, ob):
    """CrowdNav's loop: states `[time, agent, position and velocity]`, rewards and outcomes of an episode."""
    states, rewards, outcomes, done = [], [], [], False
    while not done:
        states.append([agent.get_full_state()[0:4] for agent in (env.robot, *env.humans)])
        ob, reward, done, info = env.step(env.robot.act(ob))
        rewards.append(reward)
        outcomes.append(OUTCOMES.index(type(info)))
    states.append([agent.get_full_state()[0:4] for agent in (env.robot, *env.humans)])
    return np.array(states), np.array(rewards), outcomes
