"""Orders of planners by their mean values in scenarios: resamples of cases and planners, and pairs that are decided."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from crowdbench.runs import Run
from studies.folder import read_episodes

RESAMPLES = 2000

CERTAIN = 1.96
"""A pair is decided if its means differ by more than this number of standard errors."""

Means = Float[np.ndarray, "*resample planner"]
"""The mean scores or success rates of planners; in resamples, of cases that were drawn with replacement."""


@dataclass(frozen=True)
class Cases:
    """Outcomes of planners in the cases of a scenario.

    Attributes:
        source: Source of its pedestrians: scenarios of the same recording have it in common. Their blocks are drawn
            together.
        value: The score of a planner in a case, or 1 if it succeeds and 0 otherwise.
        block: The block of each case. Cases of the same block are drawn together.
    """

    source: str
    value: Float[np.ndarray, "planner case"]
    block: Int[np.ndarray, "case"]

    def resample(self) -> Means:
        """Return the mean value of each planner in the cases, which comes first, and in `RESAMPLES` resamples."""
        blocks = len(np.unique(self.block))
        times = np.ones((1 + RESAMPLES, blocks))
        times[1:] = self._draws().multinomial(blocks, np.full(blocks, 1.0 / blocks), size=RESAMPLES)
        return self._means(times)

    def halves(self, splits: int) -> Float[np.ndarray, "half split planner"]:
        """Return the mean values in random halves of the blocks; without two blocks, NaN."""
        blocks = len(np.unique(self.block))
        chosen = np.broadcast_to(np.arange(blocks) < blocks // 2, (splits, blocks))
        first = self._draws().permuted(chosen, axis=1).astype(float)
        return np.stack([self._means(first), self._means(1.0 - first)])

    def _draws(self) -> np.random.Generator:
        """Return a generator that is seeded by the source: the same hours are drawn in two scenarios of a recording."""
        return np.random.default_rng([*self.source.encode()])

    def _means(self, times: Float[np.ndarray, "resample block"]) -> Means:
        """Return the means if each block counts so many times."""
        _, number = np.unique(self.block, return_inverse=True)
        sums = np.zeros((times.shape[1], len(self.value)))
        np.add.at(sums, number, self.value.T)
        with np.errstate(invalid="ignore"):
            return times @ sums / (times @ np.bincount(number))[:, None]


def read_cases(runs: Sequence[Run], out: Path) -> Cases:
    """Return the scores of planners in the cases of a scenario. Raises InputError if a run is missing."""
    found = [read_episodes(run, out) for run in runs]
    value = np.stack([each.columns["score"].astype(float) for each in found])
    block, tracks = found[0].block, runs[0].scenario.tracks
    source = tracks.scene if tracks else runs[0].scenario.name
    return Cases(source, value, np.arange(value.shape[1]) if block is None else block)


def resample_means(scenarios: Sequence[Cases]) -> Means:
    """Return the means over equally weighted scenarios, first of all cases and then of the resamples."""
    return np.mean([each.resample() for each in scenarios], axis=0)


def draw_pairs(planners: int) -> Float[np.ndarray, "resample pair"]:
    """Return the weight of each pair of planners, first in the sample and then in resamples of planners.

    A planner that is drawn twice counts as two: its pairs count twice, and there is no pair between the two.
    """
    one, other = np.triu_indices(planners, 1)
    draws = np.random.default_rng(0)
    times = np.ones((1 + RESAMPLES, planners))
    times[1:] = draws.multinomial(planners, np.full(planners, 1.0 / planners), size=RESAMPLES)
    return times[:, one] * times[:, other]


def differences(means: Means) -> Float[np.ndarray, "*resample pair"]:
    """Return the difference of the means of each pair of planners."""
    one, other = np.triu_indices(means.shape[-1], 1)
    return means[..., one] - means[..., other]


def decided_signs(means: Means) -> Float[np.ndarray, "resample pair"]:
    """Return the sign of each difference of means; 0 if it is at most `CERTAIN` standard errors.

    Args:
        means: A result of `resample_means`. The standard error is the deviation over the resamples.
    """
    found = differences(means)
    return np.where(np.abs(found) > CERTAIN * found[1:].std(axis=0), np.sign(found), 0.0)


def agreement(a: Means, b: Means) -> tuple[int, int]:
    """Return the number of pairs with the same order in two rankings, and the number of pairs that are decided in both.

    Args:
        a: The means of one, a result of `resample_means`.
        b: The means of the other.
    """
    same = decided_signs(a)[0] * decided_signs(b)[0]
    return int((same > 0.0).sum()), int((same != 0.0).sum())
