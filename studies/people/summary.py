"""Scores over windows, with intervals and paired differences. See definition.md."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from crowdbench.metrics import bootstrap_distribution, include_mean, interval
from studies.people.likelihood import THIRDS, WindowScore

Columns = Float[np.ndarray, "*resample window"]
Statistics = Float[np.ndarray, "*resample statistic"]

STATISTICS = ("v3", *THIRDS, "contacts", "ratio", "closest")
"""The score, its thirds, the share of persons with a new contact, its ratio to the recorded share, and the mean closest
approach in metres."""

COUNTS = ("persons", "contacts", "recorded_contacts", "conflicts", "closest")
"""Fields of `WindowScore` that are summed over windows."""


class Figure(NamedTuple):
    """A figure with its 95 % interval over windows."""

    value: float
    low: float
    high: float


def summarize(scores: Sequence[WindowScore], blocks: Sequence[str] | None = None) -> dict[str, Figure]:
    """Return the figures of a model, by the names in `STATISTICS`.

    Args:
        scores: Its score in each window.
        blocks: The block of each window: whole blocks are resampled. By default each window is a block.
    """
    return _estimate(*_columns(scores, blocks))


def figures(scores: Sequence[WindowScore]) -> dict[str, float]:
    """Return the figures of a model without intervals."""
    return dict(zip(STATISTICS, _figures(*_columns(scores, None), axis=-1).tolist(), strict=True))


def compare(
    scores: Sequence[WindowScore], others: Sequence[WindowScore], blocks: Sequence[str] | None = None
) -> dict[str, Figure]:
    """Return the differences of the figures of two models in the same windows; see `summarize`."""
    return _estimate(*_columns(scores, blocks), *_columns(others, blocks))


def _columns(scores: Sequence[WindowScore], blocks: Sequence[str] | None) -> list[Columns]:
    """Return sums over the windows of each block: of logarithms and of windows by third, and of `COUNTS`."""
    logs = [np.array([each.log[third] for each in scores]) for third in THIRDS]
    columns = [column for log in logs for column in (np.nan_to_num(log), np.isfinite(log).astype(float))]
    columns += [np.array([getattr(each, name) for each in scores], float) for name in COUNTS]
    if blocks is None:
        return columns
    _, number = np.unique(blocks, return_inverse=True)
    return [np.bincount(number, column) for column in columns]


def _estimate(*columns: Columns) -> dict[str, Figure]:
    values = _figures(*columns, axis=-1)
    resampled = bootstrap_distribution(_figures, *columns)
    return {
        name: Figure(float(value), *include_mean(float(value), *interval(draws[np.isfinite(draws)])))
        if np.isfinite(value)
        else Figure(np.nan, np.nan, np.nan)
        for name, value, draws in zip(STATISTICS, values, resampled.T, strict=True)
    }


def _figures(*columns: Columns, axis: int) -> Statistics:
    """Return the figures of one model, or the differences between two models."""
    width = 2 * len(THIRDS) + len(COUNTS)
    if len(columns) == 2 * width:
        with np.errstate(invalid="ignore"):  # of infinite ratios, without a contact in the recordings
            return _figures(*columns[:width], axis=axis) - _figures(*columns[width:], axis=axis)
    sums = [column.sum(axis=axis) for column in columns]
    of_thirds, (persons, contacts, recorded, conflicts, closest) = sums[: -len(COUNTS)], sums[-len(COUNTS) :]
    with np.errstate(invalid="ignore", divide="ignore"):
        logs = [log / windows for log, windows in zip(of_thirds[::2], of_thirds[1::2], strict=True)]
        shares = contacts / persons, contacts / recorded, closest / conflicts
    return np.stack([np.exp(np.mean(logs, axis=0)), *np.exp(logs), *shares], axis=-1)
