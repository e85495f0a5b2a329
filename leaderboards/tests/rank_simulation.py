"""Measure error rate and power of ranks, for equal entries and a better one.

python leaderboards/tests/rank_simulation.py [NUMBER]

The success of an entry is 0 or 1 in each case. With some probability an entry takes an outcome of the case that all
entries share. Thus outcomes of two entries have a given correlation, and each entry has the requested success rate.
"""

import sys

import numpy as np

from crowdbench.metrics import compare_all, ranks

CASES = 500
BETTER = 0.02


def simulate(entries, rate, correlation, repetitions, better=0.0, cases=CASES, seed=0):
    """Return shares of boards on which something is said, and the mean width of a rank.

    The first entry succeeds more often than the others by `better`.
    """
    draws = np.random.default_rng([seed, entries])
    wrong, found, better_than, width = np.zeros((4, repetitions))
    for repetition in range(repetitions):
        own = draws.random((entries, cases)) < rate
        shared = draws.random((entries, cases)) < np.sqrt(correlation)
        success = np.where(shared, draws.random(cases) < rate, own)
        success[0] |= draws.random(cases) < better / (1.0 - rate)
        names = [str(number) for number in range(entries)]
        pairs = compare_all(dict(zip(names, success[:, None, None].astype(float), strict=True)), np.ones(1))
        rank = ranks(names, pairs)
        other = [pair for pair in pairs if better > 0.0 and "0" in (pair.higher, pair.lower)]
        equal = [pair for pair in pairs if pair not in other]
        wrong[repetition] = any(pair.is_sure for pair in equal)
        found[repetition] = rank["0"].last == 1
        better_than[repetition] = np.mean([pair.is_sure and pair.higher == "0" for pair in other or pairs])
        width[repetition] = np.mean([each.last - each.first for each in rank.values()])
    return {
        "a false sure pair": wrong.mean(),
        "the first is the only best": found.mean(),
        "the first is surely better than another": better_than.mean(),
        "width of a rank": width.mean(),
    }


def main(repetitions=1000):
    """Print the shares of boards for equal entries, and for one that is better by 2 points."""
    for entries in (3, 7, 12):
        for rate, correlation in ((0.97, 0.3), (0.99, 0.2)):
            for better in (0.0, BETTER) if rate == 0.97 else (0.0,):
                for cases in (500, 1000):
                    found = simulate(entries, rate, correlation, repetitions, better, cases)
                    said = ", ".join(f"{name} {share:.3f}" for name, share in found.items())
                    print(
                        f"{entries} entries, {rate}, correlation {correlation}, {cases} cases, +{better}: {said}",
                        flush=True,
                    )


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
