"""Base classes of planners. A planner maps an observation to the vehicle's velocity."""

from __future__ import annotations

import abc
import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TypeVar

import numpy as np
from jaxtyping import Float, Int

from crowdbench.core.types import Observation
from crowdbench.predict.predictor import Predictor


class OneStepOnly(NotImplementedError):
    """Raised by `plan_ahead` of a planner that can decide only one step at a time."""


class Planner(abc.ABC):
    """Base class of planners, which decide the vehicle's velocity in every world. Ready for use after construction."""

    privileged: bool = False
    """True if it calls `Observation.true_next`, which no vehicle could see. Such planners are never ranked."""

    raw: bool = False
    """True if it has a tracker of its own: behind a detector it observes the detections instead of tracks.

    Tables mark such planners, because all others have the same tracker.
    """

    native: bool | str = False
    """True if it returns commands of the vehicle's dynamics (`core.dynamics`), or the name of the only valid dynamics.

    Otherwise it returns velocities, which a wheeled vehicle follows as closely as possible. For a holonomic vehicle,
    both are the same. A planner for one dynamics, such as `native = "unicycle"`, is rejected for other vehicles.
    """

    trained_pedestrians: int | None = None
    """The largest number of pedestrians that it was trained with. `crowdbench run` warns if there are more."""

    trained_dt: float | None = None
    """The length of a step in seconds that it was trained with. `crowdbench run` warns if the scenario's differs."""

    facts: Mapping[str, str] = MappingProxyType({})
    """Further facts for results, such as the digest of its weights."""

    @abc.abstractmethod
    def plan(self, obs: Observation) -> Float[np.ndarray, "world 2"]:
        """Return the command for each world: a velocity in m/s, no faster than `obs.vehicle.preferred_speed`; see
        `native`."""

    def plan_ahead(self, obs: Observation, steps: int) -> Float[np.ndarray, "world time 2"]:
        """Return the commands for the next steps.

        Called instead of `plan` in runs with `replan_every` above 1, at every `steps`-th step after its first
        observations (`look_first` in `crowdbench.runs.spec`). The vehicle executes the commands without another
        observation in between.

        Args:
            obs: The observation before the first of the steps.
            steps: Number of steps.

        Returns:
            Commands as `plan` returns them.

        Raises:
            OneStepOnly: The planner decides one step at a time.
        """
        raise OneStepOnly

    def for_held_out_scene(self, scene: str) -> Planner:
        """Return a planner for a recorded scene, without parts that were trained on this scene.

        Called once, before all other methods, if pedestrians are recorded.

        Args:
            scene: The name of the scene.

        Returns:
            Another planner, or this one if no part of it was trained on the scene.

        Raises:
            InputError: A part of it was trained on the scene, and there is no other.
        """
        return self

    def reset(self, rows: Int[np.ndarray, "world"]) -> None:  # noqa: B027 (a hook, empty unless wanted)
        """Clear the memory of earlier episodes, for planners that have one. Called before each batch of episodes.

        Args:
            rows: The rows that `Observation.row` will have: 0, 1, 2, ...
        """


class AheadPlanner(Planner):
    """Planner of several steps, whose command for one step is the first of a plan."""

    def plan(self, obs: Observation) -> Float[np.ndarray, "world 2"]:
        """See `Planner`."""
        return self.plan_ahead(obs, 1)[:, 0]


AnyPredictingPlanner = TypeVar("AnyPredictingPlanner", bound="PredictingPlanner")


@dataclass(eq=False)
class PredictingPlanner(Planner):
    """Planner with predicted pedestrians, which returns commands of the vehicle's dynamics.

    It is privileged if its predictor is, and has the facts of its predictor.

    Attributes:
        predictor: Predicts the pedestrians.
    """

    predictor: Predictor

    native = True

    def __post_init__(self) -> None:
        self.privileged, self.facts = self.predictor.privileged, self.predictor.facts

    def for_held_out_scene(self: AnyPredictingPlanner, scene: str) -> AnyPredictingPlanner:
        """See `Planner`: with the predictor that was not trained on the scene."""
        return dataclasses.replace(self, predictor=self.predictor.for_held_out_scene(scene))


class OneWorldPlanner(Planner):
    """Planner that calls a function for one world at a time.

    Args:
        decide: Returns the command (vx, vy), in m/s, for an `Observation` whose arrays have no world axis.
    """

    def __init__(self, decide: Callable[[Observation], Float[np.ndarray, "2"]]) -> None:
        self.decide = decide

    def plan(self, obs: Observation) -> Float[np.ndarray, "world 2"]:
        """Plan for one world after the other."""
        logs: dict[str, np.ndarray] = {}
        command = np.array([self._decide(obs, w, logs) for w in range(len(obs))], np.float64)
        for name, values in logs.items():
            obs.log(name, values)
        return command

    def _decide(self, obs: Observation, w: int, logs: dict[str, np.ndarray]) -> Float[np.ndarray, "2"]:
        """Return the command of one world in m/s; its logs are stored in row `w` of `logs`."""
        world = obs.rows(lambda array: array[w, ...], None if obs.logs is None else {})
        try:
            command = self.decide(world)
        except BaseException as error:
            error.row = w  # type: ignore[attr-defined]  # so that the report can name the case
            raise
        for name, values in (world.logs or {}).items():
            if name not in logs:
                logs[name] = np.full((len(obs), *values.shape), np.nan)
            logs[name][w] = values
        return command
