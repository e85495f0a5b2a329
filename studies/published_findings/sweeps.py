"""Sweeps: the success of several planners at several levels of a scenario, and its correlation with the level."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from pydantic import Field
from scipy.stats import rankdata

from crowdbench.metrics import Estimate, MetricInfo, interval
from crowdbench.runs import Run, RunSpec, load_run
from crowdbench.utils import Grid, Location, Name, TomlTable, Values
from studies.pages import SUCCESS, read_successes
from studies.published_findings.claims import Assessment, ClaimSpec
from studies.schema import CasesText, Planners

CORRELATION = MetricInfo("rank correlation", digits=3)

RESAMPLES = 2000
"""Number of samples of planners and scenes for the interval of a correlation."""


class LevelSpec(TomlTable):
    """A level: the quantity that varies, and the keys of the scenario that set it."""

    value: float
    overrides: Values


class SweepSpec(TomlTable):
    """`[[findings.sweeps]]`: planners at levels of a scenario, and claims about the correlation with success."""

    title: Name
    scenario: Name
    cases: CasesText
    planners: Planners
    levels: list[LevelSpec] = Field(min_length=3, description="three tables or more")
    claims: list[ClaimSpec] = Field(min_length=1, description="one table or more")


@dataclass(frozen=True)
class Sweep:
    """A sweep with its runs by planner and level."""

    spec: SweepSpec
    by_planner: list[list[Run]]

    @classmethod
    def load(cls, spec: SweepSpec, location: Location) -> Sweep:
        """Plan the runs. Raises InputError if a planner or the scenario does not exist."""
        runs = []
        for each in spec.planners:
            base = RunSpec(each.planner, spec.scenario, spec.cases, options=each.options, record="none")
            with location.named():
                runs.append([load_run(replace(base, overrides=level.overrides)) for level in spec.levels])
        return cls(spec, runs)

    @property
    def runs(self) -> list[Run]:
        """All runs that it needs."""
        return [run for of_planner in self.by_planner for run in of_planner]

    def fill(self, out: Path) -> tuple[list[Assessment], Grid]:
        """Return the claims with their figures, and the table of successes, from the runs in the folder `out`."""
        success = np.array([[read_successes(run, out) for run in runs] for runs in self.by_planner], float)
        levels = np.array([level.value for level in self.spec.levels])
        figure = correlate(success, levels)
        claims = [Assessment(claim, CORRELATION, figure) for claim in self.spec.claims]
        return claims, self._grid(success.mean(axis=2), levels)

    def _grid(self, rates: Float[np.ndarray, "planner level"], levels: Float[np.ndarray, "level"]) -> Grid:
        """Return the table of success rates, with the rank correlation of each planner."""
        rows = [
            [each.planner, *map(SUCCESS.number, row), CORRELATION.number(float(rank_correlation(row, levels)))]
            for each, row in zip(self.spec.planners, rates, strict=True)
        ]
        header = ["planner", *(f"{level:g}" for level in levels), "rank correlation"]
        plain = np.corrcoef(np.broadcast_to(levels, rates.shape).ravel(), rates.ravel())[0, 1]
        cases = f"On {self.spec.scenario}, cases {self.spec.cases} of each level."
        note = f"{cases} Pearson's correlation over all pairs is {CORRELATION.number(plain)}."
        return Grid(f"Success in % by {self.spec.title}", header, rows, note=note)


def correlate(success: Float[np.ndarray, "planner level case"], levels: Float[np.ndarray, "level"]) -> Estimate:
    """Return the rank correlation of levels and success rates, over all pairs of a planner and a level.

    Args:
        success: 1 for a success, 0 for a failure.
        levels: The quantity at each level.

    Returns:
        The correlation, with a percentile interval over resampled planners and resampled scenes of each level.
    """
    planners, _, cases = success.shape
    draws = np.random.default_rng(0)
    counts = draws.multinomial(cases, np.full(cases, 1.0 / cases), (RESAMPLES, len(levels)))
    rates = np.einsum("rlc,plc->rpl", counts / cases, success)
    chosen = draws.integers(0, planners, (RESAMPLES, planners))
    resampled = rank_correlation(np.take_along_axis(rates, chosen[..., None], axis=1), levels)
    mean = float(rank_correlation(success.mean(axis=2), levels))
    return Estimate(mean, *interval(resampled), planners * len(levels), 1.0)


def rank_correlation(
    rates: Float[np.ndarray, "*batch planner level"] | Float[np.ndarray, "level"], levels: Float[np.ndarray, "level"]
) -> Float[np.ndarray, "*batch"]:
    """Return Spearman's rank correlation of rates with levels, over all planners and levels; NaN for equal rates."""
    rates = np.atleast_2d(rates)
    pairs = np.prod(rates.shape[-2:])
    x = rankdata(np.broadcast_to(levels, rates.shape[-2:]))
    y = rankdata(rates.reshape(*rates.shape[:-2], pairs), axis=-1)
    x, y = x.ravel() - x.mean(), y - y.mean(axis=-1, keepdims=True)
    size = np.sqrt((x**2).sum() * (y**2).sum(axis=-1))
    return (x * y).sum(axis=-1) / np.where(size > 0.0, size, np.nan)
