"""What decides the vehicle's velocity."""

from __future__ import annotations

import abc
from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np
from jaxtyping import Float, Int

from crowdbench.types import Observation


class OneStepOnly(NotImplementedError):
    """Raised by a planner that is asked for several steps at once and decides one at a time."""


class Planner(abc.ABC):
    """Decides the vehicle's velocity in every world of a batch. Complete once it is constructed."""

    privileged: bool = False
    """Whether it calls `Observation.true_next`, which no vehicle could see: shown, never ranked."""

    facts: Mapping[str, str] = MappingProxyType({})
    """What results say of it beyond its name and options, such as the digest of its weights."""

    @abc.abstractmethod
    def plan(self, obs: Observation) -> Float[np.ndarray, "world 2"]:
        """The velocity command for each world, in m/s, no faster than `obs.vehicle.preferred_speed`."""

    def plan_ahead(self, obs: Observation, steps: int) -> Float[np.ndarray, "world time 2"]:
        """The velocity commands for the next `steps` steps, in m/s, no faster than `obs.vehicle.preferred_speed`.

        Called instead of `plan`, at every `steps`-th step, in runs with `replan_every` above 1: the vehicle carries
        them out without looking in between. Raises OneStepOnly in planners that decide one step at a time.
        """
        raise OneStepOnly

    def reset(self, cases: Int[np.ndarray, "world"]) -> None:  # noqa: B027 (a hook, empty unless wanted)
        """Called once before a batch of cases starts; for planners that remember something by case."""


class OneWorldPlanner(Planner):
    """Lifts a function written for one world at a time to batches.

    `decide(obs)` is given an `Observation` of a single world, whose arrays have no world axis, and returns
    its command (vx, vy) in m/s.
    """

    def __init__(self, decide: Callable[[Observation], Float[np.ndarray, "2"]]) -> None:
        self.decide = decide

    def plan(self, obs: Observation) -> Float[np.ndarray, "world 2"]:
        """One world after the other."""
        logs: dict[str, np.ndarray] = {}
        command = np.array([self._decide(obs, w, logs) for w in range(len(obs))], np.float64)
        for name, values in logs.items():
            obs.log(name, values)
        return command

    def _decide(self, obs: Observation, w: int, logs: dict[str, np.ndarray]) -> Float[np.ndarray, "2"]:
        try:
            return self.decide(_one_world(obs, w, logs))
        except BaseException as error:
            error.row = w  # type: ignore[attr-defined]  # whoever reports it can tell the case
            raise


def _one_world(obs: Observation, w: int, logs: dict[str, np.ndarray]) -> Observation:
    def record(name: str, values: np.ndarray) -> None:
        if name not in logs:
            logs[name] = np.full((len(obs), *np.shape(values)), np.nan)
        logs[name][w] = values

    return obs.rows(lambda array: array[w, ...], record)
