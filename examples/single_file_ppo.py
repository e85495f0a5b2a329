"""PPO in one file, on Gymnasium's vector environment: python examples/single_file_ppo.py --minutes 1 --out policy.onnx

Then drive it as a planner: crowdbench run --planner policy.onnx
Needs `pip install 'crowdbench[onnx]'`, and no library of algorithms. The method is PPO (Schulman et al. 2017,
arXiv:1707.06347) with generalised advantage estimation. Ctrl-C exports the policy trained so far.
"""

import argparse
import shlex
import time
from pathlib import Path

import gymnasium
import numba
import torch
from gymnasium.wrappers.vector import NormalizeObservation
from torch import nn
from torch.distributions import Normal

import crowdbench

WORLDS, STEPS, EPOCHS, BATCHES = 128, 64, 6, 8
GAMMA, LAMBDA, CLIP, LEARNING_RATE = 0.97, 0.95, 0.2, 7e-4


def layers(features: int, out: int) -> nn.Sequential:
    """Return a network with two hidden layers."""
    hidden = [nn.Linear(features, 128), nn.Tanh(), nn.Linear(128, 128), nn.Tanh()]
    last = nn.Linear(128, out)
    nn.init.normal_(last.weight, std=0.01)
    return nn.Sequential(*hidden, last)


def collect(envs, observed, over, actor, critic, spread):
    """Drive all worlds for some steps.

    Args:
        envs: The worlds. The step after the last one of an episode only starts the next episode.
        observed: Their observations.
        over: True for worlds in which the episode is over.
        actor: The network of the mean action.
        critic: The network of the value.
        spread: The logarithm of the standard deviation of actions.

    Returns:
        The observations, actions, their log-probabilities, advantages and returns; then the new `observed` and `over`.
    """
    shown, actions, log_probabilities, values, rewards, ended, kept = [], [], [], [], [], [], []
    with torch.inference_mode():
        for _ in range(STEPS):
            chances = Normal(actor(observed), spread.exp())
            action = chances.sample()
            following, reward, terminated, truncated, _ = envs.step(action.double().numpy())
            shown.append(observed)
            actions.append(action)
            log_probabilities.append(chances.log_prob(action).sum(1))
            values.append(critic(observed)[:, 0])
            rewards.append(torch.as_tensor(reward).float())
            kept.append(~over)
            over = torch.as_tensor(terminated | truncated)
            ended.append(over.float())  # a time-out counts as an end, for brevity
            observed = torch.as_tensor(following).float()
        following, advantage, advantages = critic(observed)[:, 0], torch.zeros(WORLDS), []
        for reward, value, end in zip(reversed(rewards), reversed(values), reversed(ended), strict=True):
            error = reward + (1 - end) * GAMMA * following - value
            advantage, following = error + (1 - end) * GAMMA * LAMBDA * advantage, value
            advantages.insert(0, advantage)
    parts = (shown, actions, log_probabilities, advantages, values)
    shown, actions, log_probabilities, advantages, values = (torch.cat(part)[torch.cat(kept)] for part in parts)
    return (shown, actions, log_probabilities, advantages, advantages + values), observed, over


def update(optimizer, actor, critic, spread, experience) -> None:
    """Update the networks by some epochs on the collected experience."""
    for _ in range(EPOCHS):
        for rows in torch.randperm(len(experience[0])).chunk(BATCHES):
            shown, actions, before, advantages, returns = (part[rows] for part in experience)
            ratio = (Normal(actor(shown), spread.exp()).log_prob(actions).sum(1) - before).exp()
            gain = (advantages - advantages.mean()) / (advantages.std() + 1e-8)
            policy_loss = -torch.min(ratio * gain, ratio.clamp(1 - CLIP, 1 + CLIP) * gain).mean()
            loss = policy_loss + 0.5 * (critic(shown)[:, 0] - returns).square().mean()
            optimizer.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_([part for group in optimizer.param_groups for part in group["params"]], 0.5)
            optimizer.step()


def train(minutes: float, scenario: str, seed: int, out: Path) -> None:
    """Train a policy for some minutes, and export it as an ONNX file."""
    torch.set_num_threads(1)
    numba.set_num_threads(1)
    torch.manual_seed(seed)
    envs = NormalizeObservation(
        gymnasium.make_vec(
            "crowdbench/Vehicle-v0",
            num_envs=WORLDS,
            scenario=scenario,
            reward="progress",
            observation="goal_frame",
            action="goal_frame",
            nearest=5,
        )
    )
    features = envs.single_observation_space.shape[0]
    actor, critic, spread = layers(features, 2), layers(features, 1), nn.Parameter(torch.full((2,), -0.5))
    optimizer = torch.optim.Adam([*actor.parameters(), *critic.parameters(), spread], LEARNING_RATE, eps=1e-5)
    observed = torch.as_tensor(envs.reset(seed=seed)[0]).float()
    over, start, steps = torch.zeros(WORLDS, dtype=torch.bool), time.monotonic(), 0
    try:
        while (left := 1.0 - (time.monotonic() - start) / (60.0 * minutes)) > 0.0:
            optimizer.param_groups[0]["lr"] = left * LEARNING_RATE
            experience, observed, over = collect(envs, observed, over, actor, critic, spread)
            update(optimizer, actor, critic, spread, experience)
            steps += WORLDS * STEPS
            print(f"\r{steps} steps, return {experience[-1].mean():.3f}", end="", flush=True)
    except KeyboardInterrupt:
        print("\ninterrupted: exporting what has been learned", end="")
    crowdbench.export_policy(actor, out, envs)
    print(f"\nexported {out}: crowdbench run --planner {shlex.quote(str(out))}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--minutes", type=float, default=5.0)
    parser.add_argument("--scenario", default="circle_crossing_5")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("policy.onnx"))
    asked = parser.parse_args()
    train(asked.minutes, asked.scenario, asked.seed, asked.out)
