"""How long decisions of the learned planners take, and how close they come to what the processor can compute.

SARL's networks have random weights here, which cost as much as trained ones. SARL-SGAN-KCE and SARL-SGAN-SEQ have the
weights that come with crowdbench unless their options name others.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from statistics import median
from typing import Any

import torch
from torch.utils.flop_counter import FlopCounterMode

from crowdbench.bench.measurement import Measurement
from crowdbench.bench.timing import in_turns, seconds
from crowdbench.catalog import load_planner, load_scenario
from crowdbench.planners.base import Planner
from crowdbench.planners.lookahead import ValuePlanner
from crowdbench.predict import ConstantVelocity
from crowdbench.scenario.cases import Cases
from crowdbench.sim.sensor import observe
from crowdbench.types import Observation
from crowdbench.value.networks import SARL

CROWDNAV_SECONDS = {5: 0.037, 10: 0.067}
"""Seconds that CrowdNav's code took for a decision of SARL, by number of pedestrians. Recorded once, not measured
here."""

SARL_SGAN_KCE_PEDESTRIANS = 5

SEQUENCE = 8
"""Commands of a decision of SARL-SGAN-SEQ."""


def measure_sarl_batch(worlds: int = 500, rounds: int = 5) -> Iterator[Measurement]:
    """Decisions of SARL-CVM for many worlds at once, per world.

    Args:
        worlds: Number of worlds.
        rounds: How many times the decision is measured.
    """
    for pedestrians in CROWDNAV_SECONDS:
        [took] = in_turns(rounds, functools.partial(seconds, sarl_decision(pedestrians, worlds)))
        yield _sarl(f"{worlds} worlds at once, per world", took / worlds, pedestrians)


def measure_sarl_single(decisions: int = 300) -> Iterator[Measurement]:
    """Decisions of SARL-CVM for one world at a time.

    Args:
        decisions: Number of decisions, each in another world.
    """
    planner = ValuePlanner(ConstantVelocity(), SARL())
    for pedestrians in CROWDNAV_SECONDS:
        yield _sarl("one world", one_by_one(planner, observation(pedestrians, decisions)), pedestrians)


def measure_share_of_limit(worlds: int = 500, size: int = 1024, rounds: int = 10) -> Iterator[Measurement]:
    """The operations per second of a large matrix product, and which share of them a decision of SARL-CVM reaches.

    A network consists of matrix products, so that none can be faster than the large one.

    Args:
        worlds: Number of worlds of the decision.
        size: Rows and columns of the matrices.
        rounds: How many times both are measured, by turns.
    """
    matrix = torch.rand(size, size)
    works: list[Callable[[], object]] = [functools.partial(torch.mm, matrix, matrix), sarl_decision(5, worlds)]
    took = in_turns(rounds, *(functools.partial(seconds, work) for work in works))
    limit, reached = (operations(work) / time / 1e9 for work, time in zip(works, took, strict=True))
    yield Measurement(f"matrix product of {size} x {size} float32, the limit", limit, "GFLOP/s")
    work = f"share of that limit: SARL decision, 5 pedestrians, {worlds} worlds"
    yield Measurement(work, 100 * reached / limit, "%")


def measure_sarl_sgan_kce_batch(worlds: int = 500, rounds: int = 5, **options: Any) -> Iterator[Measurement]:
    """Decisions of SARL-SGAN-KCE for many worlds at once, per world.

    Args:
        worlds: Number of worlds.
        rounds: How many times the decision is measured.
        options: Options of the planner.
    """
    _, planner = load_planner("sarl_sgan_kce", options)
    decide = functools.partial(planner.plan, observation(SARL_SGAN_KCE_PEDESTRIANS, worlds))
    [took] = in_turns(rounds, functools.partial(seconds, decide))
    yield _sarl_sgan_kce(f"{worlds} worlds at once, per world", took / worlds)


def measure_sarl_sgan_kce_single(decisions: int = 100, **options: Any) -> Iterator[Measurement]:
    """Decisions of SARL-SGAN-KCE for one world at a time.

    Args:
        decisions: Number of decisions, each in another world.
        options: Options of the planner.
    """
    _, planner = load_planner("sarl_sgan_kce", options)
    yield _sarl_sgan_kce("one world", one_by_one(planner, observation(SARL_SGAN_KCE_PEDESTRIANS, decisions)))


def measure_sarl_sgan_seq_batch(worlds: int = 500, rounds: int = 3, **options: Any) -> Iterator[Measurement]:
    """Decisions of SARL-SGAN-SEQ, of eight commands each, for many worlds at once, per world.

    Args:
        worlds: Number of worlds.
        rounds: How many times the decision is measured.
        options: Options of the planner.
    """
    _, planner = load_planner("sarl_sgan_seq", options)
    decide = functools.partial(planner.plan_ahead, observation(SARL_SGAN_KCE_PEDESTRIANS, worlds), SEQUENCE)
    [took] = in_turns(rounds, functools.partial(seconds, decide))
    work = f"SARL-SGAN-SEQ decision of {SEQUENCE} commands, {SARL_SGAN_KCE_PEDESTRIANS} pedestrians, 20 futures"
    yield Measurement(f"{work}, {worlds} worlds at once, per world", 1e3 * took / worlds, "ms")


def sarl_decision(pedestrians: int, worlds: int) -> Callable[[], object]:
    """A decision of SARL-CVM for many worlds at once.

    Args:
        pedestrians: Number of pedestrians in each world.
        worlds: Number of worlds.

    Returns:
        A function that makes the decision.
    """
    planner = ValuePlanner(ConstantVelocity(), SARL())
    return functools.partial(planner.plan, observation(pedestrians, worlds))


def one_by_one(planner: Planner, obs: Observation) -> float:
    """The median time in seconds of a decision for one world.

    Args:
        planner: The planner.
        obs: The worlds; the planner decides for each by itself.
    """
    works = [functools.partial(planner.plan, obs.take(slice(row, row + 1))) for row in range(len(obs))]
    return median(map(seconds, works))


def operations(work: Callable[[], object]) -> int:
    """The multiplications and additions in all matrix products that torch computes in a call."""
    with FlopCounterMode(display=False) as counter:
        work()
    return counter.get_total_flops()


def observation(pedestrians: int, worlds: int) -> Observation:
    """What the vehicle sees at the start of test cases.

    Args:
        pedestrians: Number of pedestrians in each world.
        worlds: Number of worlds.
    """
    scenario = load_scenario("circle_crossing_5", {"pedestrians.number": pedestrians})
    return observe(scenario.worlds(Cases("test", 0, worlds)))


def _sarl(where: str, took: float, pedestrians: int) -> Measurement:
    work = f"SARL decision, {pedestrians} pedestrians, {where}"
    return Measurement(work, 1e3 * took, "ms", 1e3 * CROWDNAV_SECONDS[pedestrians])


def _sarl_sgan_kce(where: str, took: float) -> Measurement:
    work = f"SARL-SGAN-KCE decision, {SARL_SGAN_KCE_PEDESTRIANS} pedestrians, 20 futures, {where}"
    return Measurement(work, 1e3 * took, "ms")
