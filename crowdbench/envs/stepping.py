"""What the environments share: which case an episode is, its world, and what an action may be."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from gymnasium.error import ResetNeeded
from jaxtyping import Float

from crowdbench.catalog import load_scenario
from crowdbench.errors import InputError
from crowdbench.scenario.cases import parse_case
from crowdbench.scenario.scenario import Scenario
from crowdbench.types import Outcome, World

TRAINING_CASES = 2**32
"""Episodes are drawn from this many training cases."""

LABELS = tuple(outcome.label for outcome in Outcome)
"""The word for each outcome, by its number."""


def as_scenario(scenario: str | Path | Scenario) -> Scenario:
    """A scenario by name, by the path of its file, or as it is. Raises InputError where there is none."""
    return scenario if isinstance(scenario, Scenario) else load_scenario(str(scenario))


def chosen_case(case: object, generator: np.random.Generator) -> str:
    """The case that `reset` was asked for, such as `test:37`, or a training case drawn where that is None."""
    return f"train:{generator.integers(TRAINING_CASES)}" if case is None else str(case)


def require_reset(case: str) -> None:
    """Raise Gymnasium's ResetNeeded where there is no case yet."""
    if not case:
        raise ResetNeeded("call reset() first")


def start(scenario: Scenario, cases: Sequence[str]) -> World:
    """The start of the named cases, in their order. Raises InputError where a name is none of a case."""
    splits, numbers = zip(*map(parse_case, cases), strict=True)
    number = np.array(numbers, np.int64)
    worlds = scenario.draw(splits[0], number)
    for split in set(splits[1:]) - {splits[0]}:
        rows = np.flatnonzero(np.array(splits) == split)
        worlds = worlds.put(rows, scenario.draw(split, number[rows]))
    return worlds


def velocities(actions: object, shape: tuple[int, ...]) -> Float[np.ndarray, "*shape"]:
    """Actions as velocities in m/s. Raises InputError where they are no finite numbers in that shape."""
    asked = np.asarray(actions, np.float64)
    if asked.shape != shape or not np.isfinite(asked).all():
        raise InputError(f"an action is a finite velocity (vx, vy) in m/s, but these are {actions!r}")
    return asked
