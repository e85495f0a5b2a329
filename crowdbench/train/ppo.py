"""Trains a policy by proximal policy optimization (PPO, Schulman et al. 2017).

In worlds with several vehicles, all of them share the network, and each learns from its own observations and rewards
(IPPO, de Witt et al. 2020). With `critic=state`, the value also depends on the state of the world (MAPPO, Yu et al.
2022).

A policy observes the vehicle and the nearest pedestrians in the frame of the goal, and returns a velocity in this
frame; a recurrent policy observes more (`planners.trained_policy.PolicyInterface`). It learns from a reward in many
worlds at once. Each update simulates some steps of every world, then passes over them several times in minibatches of
whole segments. The value loss is not clipped, and there is no entropy bonus.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from crowdbench.core.types import Outcome, World
from crowdbench.envs.rewards import load_reward
from crowdbench.envs.training_worlds import CASES
from crowdbench.networks.chunks import in_chunks, one_torch_thread
from crowdbench.networks.encoders import make_policy
from crowdbench.networks.policy import SCALE, ActorCritic, Policy, Seen
from crowdbench.planners.planner import Planner
from crowdbench.planners.trained_policy import NetworkPlanner
from crowdbench.plugins.kind import file_and_function
from crowdbench.plugins.options import Option
from crowdbench.plugins.plugin_files import read_files
from crowdbench.runs.trial import try_reward
from crowdbench.scenario.scenario import Scenario
from crowdbench.train.config import PPOConfig
from crowdbench.train.driving import DrivingTraining, describe_scenario
from crowdbench.train.experience import Experience
from crowdbench.train.policy_worlds import PolicyWorlds, make_interface
from crowdbench.utils.errors import InputError, is_number, require, require_count, require_positive
from crowdbench.utils.resources import keep_freed_memory
from crowdbench.views.global_state import global_state, state_bounds

Numbers = Float[Tensor, "step world"]
Flags = Bool[Tensor, "step world"]

CHUNK = 64
"""Worlds of a minibatch that a thread differentiates at once: few enough for the cache of a core."""

FEWEST_CASES = 256
"""Smallest number of training cases of a scenario between two validations, if several scenarios share `CASES`."""

CRITICS = ("own", "state")
"""Values of the parameter `critic`."""

VALIDATIONS = 20
"""Number of validations of a training, which can be resumed after each of them."""

keep_freed_memory()


@dataclass(frozen=True)
class Parameters:
    """The parameters of PPO, which `crowdbench train ppo --ppo name=value` sets.

    Attributes:
        worlds: Worlds that are driven at once [1].
        steps: Steps of each world between two updates [1].
        segments: Worlds in a minibatch, each with all its steps in order of time, as recurrent policies need them [1].
        epochs: Passes of each update over its steps [1].
        learning_rate: Learning rate of Adam at the start; it decreases linearly to 0 [1].
        gamma: Discount per step [1].
        gae_lambda: Lambda of the generalized advantage estimate (Schulman et al. 2016) [1].
        clip: Clipping range of the probability ratio, its largest difference from 1 (equation 7) [1].
        value_weight: Weight of the value's squared error in the loss [1].
        max_norm: The largest norm of a gradient: larger ones are scaled down [1].
        critic: `own` if the value depends on the vehicle's observations, `state` if also on the state of the world
            (`crowdbench.views.global_state`).

    Raises:
        InputError: A parameter is impossible, or there are fewer worlds than in a minibatch.
    """

    worlds: int = 256
    steps: int = 32
    segments: int = 32
    epochs: int = 4
    learning_rate: float = 7e-4
    gamma: float = 0.97
    gae_lambda: float = 0.95
    clip: float = 0.2
    value_weight: float = 0.5
    max_norm: float = 0.5
    critic: str = "own"

    def __post_init__(self) -> None:
        for name in ("worlds", "steps", "segments", "epochs"):
            require_count(name, getattr(self, name))
        small_enough = self.segments <= self.worlds
        require("segments", self.segments, small_enough, f"{self.worlds}, the number of worlds, at most")
        for name in ("learning_rate", "clip", "value_weight", "max_norm"):
            require_positive(name, getattr(self, name))
        for name in ("gamma", "gae_lambda"):
            value = getattr(self, name)
            require(name, value, is_number(value) and 0.0 <= value <= 1.0, "a number from 0 to 1")
        require("critic", self.critic, self.critic in CRITICS, " or ".join(CRITICS))


class PPOTraining(DrivingTraining):
    """A training of a policy.

    A point of its curve has `reward`, the mean return of the training episodes that ended since the last point, 0 if
    none did; and the jerk.

    Args:
        config: The options.
        device: `cpu` or `cuda`.
    """

    config: PPOConfig
    saved = ("network", "optimizer", "validated")
    curve_metric = "jerk"
    several = True
    metrics = (*DrivingTraining.metrics, "jerk", "max_velocity_change")
    current: Policy

    def __init__(self, config: PPOConfig, device: str) -> None:
        super().__init__(config, device)
        self.parameters: Parameters = Option("--ppo", Parameters(), (Parameters,)).argument(dict(config.ppo))
        scenarios = [self.scenario, *self.also_train_in]
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(config.seed)
            sizes = [len(state_bounds(scenario)[0]) for scenario in scenarios]
            self.state_numbers = max(sizes) if self.parameters.critic == "state" else 0
            self.network = ActorCritic(make_policy(config.network, config.encoder), self.state_numbers).to(device)
        self.current = self.network.policy
        make = functools.partial(make_interface, config.network, scenarios)
        self.interface = make()
        shares = _share_worlds(self.parameters.worlds, scenarios)
        cases, reward = max(CASES // len(scenarios), FEWEST_CASES), load_reward(config.reward)
        try_reward(reward, self.scenario)
        self.worlds = [PolicyWorlds(scenario, rows, cases, reward, make()) for scenario, rows in shares]
        self.optimizer = torch.optim.Adam(self.network.parameters(), lr=self.parameters.learning_rate, eps=1e-5)
        self.generator = torch.Generator()
        self.returns: list[float] = []

    def learn(self) -> Iterator[None]:
        """See `Training`: a validation before the first update, and after every part of the training."""
        while not self.curve or self.progress < 1.0:
            if self.curve:
                self.train_until((math.floor(self.progress * VALIDATIONS) + 1) / VALIDATIONS)
            self.validate(reward=float(np.mean(self.returns)) if self.returns else 0.0)
            self.returns.clear()
            yield

    def train_until(self, progress: float) -> None:
        """Train up to a given progress, with episodes from newly drawn training cases.

        All random numbers follow from the seed and the number of validations so far.
        """
        seed = self.config.seed + 1000 * len(self.curve)
        with self.timed():
            self.generator.manual_seed(seed)
            for worlds in self.worlds:
                worlds.restart(seed)
            self._observe()
            self.memory = self.network.policy.initial_memory(self.parameters.worlds)
            self.begins = torch.ones(1, self.parameters.worlds, dtype=torch.bool, device=self.device)
        while True:  # at least once: drawing the cases may have taken until then
            with self.timed():
                self.update()
            if self.progress >= min(progress, 1.0):
                return

    def update(self) -> None:
        """Simulate steps in all worlds, and update the policy with them."""
        with one_torch_thread():  # whose sums are the same with any number of threads
            experience = self._collect()
            for _ in range(self.parameters.epochs):
                order = torch.randperm(self.parameters.worlds, generator=self.generator)
                for minibatch in torch.split(order, self.parameters.segments):
                    self._optimize(experience, minibatch)
        self.amount += self.parameters.steps * self.parameters.worlds

    @torch.no_grad()
    def _collect(self) -> Experience:
        """Simulate some steps of every world, and return them."""
        steps, memory = [], self.memory
        for _ in range(self.parameters.steps):
            mean, value, self.memory = self.network(self.seen, self.state, self.memory, self.begins)
            noise = torch.randn(mean.shape, generator=self.generator).to(self.device)
            action = mean + self.network.log_std.exp() * noise
            if not action.isfinite().all():
                raise InputError(
                    f"the training has failed after {self.amount} steps: the policy's actions are not finite, as where "
                    f"the reward {self.config.reward} is too large"
                )
            before = (*self.seen, self.state, self.begins[0], action, self.network.log_probability(action, mean), value)
            reward, ended, acts = self._step(action)
            steps.append((*before, reward, ~ended, acts))
            self.begins = ended[None]
        columns = (torch.stack(column) for column in zip(*steps, strict=True))
        *seen, state, begins, action, log_probability, value, reward, continues, acts = columns
        last = self.network(self.seen, self.state, self.memory, self.begins)[1]
        values = torch.cat([value, last[None]])
        advantage = advantages(reward, values, continues, self.parameters.gamma, self.parameters.gae_lambda)
        taught = advantage if acts.all() else advantage[acts]
        normalized = (advantage - taught.mean()) / (taught.std() + 1e-8)
        numbers = action, log_probability, normalized, advantage + value
        return Experience(Seen(*seen), state, memory, begins, *numbers, acts)

    def _step(
        self, action: Float[Tensor, "world 2"]
    ) -> tuple[Float[Tensor, "world"], Bool[Tensor, "world"], Bool[Tensor, "world"]]:
        """Act in all worlds.

        If the time limit truncates an episode, the discounted value of the last state is added to the reward, in place
        of the rewards after it (Pardo et al. 2018).

        Returns:
            The rewards, True for vehicles whose episode has ended, and False for those whose episode had ended before.
        """
        actions = action.double().cpu().numpy()
        parts = []
        for worlds in self.worlds:
            step, reward, returned, _, acts = worlds.step(actions[worlds.rows])
            timed_out = np.flatnonzero(acts & (step.outcome == Outcome.TIMEOUT))
            if len(timed_out):
                last = Seen.of(worlds.observe_last(step, timed_out), self.device)
                memory, begins = self.memory[worlds.rows[timed_out]], self.begins.new_zeros(1, len(timed_out))
                value = self.network(last, self._state_of(step.after)[timed_out], memory, begins)[1]
                reward[timed_out] += self.parameters.gamma * value.double().cpu().numpy()
            worlds.forget(step.ended)
            self.returns += returned[acts & step.ended].tolist()
            parts.append((reward, step.ended, acts))
        self._observe()
        rewards, ends, all_acts = (self._tensor(part) for part in zip(*parts, strict=True))
        return rewards.float(), ends, all_acts

    def _tensor(self, parts: Sequence[np.ndarray]) -> Tensor:
        return torch.from_numpy(np.concatenate(parts)).to(self.device)

    def _observe(self) -> None:
        """Set the input of the policy and of the value in all worlds."""
        parts = [Seen.of(worlds.observe(), self.device) for worlds in self.worlds]
        self.seen = Seen(*map(torch.cat, zip(*parts, strict=True)))
        self.state = torch.cat([self._state_of(worlds.worlds.worlds) for worlds in self.worlds])

    def _state_of(self, worlds: World) -> Float[Tensor, "world features"]:
        """Return the input of the value in addition to the code: no numbers, or the state and zeros."""
        state = np.zeros((len(worlds), self.state_numbers), np.float32)
        if self.state_numbers:
            known = global_state(worlds) / SCALE
            state[:, : known.shape[1]] = known
        return torch.from_numpy(state).to(self.device)

    def _optimize(self, experience: Experience, worlds: Int[Tensor, "world"]) -> None:
        """Make one step of the optimizer on the segments of the given worlds.

        Threads share the worlds. The gradients of chunks are added in their order, so that the bits do not depend on
        the number of threads.
        """
        # Sorted by the number of pedestrians, so that a chunk has few empty rows.
        worlds = worlds[experience.seen.mask[:, worlds].sum(dim=(0, 2)).argsort(stable=True).cpu()]
        acting = int(experience.acts[:, worlds].sum())
        parameters = list(self.network.parameters())
        gradients: dict[int, tuple[Tensor, ...]] = {}

        def differentiate(part: slice) -> None:
            loss = self._losses(experience.take(worlds[part])).sum() / acting
            gradients[part.start] = torch.autograd.grad(loss, parameters, materialize_grads=True)

        in_chunks(differentiate, len(worlds), CHUNK)
        for parameter, *chunks in zip(parameters, *(gradients[start] for start in sorted(gradients)), strict=True):
            parameter.grad = torch.stack(chunks).sum(dim=0)
        nn.utils.clip_grad_norm_(parameters, self.parameters.max_norm)
        self.optimizer.param_groups[0]["lr"] = self.parameters.learning_rate * (1.0 - self.progress)
        self.optimizer.step()

    def _losses(self, steps: Experience) -> Float[Tensor, "row"]:
        """Return the losses: the value's error minus the clipped objective (Schulman et al. 2017, eqs. 7 and 9)."""
        mean, value, _ = self.network(steps.seen, steps.state, steps.memory, steps.begins)
        ratio = (self.network.log_probability(steps.action, mean) - steps.log_probability).exp()
        clipped = ratio.clamp(1.0 - self.parameters.clip, 1.0 + self.parameters.clip)
        objective = torch.minimum(ratio * steps.advantage, clipped * steps.advantage)
        losses = self.parameters.value_weight * (value - steps.target) ** 2 - objective
        return torch.where(steps.acts, losses, 0.0)

    def planner(self, network: Policy) -> Planner:
        """See `DrivingTraining`."""
        return NetworkPlanner(network, self.interface, self.config.network)

    def conditions(self) -> dict[str, Any]:
        """See `DrivingTraining`."""
        conditions = {
            "nearest": self.interface.nearest,
            "reward": self.config.reward,
            "beside": _count_listed(self.also_train_in),
            "ppo": dataclasses.asdict(self.parameters),
        }
        for name, plugin in {"reward": self.config.reward, "encoder": self.config.encoder}.items():
            file, _ = file_and_function(plugin or "")
            if file is not None:
                conditions[f"{name}_files"] = read_files(file)
        return conditions


def _share_worlds(worlds: int, scenarios: Sequence[Scenario]) -> list[tuple[Scenario, np.ndarray]]:
    """Return each scenario, once, with its rows of the batch: more rows for a scenario that is given several times."""
    # The first scenarios have one more world if worlds cannot be shared evenly.
    sizes = [len(rows) for rows in np.array_split(np.arange(worlds), len(scenarios))]
    shares: dict[str, tuple[Scenario, int]] = {}
    for scenario, size in zip(scenarios, sizes, strict=True):
        key = repr(describe_scenario(scenario))
        shares[key] = scenario, size + (shares[key][1] if key in shares else 0)
    ends = np.cumsum([size for _, size in shares.values()])
    rows = np.split(np.arange(worlds), ends[:-1])
    return [(scenario, part) for (scenario, _), part in zip(shares.values(), rows, strict=True)]


def _count_listed(scenarios: Sequence[Scenario]) -> list[dict[str, Any]]:
    """Describe each scenario once, with the number of `times` it is listed."""
    facts = [describe_scenario(scenario) for scenario in scenarios]
    return [{**one, "times": facts.count(one)} for number, one in enumerate(facts) if one not in facts[:number]]


def advantages(
    reward: Numbers, value: Float[Tensor, "step+1 world"], continues: Flags, gamma: float, gae_lambda: float
) -> Numbers:
    """Compute the generalized advantage estimate (Schulman et al. 2016, equation 16).

    Args:
        reward: The rewards.
        value: The values before each step, and after the last one.
        continues: True if the episode continues after a step.
        gamma: See `Parameters`.
        gae_lambda: See `Parameters`.
    """
    next_value = torch.where(continues, value[1:], 0.0)
    difference = reward + gamma * next_value - value[:-1]
    estimate = difference.clone()
    for step in reversed(range(len(reward) - 1)):
        estimate[step] += gamma * gae_lambda * continues[step] * estimate[step + 1]
    return estimate
