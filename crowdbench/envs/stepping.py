"""Shared parts of all environments: the choice of a case, its world, the check of actions, and the vehicle's step."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from gymnasium import error
from jaxtyping import Float

from crowdbench.catalog import load_scenario
from crowdbench.core.types import Outcome, World
from crowdbench.envs.compiled_step import CompiledStep
from crowdbench.envs.render import Renderer
from crowdbench.envs.rewards import Reward, Step, load_reward
from crowdbench.envs.window import Window
from crowdbench.scenario.cases import parse_case
from crowdbench.scenario.scenario import Scenario
from crowdbench.sim.routes import goals_on_way
from crowdbench.sim.simulator import crowd_decisions, step
from crowdbench.utils.errors import InputError, require, require_count
from crowdbench.views.view import View

TRAINING_CASES = 2**32
"""Without `options={"case": ...}`, `reset` draws one of this many training cases."""

# As integers, because access to members of an enumeration is slow.
_RUNNING, _SUCCESS = int(Outcome.RUNNING), int(Outcome.SUCCESS)


def as_scenario(scenario: str | Path | Scenario, several: bool = False) -> Scenario:
    """Load a scenario by its name or by the path of its file, or return the given one.

    Raises InputError if the scenario does not exist, or has several vehicles and `several` is False.
    """
    require("scenario", scenario, isinstance(scenario, str | Path | Scenario), "a name, a file or a Scenario")
    loaded = scenario if isinstance(scenario, Scenario) else load_scenario(str(scenario))
    if loaded.rules.vehicles > 1 and not several:
        raise InputError(f"{loaded.name} has {loaded.rules.vehicles} vehicles: use crowdbench.parallel_env")
    return loaded


def check_max_steps(steps: int | None) -> int | float:
    """Return the largest number of steps of an episode, infinite for None. Raises InputError if it is not valid."""
    if steps is None:
        return math.inf
    require_count("max_episode_steps", steps)
    return steps


def check_options(options: Mapping[str, Any] | None, *names: str) -> Mapping[str, Any]:
    """Return the options of a `reset`, an empty table for None. Raises InputError if one is not among `names`."""
    options = {} if options is None else options
    require("options of reset", options, isinstance(options, Mapping), "a table such as {'case': 'test/37'}, or None")
    for name in options:
        if name not in names:
            raise InputError(f"reset has no option {name!r}; its options are: {', '.join(names)}")
    return options


def choose_case(case: object, generator: np.random.Generator) -> str:
    """Return the case of a new episode: the given case, such as `test/37`, or else a random training case."""
    return f"train/{generator.integers(TRAINING_CASES)}" if case is None else str(case)


def make_info(case: int, outcome: int = _RUNNING, gap: float = math.inf) -> dict[str, int | float | bool]:
    """Return the info of an agent, numbers alone.

    Args:
        case: The number of the case.
        outcome: The `Outcome` of the step.
        gap: The smallest distance in metres between the agent's rim and another rim during the step.
    """
    return {"outcome": outcome, "is_success": outcome == _SUCCESS, "gap": gap, "case": case}


def start(scenario: Scenario, cases: Sequence[str]) -> World:
    """Return the starting states of cases.

    Args:
        cases: Names such as `test/37`; splits may differ.

    Returns:
        A world per case, in the given order.

    Raises:
        InputError: A name is not the name of a case.
    """
    splits, numbers = zip(*map(parse_case, cases), strict=True)
    number = np.array(numbers, np.int64)
    worlds = scenario.draw(splits[0], number)
    for split in set(splits[1:]) - {splits[0]}:
        rows = np.flatnonzero(np.array(splits) == split)
        worlds = worlds.put(rows, scenario.draw(split, number[rows]))
    return worlds


class OneWorld:
    """Shared parts of the environments of one world: its scenario, its case, its state and its picture.

    Attributes:
        case: The name of the case, such as `test/37`; empty before the first reset.

    Args:
        view: The scenario, the observations of a policy, and the interpretation of its actions.
        render_mode: `human`, `rgb_array` or None.
        reward: The name of a reward, `./mine.py`, or a function of a step.

    Raises:
        InputError: Render mode or reward do not exist.
    """

    metadata: ClassVar[dict[str, Any]]

    def __init__(self, view: View, render_mode: str | None, reward: str | Reward) -> None:
        self.scenario, self.view, self.reward = view.scenario, view, load_reward(reward)
        self.render_mode = render_mode
        self.metadata = {**self.metadata, "render_fps": round(1 / self.scenario.rules.dt)}  # type: ignore[misc]
        self._renderer = Renderer(render_mode)
        self._window = Window()
        self.case, self._number = "", 0
        self._world: World
        self._compiled: CompiledStep | None = None

    def _start(self, case: object, generator: np.random.Generator, *, everybody: bool) -> None:
        """Start a case, or a random training case if None. `everybody` is True if pedestrians observe too."""
        self.case = choose_case(case, generator)
        world = start(self.scenario, [self.case])
        self._number = int(world.case[0])
        self._enter(world)
        fits = CompiledStep.fits(self._world, self.view, self.reward)
        self._compiled = CompiledStep(self._world, self.view, everybody) if fits else None

    def _enter(self, world: World) -> None:
        self._world = world
        self._renderer.remember(world)
        if self.render_mode == "human" and (picture := self._renderer.picture(self.case)) is not None:
            self._window.show(picture, world.rules.dt)

    def _check_reset(self) -> None:
        if not self.case:
            raise error.ResetNeeded("call reset() first")

    def render(self) -> np.ndarray | None:
        """Return the picture `[height, width, 3]`, uint8, in mode `rgb_array`; None in other modes."""
        self._check_reset()
        return None if self.render_mode == "human" else self._renderer.picture(self.case)

    def close(self) -> None:
        """Close the window of mode `human`."""
        self._window.close()


def check_actions(actions: object, shape: tuple[int, ...]) -> Float[np.ndarray, "*shape"]:
    """Return actions as float64. Raises InputError if they are not finite numbers of that shape."""
    try:
        given = np.asarray(actions)
    except (TypeError, ValueError, RuntimeError):  # torch raises the last one for a tensor with a gradient
        given = np.array(None)
    checked = given.astype(np.float64, copy=False) if given.dtype.kind in "fiu" else np.full(shape, np.nan)
    # A sum of squares is finite only if all its terms are, and takes a fifth of the time of a test of each.
    if checked.shape != shape or not (math.isfinite(np.vdot(checked, checked)) or np.isfinite(checked).all()):
        raise InputError(f"an action must be two finite numbers, not {actions!r:.200}")
    return checked


def drive(view: View, before: World, actions: Float[np.ndarray, "world 2"]) -> Step:
    """Simulate one step of worlds, in which the vehicle acts and the pedestrians follow the scenario's policies.

    Args:
        view: Interpretation of actions, and the scenario.
        actions: The vehicles' actions, checked.
    """
    speed = before.preferred_speed[:, 0]
    velocity = view.commands(before.position[:, 0], goals_on_way(before)[:, 0], speed, actions)
    command = view.to_command(before, velocity)
    crowd, before = crowd_decisions(before, view.scenario.policies)
    after, (outcome, gap, _) = step(before, command, crowd, view.scenario.post_step_rule)
    return Step(before, after, outcome, gap)
