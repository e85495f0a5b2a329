"""Trains a policy by proximal policy optimization (PPO, Schulman et al. 2017).

The policy sees the vehicle and the nearest pedestrians in the frame of the goal, and gives a velocity in it; one
with a memory sees more, and gives commands (`planners.policy.Showing`). It learns from a reward in many worlds at once.
Each update drives some steps of every world, then goes through them several times in minibatches
(`train.ppo_parameters`).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from crowdbench.catalog import load_scenario
from crowdbench.metrics.motion import jerk
from crowdbench.metrics.outcomes import navigation_time_or_limit, success_rate
from crowdbench.networks.encoders import make_policy
from crowdbench.networks.policy import ActorCritic, Memory, Policy, Seen
from crowdbench.planners.policy import PolicyPlanner, Showing
from crowdbench.predict import ConstantVelocity
from crowdbench.train.checkpoint import State, parts_state, restore_parts
from crowdbench.train.driving import DrivingTraining
from crowdbench.train.gradients import set_gradients
from crowdbench.train.ppo_worlds import PolicyWorlds
from crowdbench.utils.errors import InputError
from crowdbench.utils.memory import keep_freed_memory
from crowdbench.utils.threads import one_torch_thread

CHUNK = 16
"""Worlds of a minibatch that a thread goes through at once: few enough for the cache of a core."""

VALIDATIONS = 20
"""Validations of a training, after which it can be resumed."""

PARTS = ("network", "optimizer")
"""The network and the optimizer of a training."""

keep_freed_memory()


@dataclass(frozen=True)
class CurvePoint:
    """One validation: a point of the training curve. Its means are over the cases of all validation scenarios.

    Attributes:
        steps: The steps driven so far, of all worlds together.
        seconds: The time so far in seconds, with validations.
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


class Experience(NamedTuple):
    """Steps that the policy learns from: the segment of every world, in order of time.

    Attributes:
        seen: What was seen.
        memory: What was remembered before the first of the steps.
        begins: Where a step was the first of an episode.
        action: What was tried, in m/s.
        log_probability: The logarithm of its probability density then.
        advantage: By how much it did better than the value, normalized to mean 0 and standard deviation 1.
        returned: What the value should have been.
    """

    seen: Seen
    memory: Memory
    begins: Bool[Tensor, "time world"]
    action: Float[Tensor, "*step 2"]
    log_probability: Float[Tensor, "*step"]
    advantage: Float[Tensor, "*step"]
    returned: Float[Tensor, "*step"]

    def take(self, worlds: Int[Tensor, "world"]) -> Experience:
        """The segments of some worlds, all steps on one axis, shown no more pedestrians than one of them has."""
        vehicle, pedestrians, mask, *others = (part[:, worlds].flatten(0, 1) for part in (*self.seen, *self[3:]))
        most = max(int(mask.sum(dim=1).max()), 1)
        seen = Seen(vehicle, pedestrians[:, :most], mask[:, :most])
        return Experience(seen, self.memory[worlds], self.begins[:, worlds], *others)


def advantages(
    reward: Float[Tensor, "step world"],
    value: Float[Tensor, "step+1 world"],
    goes_on: Bool[Tensor, "step world"],
    gamma: float,
    trace: float,
) -> Float[Tensor, "step world"]:
    """The generalized advantage estimate (Schulman et al. 2016, equation 16).

    Args:
        reward: The rewards.
        value: The values before each step, and after the last one.
        goes_on: Whether the episode goes on after each step.
        gamma: See `Parameters`, and so for `trace`.
        trace: Lambda.
    """
    after = torch.where(goes_on, value[1:], 0.0)
    difference = reward + gamma * after - value[:-1]
    estimate = difference.clone()
    for step in reversed(range(len(reward) - 1)):
        estimate[step] += gamma * trace * goes_on[step] * estimate[step + 1]
    return estimate


class Training(DrivingTraining[Policy, CurvePoint]):
    """A training of a policy and all its state. `run` may be called on a new or on a restored one.

    Args:
        request: The `PPORequest` that asks for it.
        device: `cpu` or `cuda`.
    """

    def __init__(self, request: Any, device: str) -> None:
        super().__init__(request)
        self.beside = [load_scenario(name) for name in request.beside_names]
        scenarios = [self.scenario, *self.beside]
        self.nearest = request.nearest or max(1, *(each.max_agents - 1 for each in scenarios))
        self.device, self.own = device, request.parameters
        self.steps = 0
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(request.seed)
            policy = make_policy(request.network, request.encoder)
            self.network = ActorCritic(policy).to(device)
        self.showing = Showing(self.nearest, ConstantVelocity() if policy.remembered else None)
        # The first ones have a world more where they cannot be shared evenly.
        shares = [len(part) for part in np.array_split(np.arange(self.own.worlds), len(scenarios))]
        self.worlds = [
            PolicyWorlds(share, each, self.showing, request.reward, device)
            for share, each in zip(shares, scenarios, strict=True)
        ]
        self.optimizer = torch.optim.Adam(self.network.parameters(), lr=self.own.learning_rate, eps=1e-5)
        self.generator = torch.Generator()
        self.returns: list[float] = []

    @property
    def progress(self) -> float:
        """The part of the training that is done, from 0 to 1."""
        return self.request.progress(self.steps, self.seconds)

    @property
    def current(self) -> Policy:
        """See `DrivingTraining`."""
        return self.network.policy

    def planner(self, network: Policy) -> PolicyPlanner:
        """See `DrivingTraining`."""
        return PolicyPlanner(network, self.showing, self.request.network)

    def run(self, after_validation: Callable[[], None]) -> None:
        """Train to the end, and call `after_validation` whenever the curve has a new point."""
        if not self.curve:
            self._validate()
            after_validation()
        while self.progress < 1.0:
            self.train_until((math.floor(self.progress * VALIDATIONS) + 1) / VALIDATIONS)
            self._validate()
            after_validation()

    def train_until(self, goal: float) -> None:
        """Train up to some progress. All that is random in it follows from the seed and the curve so far."""
        start = time.perf_counter()
        seed = self.request.seed + 1000 * len(self.curve)
        self.generator.manual_seed(seed)
        for worlds in self.worlds:
            worlds.start(seed)  # draws new cases
        self.memory = self.network.policy.nothing(self.own.worlds)
        self.begins = torch.ones(1, self.own.worlds, dtype=torch.bool, device=self.device)
        while True:  # once in any case: where cases take long to draw, they alone may have taken until the goal
            self._update()
            now = time.perf_counter()
            self.seconds += now - start
            start = now
            if self.progress >= min(goal, 1.0):
                return

    def _update(self) -> None:
        """Drive, and learn from it."""
        with one_torch_thread():  # whose sums are the same with any number of threads
            experience = self._drive()
            for _ in range(self.own.epochs):
                order = torch.randperm(self.own.worlds, generator=self.generator)
                for some in torch.split(order, self.own.segments):
                    self._descend(experience, some)
        self.steps += self.own.steps * self.own.worlds

    @torch.no_grad()
    def _drive(self) -> Experience:
        """Drive some steps of every world."""
        steps, values, rewards, goes_on, memory = [], [], [], [], self.memory
        for _ in range(self.own.steps):
            now = self._see()
            mean, value, self.memory = self.network(now, self.memory, self.begins)
            noise = torch.randn(mean.shape, generator=self.generator).to(self.device)
            action = mean + self.network.log_std.exp() * noise
            steps.append((*now, self.begins[0], action, self.network.log_probability(action, mean)))
            if not action.isfinite().all():
                raise InputError(
                    f"the training has failed after {self.steps} steps: the policy's actions are not finite, as where "
                    f"the reward {self.request.reward} is too large"
                )
            reward, ended = self._step(action.double().cpu().numpy())
            values.append(value)
            rewards.append(reward)
            goes_on.append(~ended)
            self.begins = ended[None]
        value = torch.stack([*values, self.network(self._see(), self.memory, self.begins)[1]])
        advantage = advantages(torch.stack(rewards), value, torch.stack(goes_on), self.own.gamma, self.own.trace)
        normalized = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
        *seen, begins, action, log_probability = (torch.stack(part) for part in zip(*steps, strict=True))
        target = advantage + value[:-1]
        return Experience(Seen(*seen), memory, begins, action, log_probability, normalized, target)

    def _step(self, action: Float[np.ndarray, "world 2"]) -> tuple[Float[Tensor, "world"], Bool[Tensor, "world"]]:
        """Act in all worlds. The rewards, and where an episode has ended.

        Where the time limit ended it, which cuts off what would have followed, the reward has the value of that (Pardo
        et al. 2018).
        """
        rewards, ends, start = [], [], 0
        for worlds in self.worlds:
            part = slice(start, start + worlds.number)
            paid = worlds.step(action[part])
            if len(paid.timed_out):
                memory, go_on = self.memory[part][paid.timed_out], self.begins.new_zeros(1, len(paid.timed_out))
                value = self.network(paid.cut_off, memory, go_on)[1].double().cpu().numpy()
                paid.reward[paid.timed_out] += self.own.gamma * value
            self.returns += paid.returned
            rewards.append(paid.reward)
            ends.append(paid.ended)
            start = part.stop
        return self._tensor(np.concatenate(rewards)).float(), self._tensor(np.concatenate(ends))

    def _descend(self, experience: Experience, worlds: Int[Tensor, "world"]) -> None:
        """One step of the optimizer on the segments of some worlds."""
        # Those with as many pedestrians come together, so that a chunk has few empty places.
        worlds = worlds[experience.seen.mask[:, worlds].sum(dim=(0, 2)).argsort(stable=True).cpu()]
        parameters = list(self.network.parameters())

        def loss(part: slice) -> Tensor:
            return self._losses(experience.take(worlds[part])).sum() / (self.own.steps * len(worlds))

        set_gradients(parameters, loss, len(worlds), CHUNK)
        nn.utils.clip_grad_norm_(parameters, self.own.max_norm)
        self.optimizer.param_groups[0]["lr"] = self.own.learning_rate * (1.0 - self.progress)
        self.optimizer.step()

    def _losses(self, steps: Experience) -> Float[Tensor, "row"]:
        """What is minimized: the clipped objective (Schulman et al. 2017, equations 7 and 9) and the value's error."""
        mean, value, _ = self.network(steps.seen, steps.memory, steps.begins)
        ratio = (self.network.log_probability(steps.action, mean) - steps.log_probability).exp()
        clipped = ratio.clamp(1.0 - self.own.clip, 1.0 + self.own.clip)
        gain = torch.minimum(ratio * steps.advantage, clipped * steps.advantage)
        return self.own.value_weight * (value - steps.returned) ** 2 - gain

    def _see(self) -> Seen:
        """What is seen in all worlds now."""
        return Seen(*map(torch.cat, zip(*(worlds.seen for worlds in self.worlds), strict=True)))

    def _tensor(self, array: np.ndarray) -> Tensor:
        return torch.from_numpy(array).to(self.device)

    def _validate(self) -> None:
        """Add a point to the curve, and keep its policy."""
        mean = self.drive_validation()
        self.curve.append(
            CurvePoint(
                steps=self.steps,
                seconds=self.seconds,
                reward=float(np.mean(self.returns)) if self.returns else 0.0,
                success=mean(success_rate),
                navigation_time_or_limit=mean(navigation_time_or_limit),
                jerk=mean(jerk),
            )
        )
        self.returns.clear()

    def state(self) -> State:
        """The state of the training, for a checkpoint. Worlds are not in it: each segment begins with new episodes."""
        tensors = parts_state(self, PARTS) | self.validated_tensors()
        return State(tensors, {"steps": self.steps, "seconds": self.seconds}, self.curve)

    def restore(self, state: State) -> None:
        """Continue from a checkpoint. Raises RuntimeError where it is of another network."""
        restore_parts(self, PARTS, state.tensors)
        self.restore_curve(state, CurvePoint)
        self.steps = state.facts["steps"]
