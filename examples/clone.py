"""Trains a policy to imitate a recorded planner (behaviour cloning), from the table that `crowdbench export` writes:

    crowdbench run --planner ppo --scenario circle_crossing_5 --cases val:5000 --out runs/shown
    crowdbench export runs/shown --out shown
    python examples/clone.py shown/steps.parquet --out clone.safetensors

This file is also the planner: crowdbench run --planner examples/clone.py --option weights=clone.safetensors
"""

import argparse
import itertools

import numpy as np
import pyarrow.parquet as pq
import torch
from safetensors.torch import load_file, save_file
from torch import nn

from crowdbench import Planner, flatten
from crowdbench.views import AGENT_FEATURES

NEAREST = 5
"""Number of pedestrians in the input of the network: the nearest ones."""

HIDDEN, EPOCHS, BATCH = 256, 20, 512


def make_network() -> nn.Sequential:
    """Return a network that maps an observation to a velocity in m/s, along the direction to the goal and across it."""
    sizes = [AGENT_FEATURES * (1 + NEAREST), HIDDEN, HIDDEN, HIDDEN, 2]
    layers = [layer for pair in itertools.pairwise(sizes) for layer in (nn.Linear(*pair), nn.ReLU())]
    return nn.Sequential(*layers[:-1])


def turn(points: np.ndarray, towards: np.ndarray, back: bool = False) -> np.ndarray:
    """Rotate points `[row, n, 2]` to axes along the direction to the goal `[row, 2]` and across it, or back to the axes
    of the world."""
    x, y = (towards / np.maximum(np.linalg.norm(towards, axis=1), 1e-9)[:, None]).T
    axes = np.array([[x, -y], [y, x]] if back else [[x, y], [-y, x]])
    return np.einsum("ijr,rnj->rni", axes, points)


def show(observation: np.ndarray) -> torch.Tensor:
    """Return the input of the network from observations `[row, features]`: the nearest pedestrians, in axes towards the
    goal."""
    agents = observation.reshape(len(observation), -1, AGENT_FEATURES).copy()
    unseen = agents[:, 1:, 4] == 0.0
    distance = np.where(unseen, np.inf, np.linalg.norm(agents[:, 1:, :2], axis=2))
    nearest = np.take_along_axis(agents[:, 1:], np.argsort(distance, axis=1)[:, :NEAREST, None], axis=1)
    goal = agents[:, 0, :2].copy()
    # With the vehicle's velocity in its input, a network learns to repeat it: success is 21 points lower.
    agents[:, 0, 2:4] = 0.0
    agents = np.concatenate([agents[:, :1], nearest, np.zeros((len(agents), NEAREST - nearest.shape[1], 6))], axis=1)
    for numbers in (slice(0, 2), slice(2, 4)):
        agents[..., numbers] = turn(agents[..., numbers], goal)
    return torch.from_numpy(agents.reshape(len(agents), -1)).float()


def clone(table: str, seed: int = 0) -> nn.Sequential:
    """Fit a network to the commands of a table of steps."""
    torch.manual_seed(seed)
    steps = pq.read_table(table, columns=["observation", "action"])
    observation, action = (np.stack(steps[name].to_numpy()) for name in ("observation", "action"))
    shown, wanted = show(observation), torch.from_numpy(turn(action[:, None], observation[:, :2])[:, 0]).float()
    network = make_network()
    optimizer = torch.optim.Adam(network.parameters(), lr=1e-3)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, EPOCHS)
    for epoch in range(EPOCHS):
        total = 0.0
        for rows in torch.randperm(len(shown)).split(BATCH):
            loss = nn.functional.mse_loss(network(shown[rows]), wanted[rows])
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            total += float(loss.detach()) * len(rows)
        schedule.step()
        if epoch % 10 == 9:
            print(f"{epoch + 1} of {EPOCHS} epochs, loss {total / len(shown):.4f}", flush=True)
    return network


class ClonePlanner(Planner):
    """Planner of a cloned policy."""

    def __init__(self, weights):
        self.network = make_network()
        self.network.load_state_dict(load_file(weights))

    def plan(self, obs):
        """Return the velocity of the network, slowed down to the preferred speed."""
        observation = flatten(obs)
        with torch.no_grad():
            velocity = self.network(show(observation)).numpy().astype(float)
        velocity = turn(velocity[:, None], observation[:, :2], back=True)[:, 0]
        limit = obs.vehicle.preferred_speed
        return velocity * (limit / np.maximum(np.hypot(*velocity.T), limit))[:, None]


def planner(weights="clone.safetensors"):
    """Make the planner. `weights` is the file that this script has written."""
    return ClonePlanner(weights)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("table", help="the file steps.parquet")
    parser.add_argument("--out", default="clone.safetensors", help="the weights that are written")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    save_file(clone(arguments.table, arguments.seed).state_dict(), arguments.out)
