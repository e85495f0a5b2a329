"""Benchmarks of the time for decisions of planners, and for the training of a learned planner.

SARL's networks have random weights here, which cost as much as trained ones.
"""

from __future__ import annotations

import contextlib
import functools
import time
from collections.abc import Callable, Iterator
from statistics import mean, median
from typing import Any

import numpy as np

from benchmarks.measurement import Measurement, in_turns, seconds
from crowdbench import (
    Cases,
    Observation,
    Planner,
    Scenario,
    ValuePlanner,
    load_planner,
    load_scenario,
    rollout,
)
from crowdbench.isolation import IsolatedPlanner
from crowdbench.networks import SARL
from crowdbench.predict import ConstantVelocity
from crowdbench.sim import observe
from crowdbench.train import EPISODES, ROUND, PPOConfig, PPOTraining, ValueConfig, ValueTraining

CROWDNAV_SECONDS = {5: 0.037, 10: 0.067}
"""Time in seconds of a SARL decision by CrowdNav's code, by number of pedestrians. Recorded once, not measured here."""

SGAN_PEDESTRIANS = 5

AT_ONCE = "{} worlds at once, per world"

SEQUENCE = 8
"""Commands of a decision of SARL-SGAN-SEQ."""

PAPER = ("sarl_lin", "sarl_cvm", "sarl_sgan", "sarl_sgan_kce")
"""The planners of the paper with a predictor."""

PARTS = (1 / 6, 1 / 2, 5 / 6)
"""Shares of the training after which a round is measured: the middles of its thirds, whose mean exploration is the
mean exploration of the training."""

QUICK_PLANNER = "orca"
"""A fast planner, so that the share of the pipes in the time is large."""


def measure_isolation(worlds: int = 500, rounds: int = 7) -> Iterator[Measurement]:
    """Measure rollouts of one batch, with the planner in this process and in a separate process, in turns.

    Args:
        worlds: Number of worlds.
        rounds: Number of measurements of both.
    """
    with contextlib.closing(IsolatedPlanner(QUICK_PLANNER, {})) as isolated_planner:
        scenario, cases = load_scenario("circle_crossing_5"), Cases("val", 0, worlds)
        planners = load_planner(QUICK_PLANNER), isolated_planner
        works = [functools.partial(rollout, planner, scenario, cases) for planner in planners]
        inside, isolated = in_turns(rounds, *(functools.partial(seconds, work) for work in works))
    work = f"rollout of {worlds} worlds, ORCA vehicle"
    yield Measurement(work, 1e3 * inside, "ms")
    level = isolated_planner.usage["level"]
    yield Measurement(f"the same, the vehicle in its own process ({level})", 1e3 * isolated, "ms")
    yield Measurement("more time with the vehicle in its own process", 100 * (isolated / inside - 1), "%")


def measure_sarl(worlds: int = 500, rounds: int = 5, decisions: int = 300) -> Iterator[Measurement]:
    """Measure decisions of SARL-CVM, for many worlds at once and for one world at a time.

    Args:
        worlds: Number of worlds at once.
        rounds: Number of measurements of the decision for all of them.
        decisions: Number of decisions for one world, each for another world.
    """
    decide = ValuePlanner(ConstantVelocity(), SARL()).plan
    for pedestrians in CROWDNAV_SECONDS:
        yield _sarl(AT_ONCE.format(worlds), at_once(decide, pedestrians, worlds, rounds), pedestrians)
    for pedestrians in CROWDNAV_SECONDS:
        yield _sarl("one world", one_by_one(decide, pedestrians, decisions), pedestrians)


def measure_training(episodes: int = EPISODES) -> Iterator[Measurement]:
    """Estimate the duration of a training: imitation, plus the number of rounds times the mean duration of a few.

    Args:
        episodes: Number of episodes of the training. Its validations are not counted.
    """
    training = ValueTraining(ValueConfig(network="sarl", episodes=episodes), "cpu")
    rounds = episodes / ROUND
    imitation = seconds(training.imitate)
    durations = []
    for part in PARTS:
        training.amount = int(part * rounds) * ROUND
        durations.append(seconds(training.improve))
    work = f"training of SARL, {episodes:,} episodes, estimated from imitation and {len(PARTS)} of {rounds:.0f} rounds"
    yield Measurement(work, (imitation + rounds * mean(durations)) / 60, "min")


def measure_ppo_training(steps: int = 60_000) -> Iterator[Measurement]:
    """Measure steps per second of processor time in trainings of policies, without validations and drawing of cases.

    Args:
        steps: Number of steps of each training.
    """
    lean: dict[str, Any] = {"network": "ppo_attention", "reward": "safe_progress", "ppo": {"worlds": 512, "epochs": 2}}
    options: dict[str, dict[str, Any]] = {"circle_crossing_mixed": {"network": "ppo"}, "streams": lean, "corner": lean}
    for scenario, given in options.items():
        training = PPOTraining(PPOConfig(scenario=scenario, steps=10**9, **given), "cpu")
        training.train_until(0.0)  # draws the cases, and updates once
        begin, done = time.process_time(), training.amount
        while training.amount - done < steps:
            training.update()
        speed = (training.amount - done) / (time.process_time() - begin)
        yield Measurement(f"training of {given['network']} in {scenario}, per second of a core", speed, "steps/s")


def measure_large_crowds(cases: int = 40) -> Iterator[Measurement]:
    """Measure the paper's planners in cases with 20 pedestrians.

    Args:
        cases: Number of cases that each planner drives at once.
    """
    scenario, driven = load_scenario("circle_20_blind"), Cases("test", 0, cases)
    for name in PAPER:
        work = functools.partial(rollout, load_planner(name), scenario, driven)
        duration = in_turns(1, functools.partial(seconds, work))[0] / cases
        yield Measurement(f"{name}, 20 pedestrians, {cases} cases at once, per case", duration, "s")


def measure_sarl_sgan_kce(worlds: int = 500, rounds: int = 5, decisions: int = 100) -> Iterator[Measurement]:
    """Measure decisions of SARL-SGAN-KCE, for many worlds at once and for one world at a time.

    Args:
        worlds: Number of worlds at once.
        rounds: Number of measurements.
        decisions: Number of decisions for one world.
    """
    decide, work = load_planner("sarl_sgan_kce").plan, "SARL-SGAN-KCE decision"
    yield _sarl_sgan(work, AT_ONCE.format(worlds), at_once(decide, SGAN_PEDESTRIANS, worlds, rounds))
    yield _sarl_sgan(work, "one world", one_by_one(decide, SGAN_PEDESTRIANS, decisions))


def measure_sarl_sgan_seq(worlds: int = 500, rounds: int = 3) -> Iterator[Measurement]:
    """Measure decisions of SARL-SGAN-SEQ, of eight commands each, for many worlds at once; arguments as above."""
    decide = functools.partial(load_planner("sarl_sgan_seq").plan_ahead, steps=SEQUENCE)
    duration = at_once(decide, SGAN_PEDESTRIANS, worlds, rounds)
    yield _sarl_sgan(f"SARL-SGAN-SEQ decision of {SEQUENCE} commands", AT_ONCE.format(worlds), duration)


def at_once(decide: Callable[[Observation], object], pedestrians: int, worlds: int, rounds: int) -> float:
    """Return the time in seconds, per world, of a decision for many worlds; the median of several rounds."""
    work = functools.partial(decide, observation(pedestrians, worlds))
    return in_turns(rounds, functools.partial(seconds, work))[0] / worlds


def one_by_one(decide: Callable[[Observation], object], pedestrians: int, worlds: int) -> float:
    """Return the median time in seconds of a decision for one world."""
    obs = observation(pedestrians, worlds)
    works = [functools.partial(decide, obs.take(slice(row, row + 1))) for row in range(worlds)]
    return median(map(seconds, works))


class Timed(Planner):
    """Planner that measures the seconds of each decision of another planner."""

    def __init__(self, planner: Planner) -> None:
        self.planner, self.privileged, self.native = planner, planner.privileged, planner.native
        self.seconds: list[float] = []

    def reset(self, rows: np.ndarray) -> None:
        """See `Planner`."""
        self.planner.reset(rows)

    def plan(self, obs: Observation) -> np.ndarray:
        """See `Planner`."""
        start = time.perf_counter()
        command = self.planner.plan(obs)
        self.seconds.append(time.perf_counter() - start)
        return command


def single_world_seconds(
    planner: Planner, scenario: Scenario, cases: Cases, progress: Callable[[float], None]
) -> list[float]:
    """Return the seconds of each decision of a planner, one world at a time.

    Args:
        planner: The planner.
        scenario: The scenario.
        cases: The cases. The first case is driven to warm up and does not count.
        progress: Called after each further case with 1.
    """
    first, *others = cases.batches(1)
    rollout(planner, scenario, first, undisturbed=False)
    timed = Timed(planner)
    for case in others:
        rollout(timed, scenario, case, undisturbed=False)
        progress(1)
    return timed.seconds


def observation(pedestrians: int, worlds: int) -> Observation:
    """Return the observation at the start of test cases.

    Args:
        pedestrians: Number of pedestrians in each world.
        worlds: Number of worlds.
    """
    scenario = load_scenario("circle_crossing_5", {"pedestrians.number": pedestrians})
    return observe(scenario.worlds(Cases("test", 0, worlds)))


def _sarl(where: str, duration: float, pedestrians: int) -> Measurement:
    work = f"SARL decision, {pedestrians} pedestrians, {where}"
    return Measurement(work, 1e3 * duration, "ms", 1e3 * CROWDNAV_SECONDS[pedestrians])


def _sarl_sgan(work: str, where: str, duration: float) -> Measurement:
    return Measurement(f"{work}, {SGAN_PEDESTRIANS} pedestrians, 20 futures, {where}", 1e3 * duration, "ms")
