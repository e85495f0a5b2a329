"""The networks of PSS-Social and of its rivals (Zhang, Xu and Aggarwal 2026) as a planner.

Zhang, Xu and Aggarwal, "Don't Freeze, Don't Crash: Extending the Safe Operating Range of Neural Navigation in Dense
Crowds", 2026, arXiv:2603.06729.

    crowdbench run --planner adapters/pss_social/pss_social.py --option weights=pss_social-seed9.safetensors \\
        --scenario adapters/pss_social/square.toml
"""

from __future__ import annotations

import hashlib
import itertools
import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float
from mpe_physics import pairs, positions_of_mpe, velocities_after
from safetensors.torch import load
from torch import Tensor, nn

from crowdbench import InputError, Observation, Planner
from crowdbench.utils import read_regular

OWN, EACH, SUMMARY = 7, 4, 12
"""Numbers of the observation about the vehicle, about each pedestrian, and about the crowd."""

SLOTS, SHOWN = 24, 16
"""Places for pedestrians in the observation, and those that are used: the others are always empty."""

AWAY = 10.0
"""Both coordinates of a pedestrian in an empty place, in metres, and the largest ones."""

FASTEST = 5.0
"""Largest component of a relative velocity in the observation, in m/s."""

EMPTY = 4.0
"""Normalised distance above which DS-RNN takes a place for empty."""

Observed = Float[np.ndarray, "world 115"]


def observe(
    position: Float[np.ndarray, "world agent 2"],
    velocity: Float[np.ndarray, "world agent 2"],
    goal: Float[np.ndarray, "world 2"],
    seen: Bool[np.ndarray, "world pedestrian"],
) -> Observed:
    """Return what the networks observe.

    Args:
        position: Of the vehicle and then of the pedestrians, in metres.
        velocity: In m/s.
        goal: The vehicle's, in metres.
        seen: Pedestrians that exist.
    """
    worlds, own, speed = len(position), position[:, 0], velocity[:, 0]
    ahead = goal - own
    left = np.linalg.norm(ahead, axis=1, keepdims=True)
    away, relative = position[:, 1:] - own[:, None], velocity[:, 1:] - speed[:, None]
    distance = np.where(seen, np.linalg.norm(away, axis=2), np.inf)
    places = np.full((worlds, SLOTS, EACH), [AWAY, AWAY, 0.0, 0.0])
    order = np.argsort(distance, axis=1, kind="stable")[:, :SHOWN]
    row = np.arange(worlds)[:, None]
    bounds = np.array([AWAY, AWAY, FASTEST, FASTEST])
    nearest = np.clip(np.concatenate([away, relative], axis=2)[row, order], -bounds, bounds)
    shown = order.shape[1]
    places[:, :shown] = np.where(seen[row, order, None], nearest, places[:, :shown])
    summary = _summarize(away, relative, distance, speed)
    parts = speed, own, ahead / np.maximum(left, 1e-6), left, places.reshape(worlds, -1), summary
    return np.concatenate(parts, axis=1)


def _summarize(
    away: Float[np.ndarray, "world pedestrian 2"],
    relative: Float[np.ndarray, "world pedestrian 2"],
    distance: Float[np.ndarray, "world pedestrian"],
    velocity: Float[np.ndarray, "world 2"],
) -> Float[np.ndarray, "world 12"]:
    """Return twelve numbers about the crowd.

    They are the size of a repulsive force, the cosine of its angle with the vehicle's velocity, four numbers about the
    nearest pedestrians, shares of the places that people within 0.3, 0.5 and 1 m and all people would fill, and the
    mean relative velocity of people within 1.5 m.
    """
    push = np.where(distance < 2.0, 2.0 * np.exp((0.3 - distance) / 0.5), 0.0)
    force = -(push[..., None] * away / np.maximum(distance, 1e-6)[..., None]).sum(axis=1)
    size, speed = np.linalg.norm(force, axis=1), np.linalg.norm(velocity, axis=1)
    is_defined = (size > 1e-3) & (speed > 1e-3)
    cosine = np.where(is_defined, (force * velocity).sum(axis=1) / np.maximum(size * speed, 1e-6), 0.0)
    three = np.full((len(distance), 3), np.inf)
    nearest = np.sort(np.concatenate([distance, three], axis=1), axis=1)[:, :3]
    closeness = 1.0 / (np.minimum(nearest, AWAY) + 0.1)
    counts = [(distance < bound).sum(axis=1) / SLOTS for bound in (0.3, 0.5, 1.0, np.inf)]
    near = (distance < 1.5)[..., None]
    mean = (near * relative).sum(axis=1) / np.maximum(near.sum(axis=1), 1)
    shares = np.minimum(np.stack(counts, axis=1), 1.0)
    parts = np.clip(np.log1p(size), 0.0, 10.0)[:, None], cosine[:, None], closeness[:, :1], closeness
    return np.concatenate([*parts, shares, np.clip(mean, -FASTEST, FASTEST)], axis=1)


def _split(observed: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return the numbers about the vehicle, about each pedestrian, and about the crowd."""
    end = OWN + SLOTS * EACH
    return observed[:, :OWN], observed[:, OWN:end].unflatten(1, (SLOTS, EACH)), observed[:, end:]


class SARLEncoder(nn.Module):
    """Attention over pedestrians as in SARL, with a learned gate that finds the empty places."""

    def __init__(self) -> None:
        super().__init__()
        self.pairwise_encoder = nn.Sequential(nn.Linear(OWN + EACH, 64), nn.ReLU(), nn.Linear(64, 64))
        self.W_a = nn.Linear(64, 64, bias=False)
        self.gate_net = nn.Sequential(nn.Linear(EACH, 16), nn.ReLU(), nn.Linear(16, 1))
        self.ego_encoder = nn.Sequential(nn.Linear(OWN, 64), nn.ReLU())
        self.scalar_encoder = nn.Sequential(nn.Linear(SUMMARY, 32), nn.ReLU())
        self.fusion = nn.Sequential(nn.Linear(160, 128), nn.ReLU(), nn.Linear(128, 64), nn.ReLU())

    def forward(self, observed: Float[Tensor, "world 115"]) -> Float[Tensor, "world 64"]:
        """Return the features."""
        own, places, summary = _split(observed)
        gate = self.gate_net(places).sigmoid() * (torch.arange(SLOTS) < SHOWN)[:, None]
        each = self.pairwise_encoder(torch.cat([own[:, None].expand(-1, SLOTS, -1), places], dim=2))
        mean = (gate * each).sum(dim=1) / gate.sum(dim=1).clamp(min=1.0)
        score = (self.W_a(each) * mean[:, None]).sum(dim=2, keepdim=True)
        # In effect all attention is on the place with the largest gate: a difference of 1e-7 outweighs the scores.
        attention = (score - 1e9 * (1.0 - gate)).softmax(dim=1)
        crowd = (attention * each).sum(dim=1)
        return self.fusion(torch.cat([self.ego_encoder(own), crowd, self.scalar_encoder(summary)], dim=1))


class DSRNNEncoder(nn.Module):
    """Attention of the vehicle over pedestrians, with four heads. It has no memory, despite its name."""

    heads = 4

    def __init__(self) -> None:
        super().__init__()
        self.ego_encoder = _two_layers(OWN + SUMMARY, 64)
        self.neighbor_encoder = _two_layers(EACH + 2, 64)
        self.attention_query, self.attention_key = nn.Linear(64, 64), nn.Linear(64, 64)
        self.attention_value, self.attention_out = nn.Linear(64, 64), nn.Linear(64, 64)
        self.fusion = _two_layers(128, 128)

    def forward(self, observed: Float[Tensor, "world 115"]) -> Float[Tensor, "world 128"]:
        """Return the features."""
        own, places, summary = _split(observed)
        me = self.ego_encoder(torch.cat([own, summary], dim=1))
        direction = own[:, None, 4:6].expand(-1, SLOTS, -1)
        each = self.neighbor_encoder(torch.cat([places, direction], dim=2))
        query, key, value = (
            layer(features).unflatten(-1, (self.heads, -1))
            for layer, features in (
                (self.attention_query, me),
                (self.attention_key, each),
                (self.attention_value, each),
            )
        )
        score = (query[:, None] * key).sum(dim=3) / math.sqrt(key.shape[3])
        is_filled = places[..., :2].norm(dim=2) < EMPTY
        score = score.masked_fill(~is_filled[..., None], -torch.inf)
        attention = score.softmax(dim=1).nan_to_num(0.0)  # NaN if all places are empty
        crowd = self.attention_out((attention[..., None] * value).sum(dim=1).flatten(1))
        return self.fusion(torch.cat([me, crowd], dim=1))


def _two_layers(inputs: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(inputs, outputs), nn.ReLU(), nn.Linear(outputs, outputs), nn.ReLU())


class Policy(nn.Module):
    """The actor: an encoder, layers with tanh, and the mean action.

    The networks are float32, as in training: SARL's gate depends on its rounding.

    Attributes:
        mean: Mean of each number of the observation in training.
        deviation: Its standard deviation.
    """

    def __init__(self, encoder: nn.Module, sizes: list[int], mean: Tensor, variance: Tensor) -> None:
        super().__init__()
        self.mean, self.deviation = mean.double(), (variance.double() + 1e-8).sqrt()
        self.features_extractor = encoder
        layers: list[nn.Module] = []
        for inputs, outputs in itertools.pairwise(sizes):
            layers += [nn.Linear(inputs, outputs), nn.Tanh()]
        self.mlp_extractor = nn.ModuleDict({"policy_net": nn.Sequential(*layers)})
        self.action_net = nn.Linear(sizes[-1], 5)

    def forward(self, observed: Float[Tensor, "world 115"]) -> Float[Tensor, "world 5"]:
        """Return the mean action: stay, left, right, down and up."""
        normalized = ((observed.double() - self.mean) / self.deviation).clip(-10.0, 10.0).float()
        features = self.features_extractor(normalized)
        answer: Tensor = self.action_net(self.mlp_extractor["policy_net"](features))
        return answer


def load_policy(weights: Path) -> Policy:
    """Return the network with the weights in a file, safetensors with the names of stable-baselines3.

    Raises InputError if the file cannot be read or does not contain the layers of a network of PSS-Social.
    """
    try:
        tensors = load(read_regular(weights))
        policy = _build(tensors)
        own = {name: tensors[name] for name in policy.state_dict()}
        policy.load_state_dict(own)
    except OSError as error:
        raise InputError(f"the weights {weights} cannot be read: {error.strerror}") from None
    except Exception as error:  # torch and safetensors raise many kinds of exceptions
        reason = " ".join(str(error).split())[:200]
        raise InputError(f"the weights {weights} do not belong to a network of PSS-Social: {reason}") from None
    return policy.eval()


def _build(tensors: Mapping[str, Tensor]) -> Policy:
    """Return the network to which the tensors of a file belong, without its weights."""
    layers = [
        tensors[name] for name in sorted(tensors) if name.startswith("mlp_extractor.policy_net.") if "weight" in name
    ]
    sizes = [layers[0].shape[1], *(layer.shape[0] for layer in layers)]
    encoder: nn.Module = nn.Identity()
    if "features_extractor.W_a.weight" in tensors:
        encoder = SARLEncoder()
    elif "features_extractor.attention_key.weight" in tensors:
        encoder = DSRNNEncoder()
    return Policy(encoder, sizes, tensors["obs_mean"], tensors["obs_var"])


class PSSSocialPlanner(Planner):
    """Planner that executes the mean action of a network, for all worlds at once. Its input has no walls.

    Args:
        policy: The network.
        scale: Metres of the scenario per metre of the network's training, such as 2 where people have a radius of
            0.3 m instead of 0.15 m.
        in_mpe: True in the scene of the authors, whose physics acts on the vehicle too, see `mpe_physics`.
    """

    trained_pedestrians, trained_dt = 16, 0.1

    def __init__(self, policy: Policy, scale: float, in_mpe: bool) -> None:
        self.policy, self.scale, self.in_mpe = policy, scale, in_mpe

    def plan(self, obs: Observation) -> Float[np.ndarray, "world 2"]:
        """See `Planner`."""
        position, velocity, _, seen = obs.everybody()
        position, velocity = position / self.scale, velocity / self.scale
        if self.in_mpe:
            position = positions_of_mpe(position, velocity)
        shown = observe(position, velocity, obs.vehicle.local_goal / self.scale, seen[:, 1:])
        with torch.inference_mode():
            answer = self.policy(torch.from_numpy(shown.astype(np.float32))).double().numpy()
        _, left, right, down, up = (answer.clip(-1.0, 1.0).T + 1.0) / 2.0
        action = np.stack([right - left, up - down], axis=1)
        away, distance = (part[:, :1] for part in pairs(position, seen & self.in_mpe))
        command = self.scale * velocities_after(velocity[:, :1], action[:, None], away, distance)[:, 0]
        speed = np.linalg.norm(command, axis=1)
        return command / np.maximum(speed / obs.vehicle.preferred_speed, 1.0)[:, None]


def planner(weights: str, scale: float = 1.0, in_mpe: bool = True) -> PSSSocialPlanner:
    """Make the planner.

    Args:
        weights: The file of the weights.
        scale: Metres of the scenario per metre of the network's training.
        in_mpe: False in other scenes than that of the authors.

    Returns:
        The planner.
    """
    made = PSSSocialPlanner(load_policy(Path(weights)), scale, in_mpe)
    made.facts = {"weights": hashlib.sha256(Path(weights).read_bytes()).hexdigest()[:12]}
    return made
