"""PPO of Tianshou: python examples/ppo_tianshou.py

Needs an environment of its own, because Tianshou pins pandas: `pip install tianshou .`.
"""

import argparse

import gymnasium
import torch
from tianshou.algorithm import PPO
from tianshou.algorithm.modelfree.reinforce import ProbabilisticActorPolicy
from tianshou.algorithm.optim import AdamOptimizerFactory
from tianshou.data import Collector, VectorReplayBuffer
from tianshou.env import DummyVectorEnv
from tianshou.trainer import OnPolicyTrainerParams
from tianshou.utils.net.common import Net
from tianshou.utils.net.continuous import ContinuousActorProbabilistic, ContinuousCritic
from torch.distributions import Independent, Normal

import crowdbench

WORLDS, STEPS, VIEW = 64, 4096, {"observation": "goal_frame", "action": "normalized_goal_frame", "nearest": 5}
parser = argparse.ArgumentParser()
parser.add_argument("--epochs", type=int, default=8)
parser.add_argument("--seed", type=int, default=0)
parser.add_argument("--out", default="policy.pth")
args = parser.parse_args()
torch.manual_seed(args.seed)
torch.set_num_threads(1)


def make():
    """Return an environment."""
    return gymnasium.make("crowdbench/Vehicle-v0", reward="progress", **VIEW)


envs = DummyVectorEnv([make] * WORLDS)
envs.seed(args.seed)
space = make().observation_space
nets = [Net(state_shape=space.shape, hidden_sizes=[128, 128], activation=torch.nn.Tanh) for _ in range(2)]
actor = ContinuousActorProbabilistic(preprocess_net=nets[0], action_shape=(2,), unbounded=True)
policy = ProbabilisticActorPolicy(
    actor=actor,
    dist_fn=lambda parameters: Independent(Normal(*parameters), 1),
    deterministic_eval=True,
    action_space=make().action_space,
)
critic = ContinuousCritic(preprocess_net=nets[1])
algorithm = PPO(policy=policy, critic=critic, optim=AdamOptimizerFactory(lr=7e-4), gamma=0.97, ent_coef=0.0)
collector = Collector(algorithm, envs, VectorReplayBuffer(STEPS, WORLDS))
batches = {"batch_size": 512, "update_step_num_repetitions": 6, "collection_step_num_env_steps": STEPS}
training = {"max_epochs": args.epochs, "epoch_num_steps": 10 * STEPS, "training_collector": collector}
algorithm.run_training(OnPolicyTrainerParams(**training, **batches, test_collector=None))
torch.save(policy.state_dict(), args.out)
planner = crowdbench.PolicyPlanner(lambda observed: actor(observed)[0][0].detach().numpy(), **VIEW)
success = crowdbench.run(planner, cases="val:200").metrics["success_rate"].mean
print(f"{args.out}: {100 * success:.1f} % success on validation cases")
