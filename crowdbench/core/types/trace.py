"""Traces of episodes."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.core.types.rules import Rules


@dataclass(frozen=True)
class Trace:
    """Episodes as a rollout returns them. Metrics are functions of a trace.

    The axis `time` counts states from 0 (the start) to `steps`; the axis `step` counts the steps between them: step t
    leads from state t to state t + 1. Position, velocity, heading, command and gaps are NaN after an episode's end.
    Position and velocity of agents that are not `present` are NaN. Do not write to the arrays: those that do not change
    in an episode (goals, radii, ...) may share memory between times.

    Attributes:
        split: The split of the cases.
        case: Number of each case.
        outcome: How each episode ended, an `Outcome`.
        steps: Number of steps of each episode.
        position: Centres in metres.
        velocity: Velocities in m/s during the step before each state.
        heading: Direction in which the vehicle faces, in radians.
        command: The planner's command in each step, in m/s.
        gap: Smallest distance in metres between the rims of the vehicle and any pedestrian during each step, as the
            simulator's collision check measured it; infinite without pedestrians.
        wall_gap: The same between the vehicle's rim and the obstacles; infinite without obstacles.
        goal: Where each agent is going, in metres.
        radius: Radii in metres.
        preferred_speed: Preferred and largest speed in m/s of each agent that was there at the start.
        present: Whether the agent exists then.
        person: Number of each pedestrian as a person, unique within the case; -1 in the padding. Where it changes,
            somebody else has taken the place of that pedestrian in the arrays, at another position.
        seen: Whether the vehicle saw the pedestrian; with a delay, whether it did so then.
        route: The vehicle's waypoints in metres as it started, NaN after the last one.
        obstacles: Polygons in metres, NaN after the last corner; two corners are a wall.
        rules: The rules of the scenario.
        undisturbed: Where the pedestrians would walk without the vehicle, in metres, NaN where it would be somebody
            else; None where they do not see it.
        perceived: Where the vehicle saw each pedestrian, or remembered it to be, in metres, as in its observation; NaN
            of the others. None where it saw everybody exactly and at once.
        age: Seconds since each pedestrian was where the vehicle last measured it, infinite of those that it neither saw
            nor remembered; None as above.
        block: The block of recorded time that each case is from: cases of the same block are not independent. None
            where nobody is recorded.
        group: Number of the group that each pedestrian walks with, unique within the case; -1 for those who walk alone.
            None where the scenario has no groups.
        logs: What the planner logged, `[world, step, ...]` by name; NaN in steps in which it logged nothing.
    """

    split: str
    case: Int[np.ndarray, "world"]
    outcome: Int[np.ndarray, "world"]
    steps: Int[np.ndarray, "world"]
    position: Float[np.ndarray, "world time agent 2"]
    velocity: Float[np.ndarray, "world time agent 2"]
    heading: Float[np.ndarray, "world time"]
    command: Float[np.ndarray, "world step 2"]
    gap: Float[np.ndarray, "world step"]
    wall_gap: Float[np.ndarray, "world step"]
    goal: Float[np.ndarray, "world time agent 2"]
    radius: Float[np.ndarray, "world time agent"]
    preferred_speed: Float[np.ndarray, "world agent"]
    present: Bool[np.ndarray, "world time agent"]
    person: Int[np.ndarray, "world time pedestrian"]
    seen: Bool[np.ndarray, "world time pedestrian"]
    route: Float[np.ndarray, "world waypoint 2"]
    obstacles: Float[np.ndarray, "world polygon corner 2"]
    rules: Rules
    undisturbed: Float[np.ndarray, "world time pedestrian 2"] | None = None
    perceived: Float[np.ndarray, "world time pedestrian 2"] | None = None
    age: Float[np.ndarray, "world time pedestrian"] | None = None
    block: Int[np.ndarray, "world"] | None = None
    group: Int[np.ndarray, "world time pedestrian"] | None = None
    logs: Mapping[str, np.ndarray] = dataclasses.field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.case)
