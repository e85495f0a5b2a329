"""IPPO of TorchRL in PettingZoo, a network for the vehicle and one for all pedestrians: python examples/ippo_torchrl.py

Needs `pip install torchrl crowdbench`. 80 updates take X minutes on a core. The vehicle then reaches X % success on
validation cases, among pedestrians that follow ORCA.
"""

import argparse

import torch
from tensordict.nn import AddStateIndependentNormalScale, TensorDictModule, TensorDictSequential
from torch.distributions import Independent, Normal
from torchrl.collectors import Collector
from torchrl.envs import PettingZooWrapper, SerialEnv
from torchrl.modules import MLP, ProbabilisticActor
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

import crowdbench

SCENARIO, WORLDS, FRAMES, EPOCHS, BATCH = "circle_crossing_5_visible", 16, 1024, 6, 256
VIEW = {"observation": "goal_frame", "action": "normalized_goal_frame", "nearest": 5}
GROUPS = {"vehicle": ["vehicle"], "pedestrians": [f"pedestrian_{number}" for number in range(5)]}
SIZES = {"in_features": 50, "num_cells": [64, 64], "activation_class": torch.nn.Tanh}
parser = argparse.ArgumentParser()
parser.add_argument("--updates", type=int, default=80)
parser.add_argument("--seed", type=int, default=0)
args = parser.parse_args()
torch.manual_seed(args.seed)
torch.set_num_threads(1)


def make():
    """Return one world."""
    env = crowdbench.parallel_env(SCENARIO, reward="progress", **VIEW)
    return PettingZooWrapper(env, group_map=GROUPS, use_mask=True)


means, actors, estimators, losses = {}, {}, {}, {}
for group in GROUPS:
    seen, normal, value = (group, "observation"), {"loc": (group, "loc"), "scale": (group, "scale")}, (group, "value")
    keys = {name: (group, name) for name in ("reward", "done", "terminated", "advantage", "value_target", "value")}
    means[group] = MLP(**SIZES, out_features=2)
    network = torch.nn.Sequential(means[group], AddStateIndependentNormalScale(2))
    options = {"distribution_class": lambda loc, scale: Independent(Normal(loc, scale), 1), "return_log_prob": True}
    network = TensorDictModule(network, [seen], [*normal.values()])
    action, log_prob = (group, "action"), (group, "log_prob")
    actors[group] = ProbabilisticActor(network, normal, [action], log_prob_key=log_prob, **options)
    critic = TensorDictModule(MLP(**SIZES, out_features=1), [seen], [value])
    estimators[group] = GAE(gamma=0.97, lmbda=0.95, value_network=critic, average_gae=True)
    estimators[group].set_keys(**keys)
    losses[group] = ClipPPOLoss(actors[group], critic, entropy_bonus=False)
    losses[group].set_keys(action=action, sample_log_prob=log_prob, **keys)
worlds, total = SerialEnv(WORLDS, make), args.updates * FRAMES
worlds.set_seed(args.seed)
optimizer = torch.optim.Adam([part for loss in losses.values() for part in loss.parameters()], 7e-4)
for data in Collector(worlds, TensorDictSequential(*actors.values()), frames_per_batch=FRAMES, total_frames=total):
    for group, estimate in estimators.items():
        estimate(data)[group, "advantage"] *= data[group, "mask"][..., None]  # agents that arrived do not act
    print(f"mean reward {data['next', 'vehicle', 'reward'].mean():.3f}", flush=True)
    for rows in torch.cat([torch.randperm(FRAMES) for _ in range(EPOCHS)]).split(BATCH):
        batch = data.reshape(-1)[rows]
        optimizer.zero_grad()
        for loss in losses.values():
            parts = loss(batch)
            (parts["loss_objective"] + parts["loss_critic"]).backward()
        optimizer.step()
planner = crowdbench.PolicyPlanner(lambda seen: means["vehicle"](torch.as_tensor(seen)).detach().numpy(), **VIEW)
success = crowdbench.run(planner, SCENARIO, "val:200").metrics["success_rate"].mean
print(f"{100 * success:.1f} % success on validation cases")
