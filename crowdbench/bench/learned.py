"""How long decisions and trainings of SARL take, and how near its decisions come to what the processor can do.

The networks that decide have random weights: they cost what trained ones cost.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from statistics import mean, median

import torch
from torch.utils.flop_counter import FlopCounterMode

from crowdbench.bench import CROWDNAV, Row
from crowdbench.bench.timing import in_turns, seconds
from crowdbench.catalog import load_scenario
from crowdbench.planners.base import Planner
from crowdbench.planners.lookahead import ValuePlanner
from crowdbench.predict import ConstantVelocity, Oracle
from crowdbench.scenario.cases import Cases
from crowdbench.sim.sensor import observe
from crowdbench.train import value as method
from crowdbench.types import Observation
from crowdbench.value.networks import SARL

CROWDNAV_SECONDS = {5: 0.037, 10: 0.067}
"""What CrowdNav's code took for a SARL decision among so many pedestrians. Recorded once, not measured here."""

PARTS = (1 / 6, 1 / 2, 5 / 6)
"""Where in a training its rounds are measured: the middles of its thirds, which explore as much as all on average."""


def batched_rows(worlds: int = 500, rounds: int = 5) -> Iterator[Row]:
    """Decisions for many worlds at once."""
    for pedestrians in CROWDNAV_SECONDS:
        [took] = in_turns(rounds, functools.partial(seconds, decision(pedestrians, worlds)))
        yield _decision_row(f"{worlds} worlds at once, per world", took / worlds, pedestrians)


def single_rows(decisions: int = 300) -> Iterator[Row]:
    """Decisions for one world at a time, each another one."""
    planner = ValuePlanner(ConstantVelocity(), SARL())
    for pedestrians in CROWDNAV_SECONDS:
        yield _decision_row("one world", one_by_one(planner, observation(pedestrians, decisions)), pedestrians)


def share_rows(worlds: int = 500, size: int = 1024, rounds: int = 10) -> Iterator[Row]:
    """A large matrix product, which nothing made of such products can outdo, and how near a decision comes to it."""
    matrix = torch.rand(size, size)
    works: list[Callable[[], object]] = [functools.partial(torch.mm, matrix, matrix), decision(5, worlds)]
    took = in_turns(rounds, *(functools.partial(seconds, work) for work in works))
    limit, reached = (operations(work) / time / 1e9 for work, time in zip(works, took, strict=True))
    yield Row(f"matrix product of {size} x {size} float32, the limit", limit, "GFLOP/s")
    yield Row(f"share of that limit: SARL decision, 5 pedestrians, {worlds} worlds", 100 * reached / limit, "%")


def training_row(episodes: int) -> Iterator[Row]:
    """The length of a training foreseen from its imitation and some rounds, without what validation takes."""
    scenario = load_scenario("circle_crossing_mixed")
    training = method.Training(method.Setup("sarl", scenario, Oracle(), 0, episodes, minutes=None, device="cpu"))
    rounds = episodes / method.ROUND
    imitation = seconds(training.imitate)
    driven = []
    for part in PARTS:
        training.rounds = int(part * rounds)
        driven.append(seconds(training.improve))
    work = f"training of SARL, {episodes:,} episodes, foreseen from imitation and {len(PARTS)} of {rounds:.0f} rounds"
    yield Row(work, (imitation + rounds * mean(driven)) / 60, "min")


def decision(pedestrians: int, worlds: int) -> Callable[[], object]:
    """A decision of SARL-CVM in each of so many worlds, all at once."""
    planner = ValuePlanner(ConstantVelocity(), SARL())
    return functools.partial(planner.plan, observation(pedestrians, worlds))


def one_by_one(planner: Planner, obs: Observation) -> float:
    """The median of the seconds in which a planner decides for each world by itself."""
    works = [functools.partial(planner.plan, obs.take(slice(row, row + 1))) for row in range(len(obs))]
    return median(map(seconds, works))


def operations(work: Callable[[], object]) -> int:
    """The multiplications and additions in all matrix products of some work in torch."""
    with FlopCounterMode(display=False) as counter:
        work()
    return counter.get_total_flops()


def observation(pedestrians: int, worlds: int) -> Observation:
    """What is seen at the start of so many worlds."""
    scenario = load_scenario("circle_crossing_5", {"pedestrians.number": pedestrians})
    return observe(scenario.worlds(Cases("test", 0, worlds)))


def _decision_row(where: str, took: float, pedestrians: int) -> Row:
    work = f"SARL decision, {pedestrians} pedestrians, {where}"
    return Row(work, 1e3 * took, "ms", 1e3 * CROWDNAV_SECONDS[pedestrians], CROWDNAV)
