"""Trains a value network: ORCA demonstrates, the network imitates, then it learns from its own episodes.

The method of CrowdNav (Chen et al. 2019, algorithm 1), for any of the networks. Differs from CrowdNav because it must
take minutes: episodes run in rounds, all of a round in lock-step; the target is a moving average of the network
instead of a copy made now and then, and is what is validated and kept. A time-out only truncates an episode: CrowdNav
forgets such episodes, here the last state's value stands for the rest.
"""

from __future__ import annotations

import copy
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from scipy.special import ndtr
from torch import Tensor

from crowdbench import rng
from crowdbench.evaluate.driver import Driver
from crowdbench.evaluate.metrics import discounted_return, navigation_time_or_limit, success_rate
from crowdbench.evaluate.rollout import rollout
from crowdbench.planners.base import Planner
from crowdbench.planners.lookahead import ValuePlanner
from crowdbench.planners.reactive import ORCAPlanner
from crowdbench.predict import ConstantVelocity, Predictor
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario
from crowdbench.train.checkpoint import State, optimizer_state, restore_optimizer, tensors_of, under
from crowdbench.train.replay import Replay, Steps, steps_of
from crowdbench.types import Observation, Trace
from crowdbench.value.networks import NETWORKS

DEMONSTRATIONS = 2000
"""Episodes that ORCA demonstrates, with `SAFETY_SPACE` metres added to every radius."""

SAFETY_SPACE = 0.15
PASSES = 5
"""Times that the network sees every demonstrated step."""

IMITATION_RATE = 1e-3
"""Learning rate of imitation."""

RATE = 5e-4
"""Learning rate of the network's own episodes, falling to nothing over their second half."""

ROUND = 100
"""Episodes that the network drives between updates."""

SAMPLES = 10
"""Steps that are learnt from per step driven."""

BATCH = 512
AHEAD = 6
"""Steps between a state and the one whose value it learns from: one would carry what is learnt too slowly back."""

CAPACITY = 150_000
"""Steps that are remembered."""

EXPLORATION = (0.15, 0.02, 0.4)
"""Share of random commands at first, in the end, and the part of the training over which it falls."""

AVERAGING = 0.01
"""Weight of the network in the moving average, at every update."""

VALIDATIONS = 12
"""How often, over a whole training, the network is measured on validation cases."""

VALIDATION_CASES = 200
SECONDS_PER_POINT = 1.0
"""Seconds of driving that weigh as much as one percentage point of success when a network is chosen."""

CASES_PER_SEED = 1_000_000
"""Every seed has training cases of its own."""

PARTS = ("network", "average", "best")
"""The networks of a training."""


@dataclass(frozen=True)
class Setup:
    """What is trained, among which crowd, for how long: `minutes` where given, or else `episodes`."""

    network: str
    scenario: Scenario
    predictor: Predictor
    seed: int
    episodes: int
    minutes: float | None
    device: str


@dataclass(frozen=True)
class Validated:
    """One point of the training curve. Seconds are those spent on training, validation left out."""

    episodes: int
    seconds: float
    exploration: float
    loss: float
    success: float
    navigation_time_or_limit: float
    discounted_return: float

    @property
    def score(self) -> float:
        """What the kept network is chosen by: the share of successes, less what slowness costs."""
        return self.success - 0.01 / SECONDS_PER_POINT * self.navigation_time_or_limit

    def __str__(self) -> str:
        return (
            f"{self.episodes:6d} episodes, {self.seconds:4.0f} s: on validation cases {100 * self.success:.1f} % "
            f"success in {self.navigation_time_or_limit:.2f} s (a failure counts as the time limit)"
        )


class Training:
    """A training and all its state. `run` may be called again after an interruption or on a restored state."""

    def __init__(self, setup: Setup) -> None:
        self.setup = setup
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(setup.seed)
            self.network = NETWORKS[setup.network]().to(setup.device)
        self.average = copy.deepcopy(self.network)
        self.best = copy.deepcopy(self.network)
        self.optimizer = torch.optim.Adam(self.network.parameters(), lr=RATE)
        self.replay = Replay(CAPACITY)
        self.rounds = 0
        self.seconds = 0.0
        self.curve: list[Validated] = []

    @property
    def progress(self) -> float:
        """How much of the training is done, from 0 to 1."""
        episodes, minutes = self.setup.episodes, self.setup.minutes
        return min(1.0, self.seconds / (60.0 * minutes) if minutes else self.rounds * ROUND / episodes)

    def run(self, after_validation: Callable[[], None]) -> None:
        """Train to the end; `after_validation` is called whenever a point is added to the curve."""
        if not self.curve:
            self._validate(self._timed(self.imitate))
            after_validation()
        while self.progress < 1.0:
            loss = self._timed(self.improve)
            if len(self.curve) <= int(self.progress * VALIDATIONS):
                self._validate(loss)
                after_validation()

    def _timed(self, work: Callable[[], float]) -> float:
        start = time.perf_counter()
        loss = work()
        self.seconds += time.perf_counter() - start
        return loss

    def imitate(self) -> float:
        """Learn the returns of demonstrated episodes. The loss of the last pass."""
        trace = rollout(Driver(ORCAPlanner(SAFETY_SPACE), "orca"), self.setup.scenario, self._cases(0, DEMONSTRATIONS))
        steps = steps_of(trace, AHEAD, timeouts=False)
        optimizer = torch.optim.Adam(self.network.parameters(), lr=IMITATION_RATE)
        generator = np.random.default_rng([self.setup.seed, 0])
        for _ in range(PASSES):
            order = generator.permutation(len(steps))
            batches = [steps.take(order[start : start + BATCH]) for start in range(0, len(steps), BATCH)]
            loss = np.mean([self._update(optimizer, batch, self._tensor(batch.value)) for batch in batches])
        self.average.load_state_dict(self.network.state_dict())
        return float(loss)

    def improve(self) -> float:
        """Drive a round of episodes and learn from all that are remembered. The mean loss."""
        for group in self.optimizer.param_groups:
            group["lr"] = RATE * min(1.0, 2.0 * (1.0 - self.progress))
        steps = steps_of(self._drive(), AHEAD)
        self.replay.add(steps)
        generator = np.random.default_rng([self.setup.seed, 1, self.rounds])
        losses = []
        for _ in range(SAMPLES * len(steps) // BATCH):
            batch = self.replay.sample(generator, BATCH)
            losses.append(self._update(self.optimizer, batch, self._target(batch)))
            with torch.no_grad():
                torch._foreach_lerp_(list(self.average.parameters()), list(self.network.parameters()), AVERAGING)
        self.rounds += 1
        return float(np.mean(losses))

    def _drive(self) -> Trace:
        planner = ValuePlanner(self.setup.predictor, self.network)
        driver = Driver(Exploring(planner, self.exploration, self.setup.seed), self.setup.network)
        return rollout(driver, self.setup.scenario, self._cases(DEMONSTRATIONS + self.rounds * ROUND, ROUND))

    @property
    def exploration(self) -> float:
        """The share of random commands at present."""
        first, last, part = EXPLORATION
        return first + (last - first) * min(1.0, self.progress / part)

    def _cases(self, start: int, n: int) -> Cases:
        start += self.setup.seed * CASES_PER_SEED
        return Cases("train", start, start + n)

    @torch.no_grad()
    def _target(self, batch: Steps) -> Float[Tensor, "step"]:
        """The rewards of the next steps and the discounted value of the state after them."""
        later = self.average(self._tensor(batch.later), self._tensor(batch.present))
        return self._tensor(batch.reward) + self._tensor(batch.factor) * later

    def _update(self, optimizer: torch.optim.Optimizer, batch: Steps, target: Float[Tensor, "step"]) -> float:
        values = self.network(self._tensor(batch.joint), self._tensor(batch.present))
        loss = torch.nn.functional.mse_loss(values, target)
        optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimizer.step()
        return loss.item()

    def _tensor(self, array: np.ndarray) -> Tensor:
        return torch.from_numpy(array).to(self.setup.device)

    def _validate(self, loss: float) -> None:
        # A network is chosen by how it does with what a vehicle can see, whatever it is trained with.
        driver = Driver(ValuePlanner(ConstantVelocity(), self.average), self.setup.network)
        trace = rollout(driver, self.setup.scenario, Cases("val", 0, VALIDATION_CASES))
        point = Validated(
            episodes=self.rounds * ROUND,
            seconds=self.seconds,
            exploration=self.exploration,
            loss=loss,
            success=float(success_rate(trace).mean()),
            navigation_time_or_limit=float(navigation_time_or_limit(trace).mean()),
            discounted_return=float(discounted_return(trace).mean()),
        )
        self.curve.append(point)
        if self.kept is point:
            self.best.load_state_dict(self.average.state_dict())

    @property
    def kept(self) -> Validated:
        """The point of the curve at which the best network was found, the later of equals, which has learnt more."""
        return max(reversed(self.curve), key=lambda point: point.score)

    def state(self) -> State:
        """All of it, to be written."""
        tensors = {key: value for part in PARTS for key, value in tensors_of(part, getattr(self, part)).items()}
        tensors |= optimizer_state("optimizer", self.optimizer)
        if self.replay.steps is not None:
            kept = self.replay.steps.take(slice(0, len(self.replay)))
            tensors |= {f"replay.{name}": torch.from_numpy(array) for name, array in vars(kept).items()}
        return State(tensors, {"rounds": self.rounds, "seconds": self.seconds, "added": self.replay.added}, self.curve)

    def restore(self, state: State) -> None:
        """Go on from what `state` gave. Raises RuntimeError where it is another network's."""
        for part in PARTS:
            getattr(self, part).load_state_dict(under(part, state.tensors))
        restore_optimizer(self.optimizer, under("optimizer", state.tensors))
        if replay := under("replay", state.tensors):
            self.replay.add(Steps(**{name: tensor.numpy() for name, tensor in replay.items()}))
        self.replay.added = state.facts["added"]
        self.rounds, self.seconds = state.facts["rounds"], state.facts["seconds"]
        self.curve = [Validated(**point) for point in state.curve]


class Exploring(Planner):
    """Another planner, with random ones of its 81 commands in a `share` of the steps."""

    def __init__(self, planner: ValuePlanner, share: float, seed: int) -> None:
        self.privileged = planner.privileged
        self.planner = planner
        self.share = share
        self.purpose = f"exploration {seed}"

    def plan(self, obs: Observation) -> Float[np.ndarray, "world 2"]:
        """See `Planner`."""
        commands = self.planner.actions(obs.vehicle.preferred_speed)
        # Uniform from normal numbers, whose stream depends on nothing but the case and the step.
        explore, which = ndtr(rng.normal(obs.key, self.purpose, obs.step, 1, 2)[:, 0]).T
        world = np.arange(len(obs))
        chosen = commands[world, (which * commands.shape[1]).astype(int)]
        greedy = explore >= self.share
        if greedy.any():
            chosen[greedy] = self.planner.plan(obs.take(greedy))
        return chosen
