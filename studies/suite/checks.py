"""The conditions that the suite must meet, and their results; `conditions.md` explains them."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.stats import rankdata

from crowdbench.metrics import bootstrap_distribution, info_of, interval
from crowdbench.utils import Flag, Grid, Name, TomlTable, number
from studies.suite.rank import compare, order
from studies.suite.standing import Standing

SCORE = info_of("score")

BEST, DECIDED, RELIABLE, ALIKE = 0.90, 0.70, 0.80, 0.95
"""Largest score of the best planner of a scenario, least share of decided pairs, least reliability of the order, and
largest rank correlation of two scenarios."""

LEADERS, HALVES = 5, 1000
"""Number of planners whose order is tested, and of the random halves of cases on which it is."""

Standings = Mapping[str, Standing]


class AttackSpec(TomlTable):
    """`[[attacks]]`: a planner that tries to buy its score, and the least difference to an honest one.

    Attributes:
        planner: The attack, one of the planners.
        below: The planner that must be better; `best` is the best of all planners that are no attacks.
        least: The least difference of the mean scores.
        bound: True if the lower bound of the difference must reach it, False if the difference must.
    """

    planner: Name
    below: Name
    least: float = number(0.0, least=0.0, below=1.0)
    bound: Flag = False


@dataclass(frozen=True)
class Result:
    """The result of a condition.

    Attributes:
        condition: The condition in a few words.
        figure: The measured figure.
        holds: True if the condition holds.
    """

    condition: str
    figure: str
    holds: bool


def check_track(standings: Standings, names: Sequence[str]) -> list[Result]:
    """Check the conditions on planners that are no attacks, in a track."""
    checks: list[Callable[[Standings, Sequence[str]], Result]] = [
        check_best,
        check_decided,
        check_reliability,
        check_correlations,
        check_straight,
    ]
    return [check(standings, names) for check in checks]


def check_best(standings: Standings, names: Sequence[str]) -> Result:
    """Check that the best planner of each scenario is not above `BEST`."""
    highest = scenario_scores(standings).max(axis=0)
    worst = int(highest.argmax())
    figure = f"{SCORE.number(highest[worst])} in {names[worst]}"
    return Result(f"best planner of each scenario at most {BEST:.2f}", figure, bool(highest[worst] <= BEST))


def check_decided(standings: Standings, names: Sequence[str]) -> Result:
    """Check that most pairs of planners are decided."""
    pairs = compare(standings)
    decided = sum(pair.is_sure for pair in pairs)
    figure = f"{decided} of {len(pairs)} ({100.0 * decided / len(pairs):.0f} %)"
    return Result(f"pairs decided, at least {100.0 * DECIDED:.0f} %", figure, decided >= DECIDED * len(pairs))


def check_reliability(standings: Standings, names: Sequence[str]) -> Result:
    """Check that the leading planners have the same order on both halves of the cases."""
    mean = reliability([standings[name] for name in order(standings)[:LEADERS]])
    condition = f"split-half reliability of the leading {LEADERS} at least {RELIABLE:.1f}"
    return Result(condition, f"{mean:.2f}", mean >= RELIABLE)


def reliability(standings: Sequence[Standing]) -> float:
    """Return the mean rank correlation of the mean scores between random halves of the cases of each scenario."""
    scores = np.array([each.score.mean(axis=0) for each in standings])
    draws = np.random.default_rng(0)
    cases = np.broadcast_to(np.arange(scores.shape[2]), scores.shape[1:])
    means = []
    for _ in range(HALVES):
        mixed = np.take_along_axis(scores, draws.permuted(cases, axis=1)[None], axis=2)
        means.append([half.mean(axis=(1, 2)) for half in np.array_split(mixed, 2, axis=2)])
    first, second = rankdata(means, axis=2).swapaxes(0, 1)
    return float(np.mean([np.corrcoef(a, b)[0, 1] for a, b in zip(first, second, strict=True)]))


def check_correlations(standings: Standings, names: Sequence[str]) -> Result:
    """Check that no two scenarios order planners alike."""
    correlation = correlations(standings)
    pairs = {(a, b): correlation[a, b] for a, b in itertools.combinations(range(len(names)), 2)}
    (a, b), most = max(pairs.items(), key=lambda item: item[1])
    condition = f"rank correlation of any two scenarios at most {ALIKE:.2f}"
    return Result(condition, f"{most:.2f} of {names[a]} and {names[b]}", bool(most <= ALIKE))


def check_straight(standings: Standings, names: Sequence[str]) -> Result:
    """Check that the planner that drives straight ahead is one of the last two."""
    place = 1 + order(standings).index("straight")
    return Result("`straight` last or second to last", f"{place} of {len(standings)}", place >= len(standings) - 1)


def check_attack(attack: AttackSpec, honest: Standings, everybody: Standings) -> Result:
    """Check that an attack has a clearly lower score than an honest planner."""
    better = order(honest)[0] if attack.below == "best" else attack.below
    difference = everybody[better].score.mean(axis=0) - everybody[attack.planner].score.mean(axis=0)
    resampled = [bootstrap_distribution(np.mean, scenario) for scenario in difference]
    low, high = interval(np.mean(resampled, axis=0))
    mean = float(difference.mean())
    condition = f"`{attack.planner}` at least {attack.least:.2f} below `{better}`"
    condition += " (lower bound)" if attack.bound else ""
    holds = (low if attack.bound else mean) >= attack.least
    return Result(condition, f"{mean:.3f} ({low:.3f} to {high:.3f})", bool(holds))


def scenario_scores(standings: Standings) -> Float[np.ndarray, "planner scenario"]:
    """Return the mean score of each planner in each scenario."""
    return np.array([each.score.mean(axis=(0, 2)) for each in standings.values()])


def correlations(standings: Standings) -> Float[np.ndarray, "scenario scenario"]:
    """Return Spearman's rank correlations of scenarios over planners."""
    return np.corrcoef(rankdata(scenario_scores(standings), axis=0), rowvar=False)


def best_grid(track: str, standings: Standings, names: Sequence[str]) -> Grid:
    """Return the best planner of each scenario."""
    scores, planners = scenario_scores(standings), list(standings)
    best = scores.argmax(axis=0).tolist()
    rows = [
        [name, planners[k], SCORE.number(scores[k, column])]
        for column, (name, k) in enumerate(zip(names, best, strict=True))
    ]
    return Grid(f"Best planners with {track} sensing", ["scenario", "planner", "score"], rows)


def correlation_grid(track: str, standings: Standings, names: Sequence[str]) -> Grid:
    """Return the rank correlations of scenarios."""
    rows = [
        [name, *(f"{value:.2f}" for value in row)] for name, row in zip(names, correlations(standings), strict=True)
    ]
    return Grid(f"Rank correlations with {track} sensing", ["scenario", *names], rows)
