"""The planner of a policy that observes and acts as in the environments: any function of arrays."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from crowdbench.core.dynamics import DYNAMICS, FREE
from crowdbench.core.types import Observation
from crowdbench.networks.features import clip_to_disc, direction, to_world
from crowdbench.planners.planner import Planner
from crowdbench.planners.validation import AnswerFault, validate_array
from crowdbench.utils.errors import InputError, is_integer, require, takes_arguments
from crowdbench.views.actions import ACTIONS, scale
from crowdbench.views.view import NEAREST, as_dtype, check_view, encode


@dataclass(eq=False)
class PolicyPlanner(Planner):
    """Planner that drives with the actions of a function, such as the mean action of a trained policy.

    An action is clipped to the action space of the vehicle, and its velocity limited to the preferred speed, as in the
    environments. Velocities are not corrected along walls.

    Attributes:
        function: Returns the actions `[world, 2]` of many worlds for their observations: an array `[world, features]`
            or a dictionary of arrays `[world, ...]`. With a `state`, it is called as `function(observed, *state)` and
            returns `(actions, *state)`.
        observation: Its observation: `flat`, `goal_frame`, `dict` or `lidar`, see `crowdbench.views.view`.
        action: Its actions, such as `normalized` or `velocity`, see `crowdbench.views.actions`.
        nearest: Largest number of pedestrians that it observes in the frame of the goal.
        state: Shapes of the memory arrays of a recurrent policy for one world, which are zeros when an episode starts.
        dynamics: The dynamics of the vehicles that it may drive, such as `holonomic`; any if None.
        rays: Number of rays to walls that it observes in the frame of the goal.
        dtype: Type of the numbers that it observes, `float32` or `float64`.

    Raises:
        InputError: There is no such observation, action or type.
    """

    function: Callable[..., Any]
    observation: str
    action: str
    nearest: int = NEAREST
    state: Sequence[tuple[int, ...]] = ()
    dynamics: str | None = None
    rays: int = 0
    dtype: str = "float32"

    def __post_init__(self) -> None:
        require("state", self.state, _are_shapes(self.state), "a list of shapes, such as [(1, 64)]")
        is_function = callable(self.function) and takes_arguments(self.function, 1 + len(self.state))
        right = "a function of the observation and of each array of the state"
        require("function", self.function, is_function, right)
        check_view(self.observation, self.action, self.nearest, self.rays, self.dtype)
        is_known = self.dynamics is None or (isinstance(self.dynamics, str) and self.dynamics in DYNAMICS)
        require("dynamics", self.dynamics, is_known, f"None or one of {', '.join(DYNAMICS)}")
        self.native = ACTIONS[self.action].axes == "native"
        self.reset(np.arange(0))

    def reset(self, rows: Int[np.ndarray, "world"]) -> None:
        """See `Planner`."""
        self.memory = [np.zeros((len(rows), *shape), np.float32) for shape in self.state]

    def plan(self, obs: Observation) -> Float[np.ndarray, "world 2"]:
        """See `Planner`."""
        vehicle = obs.vehicle
        if self.dynamics not in (None, vehicle.dynamics.name):
            raise InputError(
                f"the policy was trained with dynamics {self.dynamics}, but the vehicle of the scenario is "
                f"{vehicle.dynamics.name}: --option dynamics={vehicle.dynamics.name} drives it all the same"
            )
        action = validate_array(answer := self._act(obs), len(obs))
        if isinstance(action, AnswerFault) or not np.isfinite(action).all():
            return answer  # the driver raises an error that names the case
        speed, dynamics = vehicle.preferred_speed, vehicle.dynamics if self.native else FREE
        axes, normalized = ACTIONS[self.action]
        low, high = dynamics.space(speed)
        action = scale(action, low, high) if normalized else np.clip(action, low, high)
        if dynamics.name != FREE.name:
            return action
        if axes == "goal":
            action = to_world(action, direction(vehicle.position, vehicle.local_goal))
        return clip_to_disc(action, speed)

    def _act(self, obs: Observation) -> Any:
        """Return the actions of the function, and store its state."""
        observed = as_dtype(encode(obs, self.observation, self.nearest, self.rays), self.dtype)
        if not self.state:
            return self.function(observed)
        if len(self.memory[0]) <= obs.row.max():  # called without a reset
            self.reset(np.arange(obs.row.max() + 1))
        answer, *states = self.function(observed, *(memory[obs.row] for memory in self.memory))
        for memory, state in zip(self.memory, states, strict=True):
            memory[obs.row] = state
        return answer


def _are_shapes(state: object) -> bool:
    """Return whether a value is a sequence of shapes of arrays."""
    if not isinstance(state, list | tuple) or not all(isinstance(shape, list | tuple) for shape in state):
        return False
    return all(is_integer(size) and size >= 1 for shape in state for size in shape)
