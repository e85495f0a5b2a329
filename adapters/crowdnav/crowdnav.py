"""A network that CrowdNav (Chen et al. 2019) has trained as a planner, and any other policy in its manner.

    git clone https://github.com/vita-epfl/CrowdNav
    crowdbench run --planner adapters/crowdnav/crowdnav.py --option clone=CrowdNav --isolated

CrowdNav and CrowdNav++ (Liu et al. 2023) call `policy.predict(state)` with the state of one robot and what it sees of
the humans. It returns a velocity, or a turn and a speed.
"""

from __future__ import annotations

import configparser
import copy
import importlib
import math
import sys
from collections import namedtuple
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import gymnasium
import numpy as np
import torch
from jaxtyping import Float, Int

from crowdbench.core.types import Observation
from crowdbench.networks.weights import digest
from crowdbench.planners.base import OneWorldPlanner
from crowdbench.utils.errors import InputError, plugin_errors

STATES = "crowd_sim.envs.utils.state"
"""The module in which CrowdNav and CrowdNav++ define their states."""

FAR = 20.0
"""How far away somebody stands, in metres, where a policy is shown a pedestrian and the vehicle sees none."""


def planner(clone: str = "CrowdNav", output: str = "crowd_nav/data/output", policy: str = "sarl") -> CrowdNavPlanner:
    """Make the planner of a network.

    Args:
        clone: Your clone of CrowdNav.
        output: The folder in the clone with `policy.config` and `rl_model.pth`.
        policy: The policy's name in CrowdNav: sarl, lstm_rl.

    Returns:
        The planner.
    """
    # Only its simulator needs these, which no longer install.
    sys.modules |= {"rvo2": ModuleType("rvo2"), "gym": gymnasium, "gym.envs.registration": gymnasium.envs.registration}
    sys.path.insert(0, clone)
    chosen = importlib.import_module("crowd_nav.policy.policy_factory").policy_factory[policy]()
    config = configparser.RawConfigParser()
    config.read(f"{clone}/{output}/policy.config")
    chosen.configure(config)
    chosen.get_model().load_state_dict(torch.load(f"{clone}/{output}/rl_model.pth", weights_only=True))
    chosen.query_env = False
    return CrowdNavPlanner(chosen)


class _Agent:
    """Base of both states. They are tuples, because policies add them: a row of 14 numbers."""

    px: float
    py: float
    vx: float
    vy: float

    @property
    def position(self) -> tuple[float, float]:
        """Position in metres."""
        return self.px, self.py

    @property
    def velocity(self) -> tuple[float, float]:
        """Velocity in m/s."""
        return self.vx, self.vy


class FullState(_Agent, namedtuple("FullState", "px py vx vy radius gx gy v_pref theta")):
    """State of the vehicle: positions in metres, velocities in m/s, heading `theta` in [0, 2 pi)."""

    @property
    def goal_position(self) -> tuple[float, float]:
        """Goal in metres."""
        return self.gx, self.gy


class ObservableState(_Agent, namedtuple("ObservableState", "px py vx vy radius")):
    """Visible state of a pedestrian: position in metres, velocity in m/s, radius in metres."""


@dataclass
class JointState:
    """Input of a policy. Not frozen, because CrowdNav's LSTM-RL sorts the humans in place.

    Attributes:
        self_state: The vehicle.
        human_states: The pedestrians that it sees.
    """

    self_state: Any
    human_states: list[Any]


class CrowdNavPlanner(OneWorldPlanner):
    """Drives with a policy object of CrowdNav or CrowdNav++, or with one that is written in their way.

    Every episode has its own copy of the policy, as the policy was when it was given to the planner. So a policy may
    remember its episode, and the object that was given is never changed. The copies share the weights of `model`.

    A copy is prepared as CrowdNav's test does it: `set_phase("test")`, `set_device("cpu")` where no device was set, and
    `time_step`, where the policy has these. `sim`, in which ORCA keeps a simulator of RVO2, starts as None in every
    episode, so that radii of an earlier episode do not remain in it. States are of the classes that the policy's own
    code uses, because CrowdNav's policies test for them.

    A policy is shown the pedestrians that the vehicle sees. CrowdNav's networks fail where they are shown none: while
    the vehicle sees none of those that there are, they are shown one who stands `FAR` behind it. `ActionRot` is a turn
    in radians on the spot, then a speed in m/s along the new heading.

    CrowdNav's CADRL, and all its value networks with `query_env`, need the true next step of the pedestrians, and so
    they are refused. The networks of CrowdNav++ have no `predict`: of its policies, ORCA and social force can drive.

    Args:
        policy: An object with `predict(state)`, configured and with its weights loaded.

    Raises:
        InputError: The policy has no `predict` of its own, has `query_env` set, or cannot be copied. While it drives:
            it asks for `env.onestep_lookahead`, or returns something other than an action.
    """

    def __init__(self, policy: Any) -> None:
        # One world after the other: `predict` takes one state, and policies build their tensors from its numbers.
        super().__init__(self._command)
        self.name = type(policy).__name__
        _examine(policy, self.name)
        facts = {"policy": self.name}
        if (network := _network(policy)) is not None:
            facts["weights"] = digest(network)  # no file that results name holds them
        self.facts = facts
        self._states = _state_classes(policy)
        self._policy = _prepare(policy, self.name)
        self._policies: dict[int, Any] = {}
        self._headings: dict[int, float] = {}

    def reset(self, rows: Int[np.ndarray, "world"]) -> None:
        """Give every world its own copy of the policy.

        Args:
            rows: The rows that `Observation.row` will have.
        """
        network = _network(self._policy)
        weights = {} if network is None else {id(tensor): tensor for tensor in network.parameters()}
        # Whatever is in this memo, `deepcopy` does not copy: hundreds of worlds need the weights only once.
        self._policies = {int(row): copy.deepcopy(self._policy, dict(weights)) for row in rows}
        self._headings = {}

    def _command(self, obs: Observation) -> Float[np.ndarray, "2"]:
        """Return the policy's velocity in m/s for one world."""
        row = int(obs.row)
        policy = self._policies[row]
        if hasattr(policy, "time_step"):
            policy.time_step = obs.dt
        # The policy's own turns count. A holonomic vehicle's heading would forget a turn on the spot, and would be
        # the opposite one after driving backwards.
        heading = self._headings.get(row, float(obs.vehicle.heading)) % (2.0 * math.pi)
        first, second, rotates = _action(policy.predict(self._state(obs, heading)), self.name)
        if not (rotates and math.isfinite(second)):  # a turn that is not finite is left to the driver, which refuses it
            return np.array([first, second])
        heading += second
        self._headings[row] = heading
        return np.array([first * math.cos(heading), first * math.sin(heading)])

    def _state(self, obs: Observation, heading: float) -> Any:
        """Return the input of the policy for one world, in Python's own numbers."""
        full, observable, joint = self._states
        vehicle, crowd = obs.vehicle, obs.pedestrians
        own = [*vehicle.position, *vehicle.velocity, vehicle.radius, *vehicle.local_goal, vehicle.preferred_speed]
        humans = np.concatenate([crowd.position, crowd.velocity, crowd.radius[:, None]], axis=1)[crowd.seen]
        if len(crowd.seen) and not len(humans):
            away = vehicle.position - vehicle.local_goal
            behind = vehicle.position + FAR * away / max(math.hypot(*away.tolist()), 1e-9)
            humans = np.array([[*behind, 0.0, 0.0, float(vehicle.radius)]])
        return joint(full(*map(float, own), heading), [observable(*human) for human in humans.tolist()])


class _NoEnvironment:
    """In the place of CrowdNav's simulator, which a policy could ask what will happen."""

    def onestep_lookahead(self, action: object) -> None:
        raise InputError(
            "the policy asks env.onestep_lookahead for the pedestrians' next step, which no vehicle can see: "
            "crowdbench runs only policies that predict it themselves"
        )


def _examine(policy: Any, name: str) -> None:
    """Raise InputError where a policy cannot drive: see `CrowdNavPlanner`."""
    if isinstance(policy, type):
        raise InputError(
            f"CrowdNavPlanner takes a policy object, but {policy.__name__} is a class: make an object of it"
        )
    predict = getattr(policy, "predict", None)
    # CrowdNav's base class has an abstract one that returns None; CrowdNav++'s networks inherit it.
    if not callable(predict) or getattr(predict, "__isabstractmethod__", False):
        raise InputError(f"a policy of CrowdNav has a method predict(state), but this {name} has none of its own")
    if getattr(policy, "query_env", False):
        raise InputError(
            f"the policy {name} has query_env = {policy.query_env}, with which it asks CrowdNav's simulator for the "
            "pedestrians' next step, which no vehicle can see: "
            "set policy.query_env = False, and it assumes that they keep their velocities"
        )


def _prepare(policy: Any, name: str) -> Any:
    """Return a copy of a policy, ready to drive. Raises InputError where it cannot be copied."""
    with plugin_errors(f"the policy {name} cannot be copied or prepared, which every episode needs:"):
        own = copy.copy(policy)
        # Neither can be copied: a whole simulator, and ORCA's simulator of RVO2, which the next `predict` makes again.
        for attribute, instead in (("env", _NoEnvironment()), ("sim", None)):
            if hasattr(own, attribute):
                setattr(own, attribute, instead)
        own = copy.deepcopy(own)
        if callable(getattr(own, "set_phase", None)):
            own.set_phase("test")
        if getattr(own, "device", "") is None and callable(getattr(own, "set_device", None)):
            own.set_device("cpu")
    return own


def _state_classes(policy: Any) -> tuple[Any, Any, Any]:
    """Return the classes of full, observable and joint states that the policy knows; the ones above where it knows
    none.

    CrowdNav's value networks ask `isinstance(state, FullState)`. Their modules are loaded where there is such a policy,
    so that nothing is imported here.
    """
    modules = [sys.modules.get(kind.__module__) for kind in type(policy).__mro__]
    named = [module.FullState for module in modules if isinstance(module, ModuleType) and hasattr(module, "FullState")]
    home = sys.modules.get(named[0].__module__ if named else STATES)
    ours = (FullState, ObservableState, JointState)
    full, observable, joint = (getattr(home, kind.__name__, kind) for kind in ours)
    return full, observable, joint


def _network(policy: Any) -> Any:
    """Return the policy's network of torch; None where it has none."""
    network = getattr(policy, "model", None)
    return network if hasattr(network, "state_dict") and hasattr(network, "parameters") else None


def _action(action: Any, name: str) -> tuple[float, float, bool]:
    """Return the two numbers of an action, and whether it is an `ActionRot`, with a speed in m/s and a turn in radians.

    Else they are a velocity in m/s. Raises InputError where it is neither, or has something other than numbers.
    """
    try:
        if hasattr(action, "vx") and hasattr(action, "vy"):
            return float(action.vx), float(action.vy), False
        if hasattr(action, "v") and hasattr(action, "r"):
            return float(action.v), float(action.r), True
    except (TypeError, ValueError) as error:
        raise InputError(f"the policy {name} returned {action!r}, in which something is no number: {error}") from None
    raise InputError(
        f"the policy {name} returned a {type(action).__name__}, but must return ActionXY(vx, vy) or ActionRot(v, r)"
    )
