"""What each speed-up of SARL-SGAN-KCE's lookahead saves, and whether it changes any command."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any, cast

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from crowdbench.catalog import load_planner, load_scenario
from crowdbench.core.types import Observation
from crowdbench.networks.social_gan import Generator
from crowdbench.networks.value import ValueNetwork
from crowdbench.planners.base import Planner
from crowdbench.planners.driver import Driver
from crowdbench.planners.lookahead import ValuePlanner
from crowdbench.predict.social_gan import SocialGAN
from crowdbench.runs.rollout import rollout
from crowdbench.scenario.cases import Cases

PLANNER = "sarl_sgan_kce"

SHORTLISTS = (16, 8, 4)
"""Lengths of the shortlists that are measured."""


def variants(**options: Any) -> dict[str, Planner]:
    """The variants of the planner by name. The first one values all commands under all futures.

    Args:
        options: Options of the planner, without `shortlist`.
    """
    reference, separate, half = (_planner(**options, shortlist=None) for _ in range(3))
    separate.predictor = _one_pass_per_future(cast(SocialGAN, separate.predictor))
    half.value = _HalfPrecision(half.value)
    return {
        "all commands under all futures": reference,
        "one pass of the generator per future": separate,
        "value network in bfloat16": half,
        **{f"shortlist {number}": _planner(**options, shortlist=number) for number in SHORTLISTS},
    }


def compare(
    planners: Mapping[str, Planner], cases: Cases, progress: Callable[[float], None] | None = None
) -> list[tuple[str, ...]]:
    """Compare variants: on the decisions of the episodes that the first one drives, and on the outcomes of their own.

    Args:
        planners: The variants by name, the reference first.
        cases: The cases of `circle_crossing_5` that each variant drives.
        progress: Called as by `rollout`, for the episodes of all variants.

    Returns:
        For each variant, its name, the time of all its decisions, how many times faster than the first it is, the
        episodes that end differently when it drives, and the decisions in which its command differs.
    """
    timed = _AllDecide(list(planners.values()))
    # The timed one drives last: everything is compiled then.
    *others, reference = (_outcomes(planner, cases, progress) for planner in [*timed.planners[1:], timed])
    return [
        (
            name,
            f"{seconds:.3g} s",
            f"{timed.seconds[0] / seconds:.1f}x",
            f"{(outcome != reference).sum()} of {len(cases):,}",
            f"{changed} of {timed.decisions:,}",
        )
        for name, seconds, changed, outcome in zip(
            planners, timed.seconds, timed.changed_commands, [reference, *others], strict=True
        )
    ]


class _AllDecide(Planner):
    """Lets all planners decide about each observation and measures their times. The first one's commands are driven."""

    def __init__(self, planners: list[Planner]) -> None:
        self.planners = planners
        self.seconds = np.zeros(len(planners))
        self.changed_commands = np.zeros(len(planners), np.int64)
        self.decisions = 0

    def plan(self, obs: Observation) -> Float[np.ndarray, "world 2"]:
        """See `Planner`."""
        commands = []
        for number, planner in enumerate(self.planners):
            begin = time.perf_counter()
            commands.append(planner.plan(obs))
            self.seconds[number] += time.perf_counter() - begin
        self.changed_commands += [(command != commands[0]).any(axis=1).sum() for command in commands]
        self.decisions += len(obs)
        return commands[0]


class _HalfPrecision(ValueNetwork):
    """A value network that computes in bfloat16."""

    def __init__(self, network: ValueNetwork) -> None:
        super().__init__()
        self.name = network.name
        self.network = network

    def crowd(self, joint: Tensor, present: Tensor) -> tuple[Tensor, Tensor]:
        """See `ValueNetwork`."""
        with torch.autocast("cpu", torch.bfloat16):
            value, attention = self.network.crowd(joint, present)
        return value.float(), attention.float()


class _OnePassPerFuture(Generator):
    """A generator that computes each future in a pass of its own."""

    def forward(self, history: Tensor, present: Tensor, noise: Tensor, steps: int) -> Tensor:
        """See `Generator`."""
        one_pass = super().forward
        return torch.cat([one_pass(history, present, noise[:, [mode]], steps) for mode in range(noise.shape[1])])


def _one_pass_per_future(predictor: SocialGAN) -> SocialGAN:
    generator = _OnePassPerFuture(predictor.generator.pooling is not None)
    generator.load_state_dict(predictor.generator.state_dict())
    return SocialGAN(generator, predictor.about, predictor.modes, predictor.rescaled)


def _planner(**options: Any) -> ValuePlanner:
    return cast(ValuePlanner, load_planner(PLANNER, options)[1])


def _outcomes(planner: Planner, cases: Cases, progress: Callable[[float], None] | None) -> Int[np.ndarray, "world"]:
    return rollout(Driver(planner, PLANNER), load_scenario("circle_crossing_5"), cases, progress=progress).outcome
