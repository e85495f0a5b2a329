"""PPO of RLlib, which simulates all worlds at once: python examples/ppo_rllib.py

Needs an environment of its own, because RLlib pins Gymnasium: `pip install 'ray[rllib]' .`.
"""

import argparse

import torch
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.core.rl_module.default_model_config import DefaultModelConfig

import crowdbench

VIEW = {"observation": "goal_frame", "action": "normalized_goal_frame", "nearest": 5}
parser = argparse.ArgumentParser()
parser.add_argument("--updates", type=int, default=60)
parser.add_argument("--seed", type=int, default=0)
parser.add_argument("--out", help="folder of the checkpoint")
args = parser.parse_args()
torch.set_num_threads(1)

config = PPOConfig()
config.environment("crowdbench/Vehicle-v0", env_config={"reward": "progress", **VIEW})
config.env_runners(num_env_runners=0, num_envs_per_env_runner=128, gym_env_vectorize_mode="vector_entry_point")
config.training(train_batch_size_per_learner=8192, minibatch_size=1024, num_epochs=6, gamma=0.97, lr=7e-4)
config.rl_module(model_config=DefaultModelConfig(fcnet_hiddens=[128, 128], fcnet_activation="tanh"))
config.debugging(seed=args.seed)
algorithm = config.build_algo()
for update in range(args.updates):
    result = algorithm.train()
    print(f"update {update + 1}: mean return {result['env_runners']['episode_return_mean']:.2f}", flush=True)
if args.out:
    algorithm.save_to_path(args.out)
module = algorithm.get_module()


def act(observed):
    """Return the mean actions of the policy in many worlds."""
    with torch.inference_mode():
        mean, _ = module.forward_inference({"obs": torch.as_tensor(observed)})["action_dist_inputs"].chunk(2, dim=1)
    return mean.numpy()


success = crowdbench.run(crowdbench.PolicyPlanner(act, **VIEW), cases="val:200").metrics["success_rate"].mean
print(f"{100 * success:.1f} % success on validation cases")
