"""What all environments share: the choice of a case, its world, and the check of actions."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.error import ResetNeeded
from jaxtyping import Float

from crowdbench.catalog import load_scenario
from crowdbench.errors import InputError
from crowdbench.scenario.cases import parse_case
from crowdbench.scenario.scenario import Scenario
from crowdbench.types import Outcome, World

TRAINING_CASES = 2**32
"""Without `options={"case": ...}`, `reset` draws one of this many training cases."""

LABELS = tuple(outcome.label for outcome in Outcome)
"""The name of each `Outcome` in infos, by its number."""


def as_scenario(scenario: str | Path | Scenario) -> Scenario:
    """Load a scenario by its name or by the path of its file, or return the given one.

    Raises InputError where there is no such scenario.
    """
    return scenario if isinstance(scenario, Scenario) else load_scenario(str(scenario))


def checked_options(options: Mapping[str, Any] | None, *names: str) -> Mapping[str, Any]:
    """The options of a `reset`, none if it was given None.

    Args:
        options: What was given.
        names: The options that there are.

    Raises:
        InputError: There is another one among them.
    """
    options = options or {}
    for name in options:
        if name not in names:
            raise InputError(f"reset has no option {name!r}; its options are: {', '.join(names)}")
    return options


def chosen_case(case: object, generator: np.random.Generator) -> str:
    """The case of a new episode.

    Args:
        case: The case that `reset` was asked for, such as `test:37`, or None.
        generator: Draws a training case where that is None.
    """
    return f"train:{generator.integers(TRAINING_CASES)}" if case is None else str(case)


def require_reset(case: str) -> None:
    """Raise Gymnasium's `ResetNeeded` if the environment was never reset, so that its case is empty."""
    if not case:
        raise ResetNeeded("call reset() first")


def start(scenario: Scenario, cases: Sequence[str]) -> World:
    """The starting states of cases.

    Args:
        scenario: Their scenario.
        cases: Names such as `test:37`; splits may differ.

    Returns:
        A world per case, in the given order.

    Raises:
        InputError: A name is not that of a case.
    """
    splits, numbers = zip(*map(parse_case, cases), strict=True)
    number = np.array(numbers, np.int64)
    worlds = scenario.draw(splits[0], number)
    for split in set(splits[1:]) - {splits[0]}:
        rows = np.flatnonzero(np.array(splits) == split)
        worlds = worlds.put(rows, scenario.draw(split, number[rows]))
    return worlds


def velocities(actions: object, shape: tuple[int, ...]) -> Float[np.ndarray, "*shape"]:
    """Check actions.

    Args:
        actions: Velocities in m/s.
        shape: The shape that they must have.

    Returns:
        The actions as float64.

    Raises:
        InputError: They are not finite numbers in that shape.
    """
    asked = np.asarray(actions, np.float64)
    # A sum is finite only if all its terms are, and takes half the time of a test of each.
    if asked.shape != shape or not (math.isfinite(asked.sum()) or np.isfinite(asked).all()):
        raise InputError(
            "an action is a finite velocity (vx, vy) in m/s, or a finite command where actions are native, "
            f"but these are {actions!r}"
        )
    return asked
