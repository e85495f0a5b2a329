"""Planner of a network that CrowdNav (Chen et al. 2019) has trained, or of another policy with the same interface.

    git clone https://github.com/vita-epfl/CrowdNav
    crowdbench run --planner adapters/crowdnav/crowdnav.py --option clone=CrowdNav --isolated

CrowdNav and CrowdNav++ (Liu et al. 2023) call `policy.predict(state)` with the state of one robot and the
humans in its sight. `predict` returns a velocity, or a turn and a speed.
"""

from __future__ import annotations

import configparser
import contextlib
import copy
import importlib
import math
import sys
from collections import namedtuple
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import gymnasium
import numpy as np
import torch
from jaxtyping import Float, Int

from crowdbench import InputError, Observation, OneWorldPlanner
from crowdbench.networks import weights_digest
from crowdbench.utils import plugin_errors

STATES = "crowd_sim.envs.utils.state"
"""The module in which CrowdNav and CrowdNav++ define their states."""

SOURCE = "https://github.com/vita-epfl/CrowdNav"

FAR = 20.0
"""Distance in metres of a substitute pedestrian, which the policy receives while the vehicle sees no pedestrian."""


def planner(clone: str = "CrowdNav", output: str = "crowd_nav/data/output", policy: str = "sarl") -> CrowdNavPlanner:
    """Make the planner of a network.

    Args:
        clone: Your clone of CrowdNav.
        output: The folder in the clone with `policy.config` and `rl_model.pth`.
        policy: The policy's name in CrowdNav: sarl, lstm_rl.

    Returns:
        The planner.

    Raises:
        InputError: There is no clone or no trained model, or the model is not of this policy.
    """
    config_file, weights = (Path(clone, output, name) for name in ("policy.config", "rl_model.pth"))
    if not Path(clone).is_dir():
        raise InputError(f"there is no clone of CrowdNav in {clone}: git clone {SOURCE}, or give --option clone=DIR")
    missing = [file.name for file in (config_file, weights) if not file.is_file()]
    if missing:
        raise InputError(
            f"there is no model in {config_file.parent}, which has no file {' and no '.join(missing)}: train first, "
            f"with python train.py --policy {policy} in {Path(clone, 'crowd_nav')}, or give --option output=FOLDER"
        )
    # Only CrowdNav's simulator needs these modules, which can no longer be installed.
    sys.modules |= {"rvo2": ModuleType("rvo2"), "gym": gymnasium, "gym.envs.registration": gymnasium.envs.registration}
    sys.path.insert(0, clone)
    try:
        factory = importlib.import_module("crowd_nav.policy.policy_factory").policy_factory
    except ImportError as error:
        raise InputError(f"{clone} is no clone of CrowdNav: {error}") from None
    if policy not in factory:
        raise InputError(f"CrowdNav has no policy {policy!r}, but {', '.join(map(str, factory))}")
    chosen, config = factory[policy](), configparser.RawConfigParser()
    with _described(f"{config_file} configures no {policy}"):
        config.read_string(config_file.read_text(encoding="utf-8"))
        chosen.configure(config)
    if (network := _network(chosen)) is None:
        raise InputError(f"the policy {policy} of CrowdNav has no network: give --option policy=sarl, or lstm_rl")
    try:
        state = torch.load(weights, "cpu", weights_only=True)
    except Exception:  # torch raises many kinds of exceptions, and advises against `weights_only`
        raise InputError(f"{weights} cannot be read, or holds something other than tensors") from None
    with _described(f"{weights} has no weights of {policy} as {config_file.name} configures it"):
        network.load_state_dict(state)
    chosen.query_env = False
    return CrowdNavPlanner(chosen)


@contextlib.contextmanager
def _described(sentence: str) -> Iterator[None]:
    """Turn any error into an InputError: a sentence and the reason, in one line."""
    try:
        yield
    except Exception as error:  # CrowdNav, configparser and torch raise many kinds
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise InputError(f"{sentence}: {reason}") from None


class _Agent:
    """Base of both states. They are tuples, because policies concatenate them by `+`: a row of 14 numbers."""

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
    """Planner of a policy object of CrowdNav or CrowdNav++, or of another object with the same interface.

    Each episode has a separate copy of the policy in its initial state. So a policy may store the state of its episode,
    and the given object is never changed. The copies share the weights of `model`.

    Copies are prepared as in CrowdNav's test: `set_phase("test")`, `set_device("cpu")` if no device was set, and
    `time_step`, if the policy has these. `sim`, the RVO2 simulator of ORCA, starts as None in every episode, so that
    it does not contain radii of an earlier episode. States have the classes that the policy's module uses, because
    CrowdNav's policies test for them.

    The input of a policy has the pedestrians that the vehicle sees. CrowdNav's networks fail without pedestrians: while
    the vehicle sees none of them, the input has one that stands `FAR` behind the vehicle. `ActionRot` is a turn in
    radians on the spot, then a speed in m/s along the new heading.

    CrowdNav's CADRL, and all its value networks with `query_env`, need the true next step of the pedestrians. They are
    rejected. The networks of CrowdNav++ have no `predict`: of its policies, ORCA and social force can drive.

    Args:
        policy: An object with `predict(state)`, configured and with its weights loaded.

    Raises:
        InputError: The policy does not define `predict`, has `query_env` set, or cannot be copied. While it drives:
            it calls `env.onestep_lookahead`, or returns something other than an action.
    """

    def __init__(self, policy: Any) -> None:
        # One world at a time: `predict` takes one state, and policies build their tensors from its numbers.
        super().__init__(self._command)
        self.name = type(policy).__name__
        _examine(policy, self.name)
        facts = {"policy": self.name}
        if (network := _network(policy)) is not None:
            facts["weights"] = weights_digest(network)  # results name no file with these weights
        self.facts = facts
        self._states = _state_classes(policy)
        self._policy = _prepare(policy, self.name)
        self._policies: dict[int, Any] = {}
        self._headings: dict[int, float] = {}

    def reset(self, rows: Int[np.ndarray, "world"]) -> None:
        """Create a copy of the policy for every world.

        Args:
            rows: The values of `Observation.row` in this batch.
        """
        network = _network(self._policy)
        weights = {} if network is None else {id(tensor): tensor for tensor in network.parameters()}
        # `deepcopy` does not copy the contents of this memo: hundreds of worlds share the weights.
        self._policies = {int(row): copy.deepcopy(self._policy, dict(weights)) for row in rows}
        self._headings = {}

    def _command(self, obs: Observation) -> Float[np.ndarray, "2"]:
        """Return the policy's velocity in m/s for one world."""
        row = int(obs.row)
        policy = self._policies[row]
        if hasattr(policy, "time_step"):
            policy.time_step = obs.dt
        # The heading is the sum of the policy's turns. The heading of a holonomic vehicle does not include turns on the
        # spot, and is reversed after driving backwards.
        heading = self._headings.get(row, float(obs.vehicle.heading)) % (2.0 * math.pi)
        first, second, rotates = _action(policy.predict(self._state(obs, heading)), self.name)
        if not (rotates and math.isfinite(second)):  # the driver rejects a turn that is not finite
            return np.array([first, second])
        heading += second
        self._headings[row] = heading
        return np.array([first * math.cos(heading), first * math.sin(heading)])

    def _state(self, obs: Observation, heading: float) -> Any:
        """Return the input of the policy for one world, in Python's number types."""
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
    """Substitute for CrowdNav's simulator, from which a policy could read the true next step."""

    def onestep_lookahead(self, action: object) -> None:
        raise InputError(
            "the policy reads the pedestrians' true next step from env.onestep_lookahead, which no vehicle can see: "
            "crowdbench runs only policies that predict it themselves"
        )


def _examine(policy: Any, name: str) -> None:
    """Raise InputError if a policy cannot drive: see `CrowdNavPlanner`."""
    if isinstance(policy, type):
        raise InputError(
            f"CrowdNavPlanner takes a policy object, but {policy.__name__} is a class: make an object of it"
        )
    predict = getattr(policy, "predict", None)
    # CrowdNav's base class has an abstract `predict` that returns None; CrowdNav++'s networks inherit it.
    if not callable(predict) or getattr(predict, "__isabstractmethod__", False):
        raise InputError(f"a policy of CrowdNav has a method predict(state), but this {name} has none of its own")
    if getattr(policy, "query_env", False):
        raise InputError(
            f"the policy {name} has query_env = {policy.query_env}: it would read the pedestrians' true next step from "
            "CrowdNav's simulator, which no vehicle can see; with query_env = False it assumes constant velocity"
        )


def _prepare(policy: Any, name: str) -> Any:
    """Return a copy of a policy, ready to drive. Raises InputError if it cannot be copied."""
    with plugin_errors(f"the policy {name} cannot be copied or prepared, which every episode needs:"):
        own = copy.copy(policy)
        # The environment and ORCA's RVO2 simulator cannot be copied. The next `predict` creates the latter again.
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
    """Return the classes of full, observable and joint states in the policy's modules, or else the classes above.

    CrowdNav's value networks test `isinstance(state, FullState)`. The modules of such a policy are already loaded, so
    that nothing is imported here.
    """
    modules = [sys.modules.get(kind.__module__) for kind in type(policy).__mro__]
    named = [module.FullState for module in modules if isinstance(module, ModuleType) and hasattr(module, "FullState")]
    home = sys.modules.get(named[0].__module__ if named else STATES)
    ours = (FullState, ObservableState, JointState)
    full, observable, joint = (getattr(home, kind.__name__, kind) for kind in ours)
    return full, observable, joint


def _network(policy: Any) -> Any:
    """Return the policy's torch network; None if it has none."""
    network = getattr(policy, "model", None)
    return network if hasattr(network, "state_dict") and hasattr(network, "parameters") else None


def _action(action: Any, name: str) -> tuple[float, float, bool]:
    """Return the two numbers of an action, and whether it is an `ActionRot`, with a speed in m/s and a turn in radians.

    Otherwise they are a velocity in m/s. Raises InputError if the action is neither, or contains other values.
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
