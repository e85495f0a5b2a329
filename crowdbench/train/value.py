"""Trains a value network: on the returns of ORCA's demonstrations, then on its own episodes.

Deep V-learning (Chen et al. 2019, algorithm 1), for any of the value networks. It differs from CrowdNav to train within
minutes:

- All episodes of a round run in lock-step, and the network learns after each round.
- Targets are n-step returns (Sutton and Barto 2018, equation 7.1) instead of one-step returns.
- The target network is an exponential moving average of the network (Lillicrap et al. 2016, "soft" target updates)
  instead of a copy at intervals. It is also the network that is validated and saved.
- A time-out only truncates an episode: the target uses the value of its last state instead of the rewards after it
  (Pardo et al. 2018). CrowdNav discards such episodes; here only demonstrations that time out are discarded.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from scipy.special import ndtr
from torch import Tensor

from crowdbench.core.types import Observation, Trace
from crowdbench.networks.value import NETWORKS, ValueNetwork
from crowdbench.planners.driver import Driver
from crowdbench.planners.kce import Limits
from crowdbench.planners.lookahead import ValuePlanner
from crowdbench.planners.planner import Planner
from crowdbench.planners.reactive import ORCAPlanner
from crowdbench.predict.linear import ConstantVelocity
from crowdbench.predict.predictors import load_predictor
from crowdbench.runs.rollout import rollout
from crowdbench.scenario.cases import Cases
from crowdbench.train.config import UNLIMITED, ValueConfig
from crowdbench.train.driving import DrivingTraining
from crowdbench.train.replay_memory import ReplayBuffer, Transitions, transitions

DEMONSTRATIONS = 2000
"""Number of demonstration episodes, driven by ORCA."""

SAFETY_SPACE = 0.15
"""Metres by which ORCA enlarges every radius in demonstrations."""

IMITATION_EPOCHS = 5
"""Epochs of supervised learning on the demonstrations."""

IMITATION_RATE = 1e-3
"""Learning rate of imitation."""

LEARNING_RATE = 5e-4
"""Learning rate on the network's own episodes; it decays linearly to 0 over the second half of the training."""

ROUND = 100
"""Episodes that are run with the network in each round, before it is updated on them."""

REPLAY_RATIO = 10
"""Transitions that are sampled from the replay buffer for each step that is simulated."""

BATCH = 512
"""Transitions in a minibatch."""

N_STEPS = 6
"""The n of the n-step temporal-difference target."""

CAPACITY = 150_000
"""Transitions in the replay buffer."""

EXPLORATION = (0.15, 0.02, 0.4)
"""Epsilon at the start and at the end, and the part of the training over which it falls linearly."""

AVERAGING = 0.01
"""Weight of the network in its moving average, at every update."""

VALIDATIONS = 8
"""Number of validations while the network learns from its own episodes; one more follows the imitation."""

CASES_PER_SEED = 1_000_000
"""Number of training cases that belong to each seed."""


class ValueTraining(DrivingTraining):
    """A training of a value network. Its current network is a moving average, which is also the target network.

    A point of its curve has `exploration`, the present epsilon; `loss`, the mean loss of the latest round, or of
    imitation at the first point; and the discounted return.

    Args:
        config: The options.
        device: `cpu` or `cuda`.
    """

    config: ValueConfig
    saved = ("network", "current", "optimizer", "replay", "validated")
    curve_metric = "discounted_return"

    def __init__(self, config: ValueConfig, device: str) -> None:
        self.predictor = load_predictor(config.predictor)
        super().__init__(config, device)
        self.limits = Limits(**UNLIMITED | config.limits) if config.limits else None
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(config.seed)
            self.network = NETWORKS[config.network]().to(device)
        self.current = copy.deepcopy(self.network)
        self.optimizer = torch.optim.Adam(self.network.parameters(), lr=LEARNING_RATE)
        self.replay = ReplayBuffer(CAPACITY)

    def learn(self) -> Iterator[None]:
        """See `Training`: imitation, then rounds of episodes."""
        if not self.curve:
            with self.timed():
                loss = self.imitate()
            self.validate(exploration=self.exploration, loss=loss)
            yield
        while self.progress < 1.0:
            with self.timed():
                loss = self.improve()
            if len(self.curve) <= int(self.progress * VALIDATIONS):
                self.validate(exploration=self.exploration, loss=loss)
                yield

    def imitate(self) -> float:
        """Learn the returns of demonstrated episodes by regression. Return the mean loss of the last epoch."""
        driver = Driver(ORCAPlanner(SAFETY_SPACE), "orca")
        trace = rollout(driver, self.scenario, self._cases(0, DEMONSTRATIONS), undisturbed=False)
        steps = transitions(trace, N_STEPS, truncated=False)
        optimizer = torch.optim.Adam(self.network.parameters(), lr=IMITATION_RATE)
        generator = np.random.default_rng([self.config.seed, 0])
        for _ in range(IMITATION_EPOCHS):
            order = generator.permutation(len(steps))
            losses = []
            for start in range(0, len(steps), BATCH):
                batch = steps.take(order[start : start + BATCH])
                losses.append(self._update(optimizer, batch, self._tensor(batch.episode_return)))
        self.current.load_state_dict(self.network.state_dict())
        return float(np.mean(losses))

    def improve(self) -> float:
        """Run a round of episodes, then learn from the replay buffer. Return the mean loss."""
        self.optimizer.param_groups[0]["lr"] = LEARNING_RATE * min(1.0, 2.0 * (1.0 - self.progress))
        steps = transitions(self._drive(), N_STEPS)
        self.replay.add(steps)
        generator = np.random.default_rng([self.config.seed, 1, self.amount // ROUND])
        losses = []
        for _ in range(REPLAY_RATIO * len(steps) // BATCH):
            batch = self.replay.sample(generator, BATCH)
            losses.append(self._update(self.optimizer, batch, self._target(batch)))
            with torch.no_grad():
                torch._foreach_lerp_(list(self.current.parameters()), list(self.network.parameters()), AVERAGING)
        self.amount += ROUND
        return float(np.mean(losses))

    def _drive(self) -> Trace:
        """Drive a round of training episodes with epsilon-greedy exploration."""
        planner = ValuePlanner(self.predictor, self.network, limits=self.limits)
        driver = Driver(EpsilonGreedy(planner, self.exploration, self.config.seed), self.config.network)
        cases = self._cases(DEMONSTRATIONS + self.amount, ROUND)
        return rollout(driver, self.scenario, cases, undisturbed=False)

    @property
    def exploration(self) -> float:
        """The present epsilon: the probability of a random command."""
        first, last, part = EXPLORATION
        return first + (last - first) * min(1.0, self.progress / part)

    def _cases(self, start: int, n: int) -> Cases:
        """Return `n` training cases of this seed."""
        start += self.config.seed * CASES_PER_SEED
        return Cases("train", start, start + n)

    @torch.no_grad()
    def _target(self, batch: Transitions) -> Float[Tensor, "step"]:
        """Return the n-step returns: the rewards of n steps and the target network's discounted value after them."""
        value = self.current(self._tensor(batch.next_joint), self._tensor(batch.next_present))
        return self._tensor(batch.reward) + self._tensor(batch.bootstrap) * value

    def _update(self, optimizer: torch.optim.Optimizer, batch: Transitions, target: Float[Tensor, "step"]) -> float:
        """Make one step of the optimizer on the mean squared error to the target. Return the loss."""
        self.network.train()  # a planner has set evaluation mode, in which cuDNN's LSTM has no gradients
        values = self.network(self._tensor(batch.joint), self._tensor(batch.present))
        loss = torch.nn.functional.mse_loss(values, target)
        optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimizer.step()
        return loss.item()

    def _tensor(self, array: np.ndarray) -> Tensor:
        return torch.from_numpy(array).to(self.device)

    def planner(self, network: ValueNetwork) -> ValuePlanner:
        """See `DrivingTraining`."""
        # Always with constant velocity, which is not privileged; the predictor in training may be the oracle.
        return ValuePlanner(ConstantVelocity(), network, limits=self.limits)

    def conditions(self) -> dict[str, Any]:
        """See `DrivingTraining`."""
        return {"predictor": self.config.predictor, "limits": self.config.limits}


class EpsilonGreedy(Planner):
    """Epsilon-greedy planner: with probability epsilon a random command within another planner's limits, else its best.

    The random choice depends only on seed, case and step.

    Args:
        planner: The planner that computes the best command.
        epsilon: The probability of a random command, from 0 to 1.
        seed: The seed of the random choices.
    """

    def __init__(self, planner: ValuePlanner, epsilon: float, seed: int) -> None:
        self.privileged = planner.privileged
        self.native = planner.native
        self.planner = planner
        self.epsilon = epsilon
        self.purpose = f"exploration {seed}"

    def plan(self, obs: Observation) -> Float[np.ndarray, "world 2"]:
        """See `Planner`."""
        commands = self.planner.commands(obs.vehicle, obs.dt)
        allowed = self.planner.are_allowed(obs.vehicle, commands, obs.dt)
        # Uniform numbers from the normal distribution function, because the streams of a case have only normal numbers.
        chance, choice = ndtr(obs.noise(self.purpose, (2,))).T
        index = (choice * allowed.sum(axis=1)).astype(int)
        command = commands[np.arange(len(obs)), (allowed.cumsum(axis=1) > index[:, None]).argmax(axis=1)]
        greedy = chance >= self.epsilon
        if greedy.any():
            command[greedy] = self.planner.plan(obs.take(greedy))
        return command
