"""What the environments share: which case an episode is, its world, and one step of it."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from crowdbench.cases import parse_case
from crowdbench.catalog import load_scenario
from crowdbench.errors import InputError
from crowdbench.rng import SPLITS
from crowdbench.scenario import Scenario
from crowdbench.sim.simulator import advance, judge
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


def start(scenario: Scenario, cases: Sequence[str]) -> World:
    """The start of the named cases, in their order. Raises InputError where a name is none of a case."""
    named = [parse_case(case) for case in cases]
    worlds = None
    for split in SPLITS:
        rows = np.array([row for row, (own, _) in enumerate(named) if own == split], np.int64)
        if len(rows):
            drawn = scenario.draw(split, np.array([named[row][1] for row in rows]))
            if worlds is None:
                worlds = drawn.take(np.zeros(len(named), np.int64))
            worlds = put(worlds, rows, drawn)
    assert worlds is not None, "an environment has at least one world"
    return worlds


def put(worlds: World, rows: Int[np.ndarray, "row"], others: World) -> World:
    """The worlds with other ones in the given rows."""
    if len(rows) == len(worlds):
        return others.take(np.argsort(rows))

    def replaced(ours: np.ndarray, theirs: np.ndarray) -> np.ndarray:
        both = ours.copy()
        both[rows] = theirs
        return both

    arrays = {
        field.name: replaced(getattr(worlds, field.name), getattr(others, field.name))
        for field in dataclasses.fields(World)
        if field.name not in ("parameters", "rules")
    }
    parameters = {
        policy: {name: replaced(values, others.parameters[policy][name]) for name, values in table.items()}
        for policy, table in worlds.parameters.items()
    }
    return World(**arrays, parameters=parameters, rules=worlds.rules)


def step(
    world: World, command: Float[np.ndarray, "world 2"], crowd: Float[np.ndarray, "world pedestrian 2"]
) -> tuple[World, Int[np.ndarray, "world"], Float[np.ndarray, "world"]]:
    """The world one step later, the outcome of the step, and the vehicle's gap in it in metres.

    `command` is the vehicle's velocity and `crowd` the pedestrians', in m/s; `advance` limits both.
    """
    after = advance(world, np.concatenate([command[:, None], crowd], axis=1))
    return after, *judge(world, after)


def velocities(actions: object, shape: tuple[int, ...]) -> Float[np.ndarray, "*shape"]:
    """Actions as velocities in m/s. Raises InputError where they are no finite numbers in that shape."""
    asked = np.asarray(actions, np.float64)
    if asked.shape != shape or not np.isfinite(asked).all():
        raise InputError(f"an action is a finite velocity (vx, vy) in m/s, but these are {actions!r}")
    return asked
