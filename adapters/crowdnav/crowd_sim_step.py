"""The step of CrowdNav's `CrowdSim` (Chen et al. 2019), computed by crowdbench's compiled ORCA and collision test."""

from __future__ import annotations

import functools
import hashlib
import importlib
import inspect
import io
import logging
import math
import textwrap
import tokenize
from typing import Any

import numpy as np

from crowdbench import Outcome
from crowdbench.core import Discs, nearest_in_step
from crowdbench.sim import orca_in_one, per_agent, step_outcome

STEP, PREDICT, ACT = "53c1da4daf6a", "5695436930d6", "797fcc0c3e9b"
"""Fingerprints of CrowdNav's `CrowdSim.step`, since 2018, `ORCA.predict` and `Human.act`."""

_log = logging.getLogger(__name__)  # functions of the root logger would configure logging before the script does
_NO_CODE = {getattr(tokenize, kind) for kind in ("COMMENT", "NL", "NEWLINE", "INDENT", "DEDENT", "ENDMARKER")}


@functools.cache
def fingerprint(function: Any) -> str:
    """Return a 12-digit hexadecimal hash of a function's source without comments and blanks; empty without source."""
    try:
        source = textwrap.dedent(inspect.getsource(function))
    except (OSError, TypeError):
        return ""
    tokens = tokenize.generate_tokens(io.StringIO(source.strip()).readline)
    code = " ".join(" ".join(token.string for token in tokens if token.type not in _NO_CODE).split())
    return hashlib.sha256(code.encode()).hexdigest()[:12]


def faster(simulation: type) -> type:
    """Return a class of `CrowdSim` with the step of `CompiledStep`, or the same class if its step is not CrowdNav's.

    Configuration, cases, `onestep_lookahead` and rendering are inherited from the given class.
    """
    file = inspect.getsourcefile(simulation)
    if fingerprint(getattr(simulation, "step", None)) != STEP:
        _log.info("crowdbench: %s has a step of its own, which is kept; ORCA is crowdbench's", file)
        return simulation
    _log.info("crowdbench: steps instead of %s", file)
    utils = "crowd_sim.envs.utils"
    known = {"action_kind": importlib.import_module(f"{utils}.action").ActionXY}
    known["infos"] = importlib.import_module(f"{utils}.info")
    return type(simulation.__name__, (CompiledStep, simulation), known)


class CompiledStep:
    """Mixin with the step of CrowdNav's `CrowdSim`: `faster` derives a class from this class and from `CrowdSim`.

    Velocities of pedestrians are computed once per step, for any number of actions that `onestep_lookahead` tries. If a
    pedestrian is not moved by CrowdNav's ORCA, the step of `CrowdSim` is called.
    """

    # These classes exist only in the process of a fork. The first two are CrowdNav's `ActionXY`, and its module `info`.
    action_kind: Any
    infos: Any
    robot: Any
    humans: list[Any]
    time_step: float
    _crowd: Any = None
    _decided: Any = None
    _next: list[Any] | None

    def step(self, action: Any, update: bool = True) -> tuple[list[Any], float, bool, Any]:
        """Take a step, or simulate it without changing the state.

        Args:
            action: `ActionXY(vx, vy)` in m/s, or `ActionRot(v, r)`: a turn of r radians, then v in m/s.
            update: True if the step is taken.

        Returns:
            The pedestrians' observable states after the step, reward, whether the episode has ended, and info.
        """
        if self._crowd is not self.humans:
            self._crowd, self._is_known = self.humans, _follows_orca(self.humans)
        if not self._is_known:
            return super().step(action, update)  # type: ignore[misc]
        agents = [self.robot, *self.humans]
        state = [(float(a.px), float(a.py), float(a.vx), float(a.vy), a.gx, a.gy, a.radius, a.v_pref) for a in agents]
        if (state, self.time_step, self.robot.visible) != self._decided:
            self._decided = state, self.time_step, self.robot.visible
            self._decide(np.array(state, float))
        reward, done, info = self._judge(action)
        if not update:
            if self._next is None:
                pairs = zip(self.humans, self._actions, strict=True)
                self._next = [human.get_next_observable_state(chosen) for human, chosen in pairs]
            return self._next.copy(), reward, done, info
        self._move(action)
        return [human.get_observable_state() for human in self.humans], reward, done, info

    def _decide(self, state: np.ndarray) -> None:
        """Compute the pedestrians' velocities from rows of the numbers in `step`, and prepare the collision test."""
        position, velocity, goal = (np.ascontiguousarray(state[None, :, k : k + 2]) for k in (0, 2, 4))
        radius, speed = np.ascontiguousarray(state[:, 6])[None], np.ascontiguousarray(state[:, 7])[None]
        everybody = np.ones(radius.shape, bool)
        everybody[0, 0] = self.robot.visible
        orca, taken = self.humans[0].policy, np.empty((1, len(state) - 1, 2))
        # A pedestrian of CrowdNav walks towards its goal at 1 m/s at most, for any preferred speed.
        agents = goal, np.ones(radius.shape), per_agent(orca.safety_space), position, velocity, radius, speed, everybody
        limits = map(per_agent, (orca.neighbor_dist, orca.max_neighbors, orca.time_horizon))
        orca_in_one(*agents, self.time_step, *limits, taken)
        self._actions = [self.action_kind(x, y) for x, y in taken[0].tolist()]
        self._next = None
        # In CrowdNav's collision test pedestrians keep the velocity from before the step.
        self._discs = Discs(position[0], self.time_step * velocity[0], radius[0], np.ones(len(state), bool))

    def _judge(self, action: Any) -> tuple[float, bool, Any]:
        """Return the reward, whether the episode ends with an action, and CrowdNav's info object."""
        robot, dt, kinds = self.robot, self.time_step, self.infos
        if robot.kinematics == "holonomic":
            vx, vy = float(action.vx), float(action.vy)
        else:
            heading, speed = float(action.r + robot.theta), float(action.v)
            vx, vy = speed * math.cos(heading), speed * math.sin(heading)
        self._discs.motion[0] = dt * vx, dt * vy
        gap, _ = nearest_in_step(0, self._discs)
        x, y, _, _, gx, gy, radius, _ = self._decided[0][0]
        is_last = self.global_time >= self.time_limit - 1
        outcome = step_outcome(gap, math.inf, gx - x - dt * vx, gy - y - dt * vy, radius, is_last)
        if outcome == Outcome.TIMEOUT:
            return 0, True, kinds.Timeout()
        if outcome == Outcome.COLLISION:
            return self.collision_penalty, True, kinds.Collision()
        if outcome == Outcome.SUCCESS:
            return self.success_reward, True, kinds.ReachGoal()
        if gap < self.discomfort_dist:
            reward = (gap - self.discomfort_dist) * self.discomfort_penalty_factor * dt
            return reward, False, kinds.Danger(gap)
        return 0, False, kinds.Nothing()

    def _move(self, action: Any) -> None:
        """Store this state for `render`, and move the robot and the pedestrians."""
        robot, humans = self.robot, self.humans
        self.states.append([robot.get_full_state(), [human.get_full_state() for human in humans]])
        if hasattr(robot.policy, "action_values"):
            self.action_values.append(robot.policy.action_values)
        if hasattr(robot.policy, "get_attention_weights"):
            self.attention_weights.append(robot.policy.get_attention_weights())
        robot.step(action)
        self.global_time += self.time_step
        for i, (human, chosen) in enumerate(zip(humans, self._actions, strict=True)):
            human.step(chosen)
            if self.human_times[i] == 0 and math.dist((human.px, human.py), (human.gx, human.gy)) < human.radius:
                self.human_times[i] = self.global_time

    def render(self, *args: Any, **kwargs: Any) -> None:
        """Draw the episode with the fork's method. Newer versions of Matplotlib have moved its `plt.cm.get_cmap`."""
        import matplotlib.pyplot as plt

        plt.cm.get_cmap = plt.get_cmap
        super().render(*args, **kwargs)  # type: ignore[misc]


def _follows_orca(humans: list[Any]) -> bool:
    """Return whether all pedestrians are moved by CrowdNav's ORCA with the same parameters."""
    known = all(fingerprint(type(h).act) == ACT and fingerprint(type(h.policy).predict) == PREDICT for h in humans)
    names = "neighbor_dist", "max_neighbors", "time_horizon", "safety_space"
    return known and len({tuple(getattr(human.policy, name) for name in names) for human in humans}) == 1
