"""DS-RNN (Liu et al. 2021) as a planner, with the weights of its authors.

Liu, Chang, Liang, Chakraborty and Driggs-Campbell, "Decentralized Structural-RNN for Robot Crowd Navigation with Deep
Reinforcement Learning", ICRA 2021, arXiv:2011.04820.

    crowdbench run --planner adapters/ds_rnn/ds_rnn.py --option weights=27776.pt --scenario adapters/ds_rnn/circle.toml
"""

from __future__ import annotations

import hashlib
import io
import math
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from safetensors.torch import load
from torch import Tensor, nn

from crowdbench import InputError, Observation, Planner
from crowdbench.utils import read_regular

SOURCE = "https://github.com/Shuijing725/CrowdNav_DSRNN"

MOST_CHANGE = 0.1
"""Largest change in one step of a unicycle's speed in m/s, and of its heading in radians."""

HOLONOMIC_HEADING = math.pi / 2
"""Heading in the input of a holonomic vehicle's network during all of its training, in radians."""

LAYERS = {
    "robot_linear": "robot",
    "humanNodeRNN.encoder_linear": "robot_embedding",
    "humanNodeRNN.edge_attention_embed": "edges_embedding",
    "humanNodeRNN.gru": "node",
    "humanNodeRNN.output_linear": "node_output",
    "humanhumanEdgeRNN_temporal.encoder_linear": "temporal_embedding",
    "humanhumanEdgeRNN_temporal.gru": "temporal",
    "humanhumanEdgeRNN_spatial.encoder_linear": "spatial_embedding",
    "humanhumanEdgeRNN_spatial.gru": "spatial",
    "attn.temporal_edge_layer.0": "query",
    "attn.spatial_edge_layer.0": "key",
    "actor.0": "actor.0",
    "actor.2": "actor.2",
    "dist.fc_mean": "action",
}
"""Layers by their names in the file of the weights. Its other layers belong to the critic and the variance."""


class DSRNN(nn.Module):
    """The actor network: an RNN for each edge, attention over the spatial edges, and an RNN for the robot's node."""

    def __init__(self) -> None:
        super().__init__()
        self.temporal_embedding, self.temporal = nn.Linear(2, 64), nn.GRUCell(64, 256)
        self.spatial_embedding, self.spatial = nn.Linear(2, 64), nn.GRUCell(64, 256)
        self.query, self.key = nn.Linear(256, 64), nn.Linear(256, 64)
        self.robot, self.robot_embedding = nn.Linear(7, 3), nn.Linear(3, 64)
        self.edges_embedding, self.node = nn.Linear(512, 64), nn.GRUCell(128, 128)
        self.node_output = nn.Linear(128, 256)
        self.actor = nn.Sequential(nn.Linear(256, 256), nn.Tanh(), nn.Linear(256, 256), nn.Tanh())
        self.action = nn.Linear(256, 2)

    def forward(
        self,
        robot: Float[Tensor, "world 7"],
        velocity: Float[Tensor, "world 2"],
        away: Float[Tensor, "world person 2"],
        known: Bool[Tensor, "world person"],
        node: Float[Tensor, "world 128"],
        edges: Float[Tensor, "world edge 256"],
    ) -> tuple[Float[Tensor, "world 2"], Float[Tensor, "world 128"], Float[Tensor, "world edge 256"]]:
        """Return the mean action, and the hidden states of the node and of the edges.

        Args:
            robot: Position, radius, goal, preferred speed and heading of the robot, in metres, m/s and radians.
            velocity: Velocity of the robot in m/s: the temporal edge.
            away: Vector from the robot to each pedestrian in metres: the spatial edges.
            known: True for pedestrians that have been seen; the others have no influence.
            node: Hidden state of the node.
            edges: Hidden states of the temporal edge and of each spatial edge.
        """
        temporal = self.temporal(self.temporal_embedding(velocity).relu(), edges[:, 0])
        embedded = self.spatial_embedding(away).relu().flatten(0, 1)
        spatial = self.spatial(embedded, edges[:, 1:].flatten(0, 1)).view_as(edges[:, 1:])
        spatial = torch.where(known[..., None], spatial, 0.0)
        sharpness = known.sum(dim=1, keepdim=True) / math.sqrt(64)
        scores = sharpness * (self.key(spatial) * self.query(temporal)[:, None]).sum(dim=2)
        attention = torch.where(known, scores, -torch.inf).softmax(dim=1).nan_to_num(0.0)  # NaN if none is known
        attended = (attention[..., None] * spatial).sum(dim=1)
        around = self.edges_embedding(torch.cat([temporal, attended], dim=1)).relu()
        own = self.robot_embedding(self.robot(robot)).relu()
        node = self.node(torch.cat([own, around], dim=1), node)
        action = self.action(self.actor(self.node_output(node)))
        return action, node, torch.cat([temporal[:, None], spatial], dim=1)


def load_ds_rnn(weights: Path) -> DSRNN:
    """Return the network with the weights in a file: safetensors, or a checkpoint of the authors' repository (.pt).

    It computes in float64. In float32, rounding depends on the number of worlds, and the hidden states accumulate it.

    Raises InputError if the file cannot be read or does not contain the layers of the network.
    """
    network = DSRNN()
    try:
        content = read_regular(weights)
    except OSError as error:
        advice = f"get them from {SOURCE}, and give --option weights=FILE"
        raise InputError(f"the weights {weights} cannot be read: {error.strerror}; {advice}") from None
    try:
        is_checkpoint = weights.suffix == ".pt"
        tensors = torch.load(io.BytesIO(content), "cpu", weights_only=True) if is_checkpoint else load(content)
        state = {}
        for name, tensor in tensors.items():
            layer, _, part = name.removeprefix("base.").rpartition(".")
            if layer in LAYERS:
                state[f"{LAYERS[layer]}.{part.removesuffix('_l0')}"] = tensor
        network.load_state_dict(state)
    except Exception as error:  # torch and safetensors raise many kinds of exceptions
        reason = " ".join(str(error).split())[:200]
        raise InputError(f"the weights {weights} do not belong to a DS-RNN: {reason}") from None
    return network.double().eval()


class DSRNNPlanner(Planner):
    """Planner that executes the mean action of a DS-RNN, for all worlds at once. Its input has no walls.

    A pedestrian out of sight is extrapolated at constant velocity, as in the authors' simulator. A pedestrian that has
    not been seen yet has no influence, while that simulator places it far away.

    Args:
        network: The network.
        unicycle: True if its actions are changes of speed and of heading per step.
    """

    def __init__(self, network: DSRNN, unicycle: bool = False) -> None:
        self.network = network
        self.native = "unicycle" if unicycle else False
        self.trained_pedestrians, self.trained_dt = 5, 0.1 if unicycle else 0.25
        self.reset(np.arange(0))

    def reset(self, rows: Int[np.ndarray, "world"]) -> None:
        """See `Planner`."""
        self.node = torch.zeros(len(rows), 128, dtype=torch.float64)
        self.edges = self.node.new_zeros(len(rows), 0, 256)
        self.last, self.known = np.empty((len(rows), 0, 4)), np.empty((len(rows), 0), bool)

    def plan(self, obs: Observation) -> Float[np.ndarray, "world 2"]:
        """See `Planner`."""
        vehicle, row, crowd = obs.vehicle, obs.row, obs.pedestrians
        worlds, people = max(len(self.node), row.max() + 1), crowd.seen.shape[1]
        if self.edges.shape[:2] != (worlds, people + 1):  # the first step of a batch
            self.node = self.node.new_zeros(worlds, 128)
            self.edges = self.node.new_zeros(worlds, people + 1, 256)
            self.last, self.known = np.zeros((worlds, people, 4)), np.zeros((worlds, people), bool)
        last = self.last[row]
        last[..., :2] += obs.dt * last[..., 2:]
        now = np.concatenate([crowd.position, crowd.velocity], axis=2)
        self.last[row] = last = np.where(crowd.seen[..., None], now, last)
        self.known[row] |= crowd.seen
        heading = vehicle.heading % math.tau if self.native else np.full(len(obs), HOLONOMIC_HEADING)
        parts = vehicle.position, vehicle.radius, vehicle.local_goal, vehicle.preferred_speed, heading
        shown = np.column_stack(parts), vehicle.velocity, last[..., :2] - vehicle.position[:, None]
        with torch.inference_mode():
            tensors = [torch.from_numpy(array) for array in (*shown, self.known[row])]
            mean, self.node[row], self.edges[row] = self.network(*tensors, self.node[row], self.edges[row])
        action: np.ndarray = mean.numpy()
        if not self.native:
            speed = np.linalg.norm(action, axis=1)
            return action / np.maximum(speed / vehicle.preferred_speed, 1.0)[:, None]
        change = np.clip(action, -MOST_CHANGE, MOST_CHANGE)
        # Differs from the authors' simulator, whose unicycle also drives backwards.
        speed = np.clip(np.linalg.norm(vehicle.velocity, axis=1) + change[:, 0], 0.0, vehicle.preferred_speed)
        return np.column_stack([speed, change[:, 1] / obs.dt])


def planner(weights: str = "27776.pt", unicycle: bool = False) -> DSRNNPlanner:
    """Make the planner.

    Args:
        weights: The file of the weights.
        unicycle: True if they were trained with a unicycle.

    Returns:
        The planner.
    """
    made = DSRNNPlanner(load_ds_rnn(Path(weights)), unicycle)
    made.facts = {"weights": hashlib.sha256(Path(weights).read_bytes()).hexdigest()[:12]}
    return made
