"""PPO of TorchRL on Gymnasium's vector environment: python examples/ppo_torchrl.py

Needs `pip install torchrl '.[onnx]'`. Drive the policy as a planner: crowdbench run --planner policy.onnx
"""

import argparse

import gymnasium
import torch
from tensordict.nn import AddStateIndependentNormalScale, TensorDictModule
from torch.distributions import Independent, Normal
from torchrl.collectors import Collector
from torchrl.envs import GymWrapper
from torchrl.modules import MLP, ProbabilisticActor, ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

import crowdbench

FRAMES, EPOCHS, BATCH, RATE = 8192, 6, 1024, 7e-4
parser = argparse.ArgumentParser()
parser.add_argument("--updates", type=int, default=60)
parser.add_argument("--seed", type=int, default=0)
parser.add_argument("--out", default="policy.onnx")
args = parser.parse_args()
torch.manual_seed(args.seed)
torch.set_num_threads(1)

view = {"reward": "progress", "observation": "goal_frame", "action": "normalized_goal_frame", "nearest": 5}
envs = gymnasium.make_vec("crowdbench/Vehicle-v0", 128, autoreset_mode="SameStep", **view)
worlds = GymWrapper(envs)
worlds.set_seed(args.seed)
sizes = {"in_features": envs.single_observation_space.shape[0], "num_cells": [128, 128]}
mean = MLP(**sizes, out_features=2, activation_class=torch.nn.Tanh)
network = torch.nn.Sequential(mean, AddStateIndependentNormalScale(2))
actor = ProbabilisticActor(
    TensorDictModule(network, in_keys=["observation"], out_keys=["loc", "scale"]),
    in_keys=["loc", "scale"],
    distribution_class=lambda loc, scale: Independent(Normal(loc, scale), 1),
    return_log_prob=True,
)
critic = ValueOperator(MLP(**sizes, out_features=1, activation_class=torch.nn.Tanh))
advantage = GAE(gamma=0.97, lmbda=0.95, value_network=critic, average_gae=True)
loss = ClipPPOLoss(actor, critic, entropy_bonus=False)
optimizer = torch.optim.Adam(loss.parameters(), RATE)
for data in Collector(worlds, actor, frames_per_batch=FRAMES, total_frames=args.updates * FRAMES):
    steps = advantage(data).reshape(-1)
    print(f"mean reward {steps['next', 'reward'].mean():.3f}", flush=True)
    for rows in torch.cat([torch.randperm(FRAMES) for _ in range(EPOCHS)]).split(BATCH):
        losses = loss(steps[rows])
        optimizer.zero_grad()
        (losses["loss_objective"] + losses["loss_critic"]).backward()
        optimizer.step()
crowdbench.export_policy(mean, args.out, envs)
success = crowdbench.run(args.out, cases="val:200").metrics["success_rate"].mean
print(f"{args.out}: {100 * success:.1f} % success on validation cases")
