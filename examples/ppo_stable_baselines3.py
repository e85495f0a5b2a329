"""PPO of stable-baselines3, which simulates all worlds at once: python examples/ppo_stable_baselines3.py

Needs `pip install '.[ppo,onnx]'`. Drive the policy as a planner: crowdbench run --planner policy.onnx
"""

import argparse

import torch
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecNormalize

import crowdbench
from crowdbench.envs import CrowdVecEnv

PARAMETERS = {"n_steps": 64, "batch_size": 1024, "n_epochs": 6, "gamma": 0.97}
NETWORK = {"net_arch": [128, 128], "log_std_init": -0.5}
parser = argparse.ArgumentParser()
parser.add_argument("--steps", type=int, default=1_000_000)
parser.add_argument("--seed", type=int, default=0)
parser.add_argument("--out", default="policy.onnx")
args = parser.parse_args()
torch.set_num_threads(1)  # networks this small are faster in one thread

worlds = VecNormalize(CrowdVecEnv(128, seed=args.seed, observation="goal_frame", nearest=5), norm_reward=False)
model = PPO(
    "MlpPolicy",
    worlds,
    learning_rate=lambda left: 7e-4 * left,
    policy_kwargs=NETWORK,
    seed=args.seed,
    device="cpu",
    verbose=1,
    **PARAMETERS,
)
model.learn(args.steps)
crowdbench.export_policy(model, args.out, worlds)
success = crowdbench.run(args.out, cases="val:200").metrics["success_rate"].mean
print(f"{args.out}: {100 * success:.1f} % success on validation cases")
