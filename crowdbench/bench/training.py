"""How long a training of SARL takes, estimated from parts of one."""

from __future__ import annotations

from collections.abc import Iterator
from statistics import mean

from crowdbench.bench.measurement import Measurement
from crowdbench.bench.timing import seconds
from crowdbench.catalog import load_scenario
from crowdbench.predict import Oracle
from crowdbench.train import value as method
from crowdbench.train.value_request import EPISODES

PARTS = (1 / 6, 1 / 2, 5 / 6)
"""Shares of the training after which a round is measured: the middles of its thirds, whose mean exploration is the
mean exploration of the training."""


def measure_training(episodes: int = EPISODES) -> Iterator[Measurement]:
    """The length of a training: its imitation, and as many rounds as it has of the mean length of a few.

    Args:
        episodes: Number of episodes of the training. Its validations are not counted.
    """
    scenario = load_scenario("circle_crossing_mixed")
    setup = method.Setup("sarl", scenario, Oracle(), None, [scenario], 0, episodes, minutes=None, device="cpu")
    training = method.Training(setup)
    rounds = episodes / method.ROUND
    imitation = seconds(training.imitate)
    driven = []
    for part in PARTS:
        training.rounds = int(part * rounds)
        driven.append(seconds(training.improve))
    work = f"training of SARL, {episodes:,} episodes, estimated from imitation and {len(PARTS)} of {rounds:.0f} rounds"
    yield Measurement(work, (imitation + rounds * mean(driven)) / 60, "min")
