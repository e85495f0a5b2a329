"""Trains a policy with stable-baselines3's proximal policy optimization (PPO, Schulman et al. 2017).

The policy sees the vehicle and the nearest pedestrians in the frame of the goal, and gives a velocity in that frame. It
learns from a reward in many worlds at once. Each update collects `STEPS` steps of every world, then goes
through them `EPOCHS` times in batches.
"""

from __future__ import annotations

import contextlib
import math
import random
import re
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import Tensor, nn

from crowdbench.envs.stable_baselines import CASES, CrowdVecEnv
from crowdbench.metrics.motion import jerk
from crowdbench.metrics.outcomes import navigation_time_or_limit, success_rate
from crowdbench.planners.policy import Policy, PolicyPlanner, SetEncoder
from crowdbench.train.checkpoint import State, optimizer_state, part_of, restore_optimizer, tensors_of
from crowdbench.train.driving import DrivingTraining

WORLDS = 128
"""Worlds that are driven at once."""

STEPS = 64
"""Steps of each world between two updates."""

BATCH = 1024
"""Steps per step of the optimizer."""

EPOCHS = 6
"""How often each update goes through its steps."""

GAMMA = 0.97
"""Discount per step."""

LAMBDA = 0.95
"""Of the generalized advantage estimate (Schulman et al. 2016)."""

LEARNING_RATE = 7e-4
"""At the start; it falls linearly to 0."""

LOG_STD = -0.5
"""Logarithm of the standard deviation of actions at the start, in m/s."""

VALIDATIONS = 20
"""Validations of a training, after which it can be resumed."""

ALIAS = re.compile("(pi_|vf_)(?=features_extractor)")
"""Stable-baselines3 names the encoder that action and value share three times; one of them is kept."""


@dataclass(frozen=True)
class CurvePoint:
    """One validation: a point of the training curve. Its means are over the cases of all validation scenarios.

    Attributes:
        steps: The steps driven so far, of all worlds together.
        seconds: The training time so far in seconds, without validations.
        reward: The mean return of the training episodes that ended since the last point; 0 if none did.
        success: The success rate on validation cases, from 0 to 1.
        navigation_time_or_limit: The mean time to the goal in seconds, the time limit for failures.
        jerk: The mean jerk in m/s^3.
    """

    steps: int
    seconds: float
    reward: float
    success: float
    navigation_time_or_limit: float
    jerk: float

    def __str__(self) -> str:
        return (
            f"{self.steps:8d} steps, {self.seconds:4.0f} s: on validation cases {100 * self.success:.1f} % success in "
            f"{self.navigation_time_or_limit:.2f} s (a failure counts as the time limit), jerk {self.jerk:.1f}"
        )


class CrowdExtractor(BaseFeaturesExtractor):  # type: ignore[misc]  # stable_baselines3 is not looked into
    """The set encoder as a features extractor of stable-baselines3, for observations that are a `dict`.

    Args:
        observation_space: The space of the observations.
    """

    def __init__(self, observation_space: Any) -> None:
        encoder = SetEncoder()
        super().__init__(observation_space, encoder.encoded)
        self.encoder = encoder

    def forward(self, observations: dict[str, Tensor]) -> Tensor:
        """Encode what worlds show."""
        mask = observations["mask"] > 0.5
        return self.encoder(observations["vehicle"], observations["pedestrians"], mask)


class _Returns(BaseCallback):  # type: ignore[misc]
    """Keeps the returns of the episodes that ended."""

    def __init__(self) -> None:
        super().__init__()
        self.returns: list[float] = []

    def _on_step(self) -> bool:
        self.returns += [info["episode"]["r"] for info in self.locals["infos"] if "episode" in info]
        return True


@contextlib.contextmanager
def _own_randomness() -> Iterator[None]:
    """Leave the generators of others as they were: stable-baselines3 seeds and uses those that all share."""
    python, numpy = random.getstate(), np.random.get_state()  # noqa: NPY002
    try:
        with torch.random.fork_rng(devices=[]):
            yield
    finally:
        random.setstate(python)
        np.random.set_state(numpy)  # noqa: NPY002


def _untrained() -> Policy:
    with torch.random.fork_rng(devices=[]):
        return Policy()


class Training(DrivingTraining[Policy, CurvePoint]):
    """A training of a policy and all its state. `run` may be called on a new or on a restored one.

    Args:
        request: The `PPORequest` that asks for it.
        device: `cpu` or `cuda`.
    """

    def __init__(self, request: Any, device: str) -> None:
        super().__init__(request)
        self.nearest = request.nearest or max(self.scenario.max_agents - 1, 1)
        self.steps = 0
        self.worlds = CrowdVecEnv(
            WORLDS, self.scenario, request.seed, reward=request.reward, nearest=self.nearest, cases=CASES
        )
        with _own_randomness():
            self.ppo = PPO(
                "MultiInputPolicy",
                self.worlds,
                learning_rate=lambda left: LEARNING_RATE * left,
                n_steps=STEPS,
                batch_size=BATCH,
                n_epochs=EPOCHS,
                gamma=GAMMA,
                gae_lambda=LAMBDA,
                seed=request.seed,
                device=device,
                policy_kwargs={
                    "features_extractor_class": CrowdExtractor,
                    "net_arch": {"pi": [64], "vf": [64]},
                    "activation_fn": nn.Tanh,
                    "log_std_init": LOG_STD,
                },
            )
        self.returns = _Returns()

    @property
    def progress(self) -> float:
        """The part of the training that is done, from 0 to 1."""
        return self.request.progress(self.steps, self.seconds)

    @property
    def current(self) -> Policy:
        """See `DrivingTraining`: a copy of what a planner needs."""
        actor, found = self.ppo.policy, _untrained()
        found.encoder.load_state_dict(actor.features_extractor.encoder.state_dict())
        found.hidden.load_state_dict(actor.mlp_extractor.policy_net.state_dict())
        found.action.load_state_dict(actor.action_net.state_dict())
        return found.cpu()

    def planner(self, network: Policy) -> PolicyPlanner:
        """See `DrivingTraining`."""
        return PolicyPlanner(network, self.nearest)

    def run(self, after_validation: Callable[[], None]) -> None:
        """Train to the end, and call `after_validation` whenever the curve has a new point."""
        with _own_randomness():
            if not self.curve:
                self._validate()
                after_validation()
            while self.progress < 1.0:
                self._segment()
                self._validate()
                after_validation()

    def _segment(self) -> None:
        """Train until the next validation. All that is random in it follows from the seed and the curve so far."""
        goal = (math.floor(self.progress * VALIDATIONS) + 1) / VALIDATIONS
        self.ppo.set_random_seed(self.request.seed + 1000 * len(self.curve))  # new training cases, too
        self.ppo._last_obs = None  # so that all worlds start anew, as after a resume
        start = time.perf_counter()  # training cases are drawn
        _, callback = self.ppo._setup_learn(self.ppo.num_timesteps, self.returns, reset_num_timesteps=False)
        self.seconds += time.perf_counter() - start
        self._update(callback)  # in any case: where cases take long to draw, they alone may have taken until the goal
        while self.progress < min(goal, 1.0):
            self._update(callback)

    def _update(self, callback: BaseCallback) -> None:
        start = time.perf_counter()
        ppo = self.ppo
        ppo.collect_rollouts(self.worlds, callback, ppo.rollout_buffer, n_rollout_steps=STEPS)
        ppo._current_progress_remaining = 1.0 - self.progress
        ppo.train()
        self.steps += STEPS * WORLDS
        self.seconds += time.perf_counter() - start

    def _validate(self) -> None:
        """Add a point to the curve, and keep its policy."""
        mean = self.drive_validation()
        self.curve.append(
            CurvePoint(
                steps=self.steps,
                seconds=self.seconds,
                reward=float(np.mean(self.returns.returns)) if self.returns.returns else 0.0,
                success=mean(success_rate),
                navigation_time_or_limit=mean(navigation_time_or_limit),
                jerk=mean(jerk),
            )
        )
        self.returns.returns.clear()

    def state(self) -> State:
        """The state of the training, for a checkpoint. Worlds are not in it: each segment begins with new episodes."""
        own = {name: tensor for name, tensor in tensors_of("policy", self.ppo.policy).items() if not ALIAS.search(name)}
        tensors = own | optimizer_state("optimizer", self.ppo.policy.optimizer) | self.validated_tensors()
        return State(tensors, {"steps": self.steps, "seconds": self.seconds}, self.curve)

    def restore(self, state: State) -> None:
        """Continue from a checkpoint. Raises RuntimeError where it is of another network."""
        own = part_of("policy", state.tensors)
        whole = {name: own[ALIAS.sub("", name)] for name in self.ppo.policy.state_dict()}
        self.ppo.policy.load_state_dict(whole)
        restore_optimizer(self.ppo.policy.optimizer, part_of("optimizer", state.tensors))
        self.restore_curve(state, CurvePoint)
        self.steps = state.facts["steps"]
