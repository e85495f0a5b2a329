"""Gymnasium: the vehicle acts in many worlds, which the batched simulator steps all at once."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import error
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from jaxtyping import Bool, Float

from crowdbench.envs import spaces, stepping
from crowdbench.envs.observations import flatten
from crowdbench.errors import InputError
from crowdbench.reward import reward
from crowdbench.scenario.scenario import Scenario
from crowdbench.sim.sensor import observe
from crowdbench.sim.simulator import crowd_velocities, step
from crowdbench.types import Outcome, World

LABELS = np.array(stepping.LABELS, object)


class VehicleVectorEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """The vehicle in `num_envs` worlds of a scenario, given by name, by the path of its file, or itself.

    Each world is what a `VehicleEnv` with its seed would be, and `autoreset_mode` means what it means to
    Gymnasium's `SyncVectorEnv`. Raises InputError where there is no such scenario.
    """

    def __init__(
        self,
        num_envs: int = 1,
        scenario: str | Path | Scenario = "circle_crossing_5",
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
    ) -> None:
        self.num_envs = num_envs
        self.scenario = stepping.as_scenario(scenario)
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {"render_modes": [], "autoreset_mode": self.autoreset_mode}
        self.single_observation_space = spaces.observation_space(self.scenario)
        self.single_action_space = spaces.vehicle_action_space(self.scenario)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._generators: list[np.random.Generator | None] = [None] * num_envs
        self._cases = np.full(num_envs, None, object)
        self._over = np.zeros(num_envs, bool)
        self._worlds: World | None = None

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Float[np.ndarray, "world features"], dict[str, Any]]:
        """Start new episodes: in all worlds, or in those of `options={"reset_mask": mask}`, a bool per world.

        `seed` is one per world, or the first world's, the others' being those that follow it.
        `options={"case": ...}` names one case for all worlds, or a list of one each; otherwise each world
        draws training cases from its seed. Raises InputError where an option is wrong.
        """
        options = options or {}
        mask = self._mask(options.get("reset_mask"))
        seeds = self._one_each(
            "seed", [int(seed) + w for w in range(self.num_envs)] if isinstance(seed, int | np.integer) else seed
        )
        case = options.get("case")
        cases = self._one_each("case", [case] * self.num_envs if isinstance(case, str) else case)
        for row in np.flatnonzero(mask).tolist():
            if seeds[row] is not None:
                self._generators[row], _ = seeding.np_random(seeds[row])
        self._worlds = self._restarted(self._worlds, mask, cases)
        self._over[mask] = False
        infos: dict[str, Any] = {}
        _tell(infos, mask, case=self._cases)
        return flatten(observe(self._worlds)), infos

    def step(
        self, actions: np.ndarray
    ) -> tuple[
        Float[np.ndarray, "world features"],
        Float[np.ndarray, "world"],
        Bool[np.ndarray, "world"],
        Bool[np.ndarray, "world"],
        dict[str, Any],
    ]:
        """Move everybody by one dt, the vehicles with velocities `[world, 2]`. The mode says when an episode restarts.

        Raises InputError where the actions are no finite velocities, and Gymnasium's ResetNeeded before the
        first reset or, where the mode is DISABLED, when an episode is over.
        """
        if self._worlds is None or (self.autoreset_mode == AutoresetMode.DISABLED and self._over.any()):
            raise error.ResetNeeded("call reset() first, for all worlds or for those whose episode is over")
        command = stepping.velocities(actions, (self.num_envs, 2))
        crowd = crowd_velocities(self._worlds, self.scenario.policies)
        worlds, (outcome, gap, _) = step(self._worlds, command, crowd)
        anew = self._over
        if anew.any():
            # NEXT_STEP: this step was their reset, and what the simulator made of the ended world is forgotten.
            worlds = self._restarted(worlds, anew)
            outcome[anew], gap[anew] = Outcome.RUNNING, np.inf
        rewards = reward(outcome, gap, self.scenario.rules.dt)
        truncated = outcome == Outcome.TIMEOUT
        terminated = (outcome != Outcome.RUNNING) & ~truncated
        self._over = terminated | truncated
        infos: dict[str, Any] = {}
        if self.autoreset_mode == AutoresetMode.SAME_STEP and self._over.any():
            anew, self._over = self._over, np.zeros(self.num_envs, bool)
            infos = self._final(worlds, anew, outcome, gap)
            worlds = self._restarted(worlds, anew)
        _tell(infos, ~anew, outcome=LABELS[outcome], gap=gap)
        _tell(infos, np.ones(self.num_envs, bool), case=self._cases)
        self._worlds = worlds
        return flatten(observe(worlds)), rewards, terminated, truncated, infos

    def _restarted(
        self, worlds: World | None, mask: Bool[np.ndarray, "world"], cases: Sequence[str | None] | None = None
    ) -> World:
        """The worlds with new episodes in some of them, in the given cases or else in drawn ones."""
        rows = np.flatnonzero(mask)
        names = [self._case(row, cases[row] if cases else None) for row in rows.tolist()]
        fresh = stepping.start(self.scenario, names)
        self._cases[rows] = names
        return fresh if worlds is None or mask.all() else worlds.put(rows, fresh)

    def _case(self, row: int, case: str | None) -> str:
        generator = self._generators[row]
        if generator is None:
            generator = self._generators[row] = seeding.np_random()[0]
        return stepping.chosen_case(case, generator)

    def _final(
        self, worlds: World, ended: Bool[np.ndarray, "world"], outcome: np.ndarray, gap: Float[np.ndarray, "world"]
    ) -> dict[str, Any]:
        """What the worlds that ended in this step were like before their reset."""
        final_obs = np.full(self.num_envs, None, object)
        for row, obs in zip(np.flatnonzero(ended), flatten(observe(worlds.take(ended))), strict=True):
            final_obs[row] = obs
        final_info: dict[str, Any] = {}
        _tell(final_info, ended, outcome=LABELS[outcome], gap=gap, case=self._cases)
        return {"final_obs": final_obs, "_final_obs": ended, "final_info": final_info, "_final_info": ended.copy()}

    def _mask(self, mask: object) -> Bool[np.ndarray, "world"]:
        if mask is None:
            return np.ones(self.num_envs, bool)
        if not isinstance(mask, np.ndarray) or mask.dtype != bool or mask.shape != (self.num_envs,) or not mask.any():
            raise InputError(f"reset_mask is {mask!r}, but must be an array of {self.num_envs} bools, one of them True")
        if self._worlds is None and not mask.all():
            raise InputError("reset_mask leaves worlds out that were never reset: reset all of them first")
        return mask

    def _one_each(self, name: str, values: Sequence[Any] | None) -> Sequence[Any]:
        if values is None:
            return [None] * self.num_envs
        if len(values) != self.num_envs:
            raise InputError(f"{name} has {len(values)} values, but there are {self.num_envs} worlds")
        return values


def _tell(infos: dict[str, Any], mask: Bool[np.ndarray, "world"], **values: np.ndarray) -> None:
    """Put values into infos as Gymnasium does: each beside a mask that tells which worlds have it."""
    if mask.any():
        for name, value in values.items():
            infos[name] = np.full_like(value, None if value.dtype == object else 0)
            infos[name][mask] = value[mask]
            infos[f"_{name}"] = mask.copy()
