"""PPO (Schulman et al. 2017) in one file, on Gymnasium's vector environment: python examples/ppo_single_file.py

Needs `pip install '.[onnx]'`. Drive the policy as a planner: crowdbench run --planner policy.onnx
A time-out counts as the end of an episode, for brevity.
"""

import argparse

import gymnasium
import torch
from rich.progress import track
from torch.distributions import Normal
from torch.nn import Linear, Parameter, Sequential, Tanh

import crowdbench

WORLDS, STEPS, EPOCHS, BATCH, GAMMA, LAMBDA, CLIP, RATE = 128, 64, 6, 1024, 0.97, 0.95, 0.2, 7e-4
parser = argparse.ArgumentParser()
parser.add_argument("--updates", type=int, default=150)
parser.add_argument("--seed", type=int, default=0)
parser.add_argument("--out", default="policy.onnx")
args = parser.parse_args()
torch.manual_seed(args.seed)
torch.set_num_threads(1)  # networks this small are faster in one thread
view = {"reward": "progress", "observation": "goal_frame", "action": "normalized_goal_frame", "nearest": 5}
envs = gymnasium.make_vec("crowdbench/Vehicle-v0", WORLDS, autoreset_mode="SameStep", **view)
observed = torch.as_tensor(envs.reset(seed=args.seed)[0])
sizes = observed.shape[1], 128
actor, critic = (Sequential(Linear(*sizes), Tanh(), Linear(128, 128), Tanh(), Linear(128, n)) for n in (2, 1))
log_std = Parameter(torch.full((2,), -0.5))
optimizer = torch.optim.Adam([*actor.parameters(), *critic.parameters(), log_std])
for update in track(range(args.updates)):
    steps, advantages, advantage = [], [], 0.0
    with torch.no_grad():
        for _ in range(STEPS):
            policy = Normal(actor(observed), log_std.exp())
            action = policy.sample()
            following, reward, terminated, truncated = map(torch.as_tensor, envs.step(action.numpy())[:4])
            log_probability, value = policy.log_prob(action).sum(1), critic(observed)[:, 0]
            steps.append((observed, action, log_probability, value, reward, ~(terminated | truncated)))
            observed = following
        next_value = critic(observed)[:, 0]
        for *_, value, reward, continues in reversed(steps):  # generalized advantage estimation
            advantage = reward + GAMMA * continues * (next_value + LAMBDA * advantage) - value
            next_value = value
            advantages.insert(0, advantage.float())
    seen, actions, before, values, *_ = (torch.cat(column) for column in zip(*steps, strict=True))
    gains = torch.cat(advantages)
    returns, gains = values + gains, (gains - gains.mean()) / gains.std()
    optimizer.param_groups[0]["lr"] = RATE * (1 - update / args.updates)
    for rows in torch.cat([torch.randperm(len(seen)) for _ in range(EPOCHS)]).split(BATCH):
        ratio = (Normal(actor(seen[rows]), log_std.exp()).log_prob(actions[rows]).sum(1) - before[rows]).exp()
        gain = torch.min(ratio * gains[rows], ratio.clamp(1 - CLIP, 1 + CLIP) * gains[rows])
        loss = 0.5 * (critic(seen[rows])[:, 0] - returns[rows]).square() - gain
        optimizer.zero_grad()
        loss.mean().backward()
        optimizer.step()
crowdbench.export_policy(actor, args.out, envs)
success = crowdbench.run(args.out, cases="val:200").metrics["success_rate"].mean
print(f"{args.out}: {100 * success:.1f} % success on validation cases")
