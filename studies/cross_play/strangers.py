"""Scores of vehicles among strangers, and how much a crowd that a vehicle knows overstates them."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from crowdbench.metrics import UNDEFINED, Estimate, bootstrap, compare_all, info_of, mean_over_networks, ranks
from crowdbench.utils import Grid

SCORE, DELAY = info_of("score"), info_of("imposed_delay")

Values = Float[np.ndarray, "case"]
Crossed = Mapping[str, Mapping[str, Values]]
"""Values of a metric by vehicle and crowd, in the same cases."""

Known = Mapping[str, Collection[str]]
"""The crowds that each vehicle knows."""


@dataclass(frozen=True)
class Standing:
    """A vehicle among strangers, and in crowds that it knows.

    Attributes:
        rank: Its rank by the mean score among strangers.
        strangers: Its mean score over crowds that it does not know.
        worst: Its mean score in the worst of these crowds, and the name of the crowd.
        delay: The mean over these crowds of the delay that it imposes; NaN if it has no success in one of them.
        known: Its mean score over crowds that it knows, undefined without one.
        excess: The score in crowds that it knows minus that among strangers, paired by case.
        familiarity: The excess minus the mean excess of vehicles that know no crowd, for the same crowds.
    """

    rank: str
    strangers: Estimate
    worst: tuple[float, str]
    delay: float
    known: Estimate = UNDEFINED
    excess: Estimate = UNDEFINED
    familiarity: Estimate = UNDEFINED


def standings(scores: Crossed, delays: Crossed, known: Known) -> dict[str, Standing]:
    """Return the standing of each vehicle, the highest mean score among strangers first.

    Args:
        scores: The scores.
        delays: The imposed delays, NaN without success.
        known: The crowds that each vehicle knows.
    """
    strangers = {vehicle: [crowd for crowd in row if crowd not in known[vehicle]] for vehicle, row in scores.items()}
    means = {vehicle: _mean(row, strangers[vehicle]) for vehicle, row in scores.items()}
    order = sorted(means, key=lambda vehicle: -means[vehicle].mean())
    # The mean over strangers counts as one scenario, because vehicles have different strangers.
    pairs = compare_all({vehicle: values[None, None] for vehicle, values in means.items()}, np.ones(1))
    rank, found = ranks(order, pairs), {}
    for vehicle in order:
        row, own = scores[vehicle], known[vehicle]
        gains = []
        if own:
            gain = excess(row, own)
            gains = [_mean(row, own), gain, gain - _usual(scores, known, own)]
        found[vehicle] = Standing(
            str(rank[vehicle]),
            _estimate(means[vehicle]),
            min((float(row[crowd].mean()), crowd) for crowd in strangers[vehicle]),
            float(np.mean([_defined_mean(delays[vehicle][crowd]) for crowd in strangers[vehicle]])),
            *map(_estimate, gains),
        )
    return found


def excess(row: Mapping[str, Values], own: Collection[str]) -> Values:
    """Return the mean score over crowds that a vehicle knows minus that over all others, by case."""
    return _mean(row, own) - _mean(row, [crowd for crowd in row if crowd not in own])


def self_play(scores: Crossed, pairs: Mapping[str, str], known: Known) -> dict[str, Estimate]:
    """Return scores of vehicles that learned together with their crowds, as means over their networks.

    Args:
        scores: The scores.
        pairs: The crowd of each of these vehicles, which differ in the seed of their training.
        known: The crowds that each vehicle knows.

    Returns:
        The score in the vehicle's crowd (`own`), and in all crowds but its own (`strangers`). `excess` and
        `familiarity` are as in `Standing`.
    """
    parts: dict[str, list[Values]] = {}
    for vehicle, crowd in pairs.items():
        row = scores[vehicle]
        gain = excess(row, [crowd])
        values = {
            "own": row[crowd],
            "strangers": row[crowd] - gain,
            "excess": gain,
            "familiarity": gain - _usual(scores, known, [crowd]),
        }
        for name, each in values.items():
            parts.setdefault(name, []).append(each)
    return {name: mean_over_networks(np.stack(each)) for name, each in parts.items()}


def table(found: Mapping[str, Standing]) -> Grid:
    """Return the table of vehicles. The argument is the return value of `standings`."""
    rows = []
    for vehicle, each in found.items():
        score, crowd = each.worst
        cells = [each.rank, SCORE.estimate(each.strangers), f"{SCORE.number(score)} {crowd}", DELAY.number(each.delay)]
        rows.append([vehicle, *cells, *map(SCORE.estimate, (each.known, each.excess, each.familiarity))])
    header = ["vehicle", "rank", "strangers", "worst strangers", DELAY.heading, "known crowds", "excess", "familiarity"]
    return Grid("Vehicles among strangers", header, rows, list(found.values()))


def _usual(scores: Crossed, known: Known, own: Collection[str]) -> Values:
    """Return the mean excess of vehicles that know no crowd, for the crowds that another vehicle knows."""
    return np.asarray(np.mean([excess(row, own) for vehicle, row in scores.items() if not known[vehicle]], axis=0))


def _mean(row: Mapping[str, Values], crowds: Iterable[str]) -> Values:
    return np.asarray(np.mean([row[crowd] for crowd in crowds], axis=0))


def _defined_mean(values: Values) -> float:
    defined = values[~np.isnan(values)]
    return float(defined.mean()) if len(defined) else float("nan")


def _estimate(values: Values) -> Estimate:
    return bootstrap(values, np.ones(len(values)))
