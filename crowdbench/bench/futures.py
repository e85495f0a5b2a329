"""How long decisions of SARL-SGAN-KCE take, under 20 futures, and what makes them quick.

With shipped weights, unless `options` of the planner say otherwise.
"""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any, cast

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from crowdbench.bench import Row, Way, Ways
from crowdbench.bench.learned import observation, one_by_one
from crowdbench.bench.timing import in_turns, seconds
from crowdbench.catalog import load_planner, load_scenario
from crowdbench.evaluate.driver import Driver
from crowdbench.evaluate.rollout import rollout
from crowdbench.planners.base import Planner
from crowdbench.planners.lookahead import ValuePlanner
from crowdbench.predict.social_gan import SocialGAN
from crowdbench.predict.social_gan_network import Generator
from crowdbench.scenario.cases import Cases
from crowdbench.types import Observation
from crowdbench.value.networks import ValueNetwork

PLANNER = "sarl_sgan_kce"

PEDESTRIANS = 5

SHORTLISTS = (16, 8, 4)


def batched_row(worlds: int = 500, rounds: int = 5, **options: Any) -> Iterator[Row]:
    """Decisions for many worlds at once."""
    decide = functools.partial(_planner(**options).plan, observation(PEDESTRIANS, worlds))
    [took] = in_turns(rounds, functools.partial(seconds, decide))
    yield _row(f"{worlds} worlds at once, per world", took / worlds)


def single_row(decisions: int = 100, **options: Any) -> Iterator[Row]:
    """Decisions for one world at a time, each another one."""
    yield _row("one world", one_by_one(_planner(**options), observation(PEDESTRIANS, decisions)))


def planners(**options: Any) -> dict[str, Planner]:
    """The slow way, which values all commands under all futures, and others by what they do otherwise."""
    slow, passes, half = (_planner(**options, shortlist=None) for _ in range(3))
    passes.predictor = _pass_each(cast(SocialGAN, passes.predictor))
    half.value = _Half(half.value)
    return {
        "all commands under all futures": slow,
        "a pass of the generator for each future": passes,
        "value network in bfloat16": half,
        **{f"shortlist {number}": _planner(**options, shortlist=number) for number in SHORTLISTS},
    }


def compare(wanted: Mapping[str, Planner], cases: Cases, progress: Callable[[int], None] | None = None) -> Ways:
    """How long planners take for the same decisions, those of the first one's episodes, and what they change.

    `progress` is told how many episodes have ended, of all planners.
    """
    turns = _Turns(list(wanted.values()))
    # The one that is timed comes last: all is compiled then.
    *others, first = (_outcomes(planner, cases, progress) for planner in [*turns.planners[1:], turns])
    differ = [int((outcome != first).sum()) for outcome in [first, *others]]
    ways = map(Way, wanted, turns.seconds.tolist(), turns.differ.tolist(), differ)
    return Ways(tuple(ways), turns.decisions, len(cases))


class _Turns(Planner):
    """Drives as the first of its planners does. The others are asked in turn, about the same, and all are timed."""

    def __init__(self, planners: list[Planner]) -> None:
        self.planners = planners
        self.seconds = np.zeros(len(planners))
        self.differ = np.zeros(len(planners), np.int64)
        self.decisions = 0

    def plan(self, obs: Observation) -> Float[np.ndarray, "world 2"]:
        """See `Planner`."""
        commands = []
        for number, planner in enumerate(self.planners):
            begin = time.perf_counter()
            commands.append(planner.plan(obs))
            self.seconds[number] += time.perf_counter() - begin
        self.differ += [(command != commands[0]).any(axis=1).sum() for command in commands]
        self.decisions += len(obs)
        return commands[0]


class _Half(ValueNetwork):
    """A value network that computes in bfloat16."""

    def __init__(self, network: ValueNetwork) -> None:
        super().__init__()
        self.name = network.name
        self.network = network

    def crowd(
        self, joint: Float[Tensor, "batch pedestrian 13"], present: Bool[Tensor, "batch pedestrian"]
    ) -> tuple[Float[Tensor, "batch"], Float[Tensor, "batch pedestrian"]]:
        """See `ValueNetwork`."""
        with torch.autocast("cpu", torch.bfloat16):
            value, attention = self.network.crowd(joint, present)
        return value.float(), attention.float()


class _PassEach(Generator):
    """A generator that is asked for each future by itself."""

    def forward(
        self,
        history: Float[Tensor, "scene time pedestrian 2"],
        present: Bool[Tensor, "scene pedestrian"],
        noise: Float[Tensor, "scene mode noise"],
        steps: int,
    ) -> Float[Tensor, "mode row steps 2"]:
        """See `Generator`."""
        ask = super().forward
        return torch.cat([ask(history, present, noise[:, [mode]], steps) for mode in range(noise.shape[1])])


def _pass_each(predictor: SocialGAN) -> SocialGAN:
    generator = _PassEach(predictor.generator.pooling is not None)
    generator.load_state_dict(predictor.generator.state_dict())
    return SocialGAN(generator, predictor.about, predictor.modes, predictor.rescaled)


def _planner(**options: Any) -> ValuePlanner:
    return cast(ValuePlanner, load_planner(PLANNER, options)[1])


def _outcomes(planner: Planner, cases: Cases, progress: Callable[[int], None] | None) -> np.ndarray:
    return rollout(Driver(planner, PLANNER), load_scenario("circle_crossing_5"), cases, progress=progress).outcome


def _row(where: str, took: float) -> Row:
    return Row(f"SARL-SGAN-KCE decision, {PEDESTRIANS} pedestrians, 20 futures, {where}", 1e3 * took, "ms")
