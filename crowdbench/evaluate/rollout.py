"""Drives a planner through cases, all in lock-step, and leaves a trace."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Int

from crowdbench.errors import InputError
from crowdbench.evaluate.driver import Driver
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario
from crowdbench.sim.simulator import advance, crowd_velocities, observe, step
from crowdbench.types import Outcome, Trace, World


def rollout(
    driver: Driver,
    scenario: Scenario,
    cases: Cases,
    *,
    replan_every: int = 1,
    keep_logs: bool = False,
    progress: Callable[[int], None] | None = None,
) -> Trace:
    """Drive the driver's planner through `cases`, each to its outcome.

    Worlds that have ended leave the batch. The planner is asked at every `replan_every`-th step, by `plan_ahead`
    for as many steps where that is not every step. `keep_logs` keeps what it logs; `progress` is told how many
    episodes have ended in each step. Raises InputError where planner or scenario break their contract, or
    `replan_every` is below 1.
    """
    if replan_every < 1:
        raise InputError(f"replan_every is {replan_every}, but a planner looks again after 1 step or more")
    world = scenario.worlds(cases)
    driver.reset(world.case)
    log = _Log(world)
    undisturbed = _walk_alone(scenario, world) if scenario.rules.visible else None
    rows = np.arange(len(world))
    for t in range(scenario.rules.max_steps):
        crowd = crowd_velocities(world, scenario.policies)
        ahead = t % replan_every
        if ahead == 0:
            obs = observe(
                world,
                future=crowd.copy() if driver.planner.privileged else None,
                record=functools.partial(log.log, rows, t) if keep_logs else None,
            )
            commands = driver.decide(obs)[:, None] if replan_every == 1 else driver.decide_ahead(obs, replan_every)
        after, outcome, gap = step(world, commands[:, ahead], crowd)
        log.step(rows, t, after, outcome, gap)
        running = outcome == Outcome.RUNNING
        if not running.all():
            after, rows, commands = after.take(running), rows[running], commands[running]
            if progress is not None:
                progress(int((~running).sum()))
        if not len(rows):
            break
        world = after
    return log.trace(cases.split, undisturbed)


def _walk_alone(scenario: Scenario, world: World) -> Float[np.ndarray, "world time pedestrian 2"]:
    """Where the pedestrians would walk if the vehicle were not there."""
    world = world.replace(rules=dataclasses.replace(world.rules, visible=False))
    positions = [world.position[:, 1:]]
    for _ in range(scenario.rules.max_steps):
        crowd = crowd_velocities(world, scenario.policies)
        world = advance(world, np.pad(crowd, ((0, 0), (1, 0), (0, 0))))
        positions.append(world.position[:, 1:])
    return np.stack(positions, axis=1)


class _Log:
    """Collects the arrays of a trace while worlds come and go."""

    def __init__(self, start: World) -> None:
        worlds, agents = start.radius.shape
        steps = start.rules.max_steps
        self.start = start
        self.outcome = np.zeros(worlds, np.int64)
        self.steps = np.zeros(worlds, np.int64)
        self.position = np.full((worlds, steps + 1, agents, 2), np.nan)
        self.velocity = np.full((worlds, steps + 1, agents, 2), np.nan)
        self.gap = np.full((worlds, steps), np.nan)
        self.logs: dict[str, np.ndarray] = {}
        self.position[:, 0] = start.position
        self.velocity[:, 0] = start.velocity

    def step(
        self,
        rows: Int[np.ndarray, "running"],
        t: int,
        after: World,
        outcome: Int[np.ndarray, "running"],
        gap: Float[np.ndarray, "running"],
    ) -> None:
        self.position[rows, t + 1] = after.position
        self.velocity[rows, t + 1] = after.velocity
        self.gap[rows, t] = gap
        self.outcome[rows] = outcome
        self.steps[rows] = t + 1

    def log(self, rows: Int[np.ndarray, "running"], t: int, name: str, values: np.ndarray) -> None:
        shape = (len(self.outcome), self.gap.shape[1], *np.shape(values)[1:])
        if name not in self.logs:
            self.logs[name] = np.full(shape, np.nan)
        self.logs[name][rows, t] = values

    def trace(self, split: str, undisturbed: Float[np.ndarray, "world time pedestrian 2"] | None) -> Trace:
        absent = ~self.start.present
        for states in (self.position, self.velocity):
            states.swapaxes(1, 2)[absent] = np.nan
        if undisturbed is not None:
            undisturbed[np.isnan(self.position[:, :, 1:])] = np.nan
        return Trace(
            split=split,
            case=self.start.case,
            outcome=self.outcome,
            steps=self.steps,
            position=self.position,
            velocity=self.velocity,
            gap=self.gap,
            goal=self.start.goal,
            radius=self.start.radius,
            preferred_speed=self.start.preferred_speed,
            present=self.start.present,
            rules=self.start.rules,
            undisturbed=undisturbed,
            logs=self.logs,
        )
