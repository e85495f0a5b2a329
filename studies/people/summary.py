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


def summarize(scores: Sequence[WindowScore]) -> dict[str, Figure]:
    """Return the figures of a model, by the names in `STATISTICS`."""
    return _estimate(*_columns(scores))


def compare(scores: Sequence[WindowScore], others: Sequence[WindowScore]) -> dict[str, Figure]:
    """Return the differences of the figures of two models in the same windows."""
    return _estimate(*_columns(scores), *_columns(others))


def _columns(scores: Sequence[WindowScore]) -> list[Columns]:
    thirds = [np.array([each.log[third] for each in scores]) for third in THIRDS]
    return [*thirds, *(np.array([getattr(each, name) for each in scores], float) for name in COUNTS)]


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
    width = len(THIRDS) + len(COUNTS)
    if len(columns) == 2 * width:
        with np.errstate(invalid="ignore"):  # of infinite ratios, without a contact in the recordings
            return _figures(*columns[:width], axis=axis) - _figures(*columns[width:], axis=axis)
    thirds = columns[: len(THIRDS)]
    persons, contacts, recorded, conflicts, closest = (column.sum(axis=axis) for column in columns[len(THIRDS) :])
    with np.errstate(invalid="ignore", divide="ignore"):
        logs = [np.nansum(log, axis=axis) / np.isfinite(log).sum(axis=axis) for log in thirds]
        shares = contacts / persons, contacts / recorded, closest / conflicts
    return np.stack([np.exp(np.mean(logs, axis=0)), *np.exp(logs), *shares], axis=-1)
