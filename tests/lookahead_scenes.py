"""Scenes for a lookahead, and a slow reference implementation of its values and outcomes."""

import dataclasses
import itertools
import math

import numpy as np
import torch
from joint_states import slow_joint_states

from crowdbench.core.types import HISTORY, Observation, Outcome, Pedestrians, Vehicle
from crowdbench.networks.value import NETWORKS, ValueNetwork, alone
from crowdbench.planners.kce import Limits
from crowdbench.planners.scene import scene_of
from crowdbench.predict.predictor import Prediction, Predictor

DT = 0.25


class Nearer(ValueNetwork):
    """Blind to the crowd: the way to the goal alone counts. Remembers how much it was given at once."""

    name = "nearer"

    def __init__(self):
        super().__init__()
        self.unused = torch.nn.Parameter(torch.zeros(1))
        self.given = []

    def crowd(self, joint, present):
        self.given.append(len(joint) * joint.shape[1])
        return alone(joint), torch.zeros(present.shape)


class Far(Nearer):
    """Values every state at 100."""

    def crowd(self, joint, present):
        return torch.full((len(joint),), 100.0), torch.zeros(present.shape)


class Forks(Predictor):
    """Each mode turns everybody by another angle; positions do not follow from the velocity, as with a fitted line."""

    def __init__(self, modes):
        self.turns = 0.7 * (np.arange(modes) - 1.0)

    def predict(self, obs, steps):
        x, y = np.moveaxis(obs.pedestrians.velocity, -1, 0)
        c, s = np.cos(self.turns), np.sin(self.turns)
        turned = np.einsum("xwpm->wmpx", [np.multiply.outer(x, c) - np.multiply.outer(y, s),
                                          np.multiply.outer(x, s) + np.multiply.outer(y, c)])  # fmt: skip
        ahead = np.arange(1, steps + 1)[:, None, None]
        velocity = turned[:, :, None] * (1.0 + 0.2 * ahead)
        return Prediction(obs.pedestrians.position[:, None, None] + 0.05 + 0.3 * ahead * velocity, velocity)


class Says(Predictor):
    """Says that the crowd will be at the given positions `[time, pedestrian, 2]`."""

    def __init__(self, position):
        self.position = np.array(position, float)

    def predict(self, obs, steps):
        position = np.repeat(self.position[None, None, :steps], len(obs), axis=0)
        return Prediction(position, np.zeros(position.shape))


def crowded(worlds=6, pedestrians=4, seed=0):
    """Vehicles close to their goals among pedestrians; nobody is in world 0, everybody in world 1."""
    rng = np.random.default_rng(seed)
    angle = rng.uniform(-np.pi, np.pi, (worlds, pedestrians))
    away = rng.uniform(0.6, 1.6, (worlds, pedestrians, 1)) * np.stack([np.cos(angle), np.sin(angle)], -1)
    vehicle = rng.normal(0.0, 3.0, (worlds, 2))
    present = rng.random((worlds, pedestrians)) < 0.7
    present[0], present[1] = False, True
    # The absent stand in the way.
    position = vehicle[:, None] + np.where(present[..., None], away, 0.0)
    velocity = rng.normal(0.0, 0.8, (worlds, pedestrians, 2))
    past = DT * np.arange(1 - HISTORY, 1)[:, None, None]
    return Observation(
        vehicle=Vehicle(
            position=vehicle,
            velocity=rng.normal(0.0, 0.5, (worlds, 2)),
            heading=np.zeros(worlds),
            angular_speed=np.zeros(worlds),
            goal=vehicle + rng.normal(0.0, 0.4, (worlds, 2)),
            route=np.zeros((worlds, 0, 2)),
            waypoint=np.zeros(worlds, int),
            radius=rng.uniform(0.2, 0.35, worlds),
            preferred_speed=rng.uniform(0.6, 1.5, worlds),
        ),
        pedestrians=Pedestrians(
            position=position,
            velocity=velocity,
            radius=rng.uniform(0.2, 0.4, (worlds, pedestrians)),
            seen=present,
            history=position[:, None] + past * velocity[:, None],
            observed=np.where(present, HISTORY, 0),
            age=np.where(present, 0.0, np.inf),
        ),
        obstacles=np.zeros((worlds, 0, 0, 2)),
        row=np.arange(worlds),
        noise_key=np.arange(worlds, dtype=np.uint64),
        step=np.full(worlds, HISTORY),
        dt=DT,
        future=velocity,
    )


def network(name="sarl"):
    """Untrained, but with values that differ much from state to state."""
    torch.manual_seed(1)
    made = NETWORKS[name]()
    with torch.no_grad():
        for values in made.parameters():
            values *= 2.0
    return made


def scene(obs, prediction, ahead=0, position=None):
    vehicle = obs.vehicle if position is None else dataclasses.replace(obs.vehicle, position=position)
    return scene_of(obs, prediction, ahead, vehicle)


def slow_step(scene, w, mode, command):
    """Outcome, reward and next joint states of one command in one future, by the published rules."""
    vehicle, crowd = scene.vehicle, scene.crowd
    share = np.linspace(0.0, 1.0, 401)[:, None]
    own = vehicle.position[w] + share * scene.dt * command
    gap = math.inf
    for p in np.flatnonzero(crowd.present[w]):
        start, end = crowd.position[w, mode, 0, p], crowd.position[w, mode, 1, p]
        distance = np.sqrt((((1.0 - share) * start + share * end - own) ** 2).sum(axis=1))
        gap = min(gap, distance.min() - crowd.radius[w, p] - vehicle.radius[w])
    if gap < 0.0:
        outcome, reward = Outcome.COLLISION, -0.25
    elif math.dist(own[-1], vehicle.goal[w]) < vehicle.radius[w]:
        outcome, reward = Outcome.SUCCESS, 1.0
    else:
        outcome, reward = Outcome.RUNNING, (gap - 0.2) * 0.5 * scene.dt if gap < 0.2 else 0.0
    joint = slow_joint_states(
        np.concatenate([own[-1:], crowd.position[w, mode, 1]]),
        np.concatenate([command[None], crowd.velocity[w, mode]]),
        np.append(vehicle.radius[w], crowd.radius[w]),
        np.append(True, crowd.present[w]),
        vehicle.goal[w],
        vehicle.preferred_speed[w],
    )
    return outcome, reward, joint


def slow_values(scene, commands, network):
    """The values and the outcomes `[world, action, mode]`, one command in one future at a time."""
    vehicle, crowd = scene.vehicle, scene.crowd
    worlds, actions, modes = *commands.shape[:2], crowd.position.shape[1]
    outcomes, values = np.zeros((worlds, actions, modes), int), np.zeros((worlds, actions))
    for w in range(worlds):
        steps = [slow_step(scene, w, m, commands[w, a]) for a, m in itertools.product(range(actions), range(modes))]
        joint = torch.tensor(np.array([joint for _, _, joint in steps]), dtype=torch.float32)
        present = torch.from_numpy(np.repeat(crowd.present[None, w], len(steps), axis=0))
        later = 0.9 ** (scene.dt * vehicle.preferred_speed[w]) * network(joint, present).detach().numpy()
        total = [r + (v if o == Outcome.RUNNING else 0.0) for (o, r, _), v in zip(steps, later, strict=True)]
        outcomes[w] = np.array([o for o, _, _ in steps]).reshape(actions, modes)
        values[w] = [np.mean(each) for each in np.array(total).reshape(actions, modes)]
    return values, outcomes


def assert_best(chosen, commands, values):
    """Each world's chosen command is one of its commands and, but for ties, the best of them."""
    for w in range(len(chosen)):
        same = (commands[w] == chosen[w]).all(axis=1)
        assert same.any()
        assert values[w, same].max() >= values[w].max() - 1e-5


def within(change):
    """Limits to commands that differ from the velocity by no more than so many m/s."""
    return Limits(max_acceleration=math.inf, max_turn=math.pi, max_velocity_change=change)


def lone_vehicle(goal=(4.0, 0.0)):
    """A vehicle at rest in the origin that nobody sees, and one person far away."""
    obs = crowded(2, 1).take(slice(1, 2))
    own = {"position": [0.0, 0.0], "velocity": [0.0, 0.0], "goal": goal}
    numbers = {"radius": 0.3, "preferred_speed": 1.0, "heading": 0.0, "angular_speed": 0.0}
    vehicle = {name: np.array([value], float) for name, value in (own | numbers).items()}
    crowd = {"position": np.array([[[9.0, 9.0]]]), "radius": np.array([[0.3]]), "velocity": np.zeros((1, 1, 2))}
    return dataclasses.replace(
        obs,
        vehicle=dataclasses.replace(obs.vehicle, **vehicle),
        pedestrians=dataclasses.replace(obs.pedestrians, **crowd),
        row=np.array([0]),
    )
