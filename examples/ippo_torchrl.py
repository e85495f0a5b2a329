"""IPPO of TorchRL in PettingZoo, with one network of all agents: python examples/ippo_torchrl.py

Needs `pip install torchrl .`. It prints the vehicle's success among pedestrians that have learned.
"""

import argparse

import numpy as np
import torch
from tensordict.nn import AddStateIndependentNormalScale, TensorDictModule
from torch.distributions import Independent, Normal
from torchrl.collectors import Collector
from torchrl.envs import MarlGroupMapType, PettingZooWrapper, SerialEnv
from torchrl.modules import MLP, ProbabilisticActor
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

import crowdbench

SCENARIO, WORLDS, FRAMES, EPOCHS, BATCH, CASES = "circle_crossing_5_visible", 16, 1024, 6, 256, 200
VIEW = {"reward": "progress", "observation": "goal_frame", "action": "normalized_goal_frame", "nearest": 5}
KEYS = {name: ("agents", name) for name in ("reward", "done", "terminated", "advantage", "value_target", "value")}
SEEN, ACTION, PROBABILITY, LOC, SCALE = (("agents", n) for n in ("observation", "action", "log_prob", "loc", "scale"))
GROUP = {"group_map": MarlGroupMapType.ALL_IN_ONE_GROUP, "use_mask": True}
parser = argparse.ArgumentParser()
parser.add_argument("--updates", type=int, default=100)
parser.add_argument("--seed", type=int, default=0)
args = parser.parse_args()
torch.manual_seed(args.seed)
torch.set_num_threads(1)  # networks this small are faster in one thread
env = crowdbench.parallel_env(SCENARIO, **VIEW)
sizes = {"in_features": env.observation_space("vehicle").shape[0], "num_cells": [64, 64]}
mean, value = (MLP(**sizes, out_features=n, activation_class=torch.nn.Tanh) for n in (2, 1))
policy = {"distribution_class": lambda loc, scale: Independent(Normal(loc, scale), 1), "return_log_prob": True}
normal = TensorDictModule(torch.nn.Sequential(mean, AddStateIndependentNormalScale(2)), [SEEN], [LOC, SCALE])
actor = ProbabilisticActor(normal, {"loc": LOC, "scale": SCALE}, [ACTION], log_prob_key=PROBABILITY, **policy)
critic = TensorDictModule(value, [SEEN], [KEYS["value"]])
estimate = GAE(gamma=0.97, lmbda=0.95, value_network=critic, average_gae=True)
estimate.set_keys(**KEYS)
loss = ClipPPOLoss(actor, critic, entropy_bonus=False)
loss.set_keys(action=ACTION, sample_log_prob=PROBABILITY, **KEYS)
optimizer = torch.optim.Adam(loss.parameters(), 7e-4)
worlds = SerialEnv(WORLDS, lambda: PettingZooWrapper(crowdbench.parallel_env(SCENARIO, **VIEW), **GROUP))
worlds.set_seed(args.seed)
for data in Collector(worlds, actor, frames_per_batch=FRAMES, total_frames=args.updates * FRAMES):
    estimate(data)["agents", "advantage"] *= data["agents", "mask"][..., None]  # agents that arrived do not act
    for rows in torch.cat([torch.randperm(FRAMES) for _ in range(EPOCHS)]).split(BATCH):
        losses = loss(data.reshape(-1)[rows])
        optimizer.zero_grad()
        (losses["loss_objective"] + losses["loss_critic"]).backward()
        optimizer.step()
arrived = 0
for case in range(CASES):
    seen, _ = env.reset(options={"case": f"val/{case}"})
    while env.agents:
        actions = mean(torch.as_tensor(np.array([seen[agent] for agent in env.agents]))).detach().numpy()
        seen, _, _, _, infos = env.step(dict(zip(env.agents, actions, strict=True)))
    arrived += infos["vehicle"]["is_success"]
print(f"{100 * arrived / CASES:.1f} % success on validation cases")
