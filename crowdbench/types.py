"""The data that everything is made of: worlds, what a planner sees of them, and what an episode leaves.

Axes always come in the order world, action, mode, time, agent, xy. Agent 0 is the vehicle, the others
are pedestrians; an axis called `pedestrian` leaves the vehicle out. Units are SI: metres, seconds,
metres per second, radians.
"""

from __future__ import annotations

import dataclasses
import enum
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, UInt

from crowdbench import rng
from crowdbench.errors import InputError

HISTORY = 8
"""Number of past positions in an observation, the present one included."""

COLLISION_RULES = ("swept", "crowdnav")
"""The two collision tests, see `crowdbench.sim.simulator.judge`."""

DISCOMFORT_GAP = 0.2
"""A gap below this, in metres, is uncomfortable (Chen et al. 2019)."""


class Outcome(enum.IntEnum):
    """How an episode ended, or that it goes on."""

    RUNNING = 0
    SUCCESS = 1
    COLLISION = 2
    TIMEOUT = 3

    @property
    def label(self) -> str:
        """The lower-case word used in files and tables."""
        return self.name.lower()


@dataclass(frozen=True)
class Rules:
    """What a scenario fixes for all its cases.

    `collision` is "swept" (true relative motion over the step) or "crowdnav" (pedestrians swept with
    their velocity before the step). `visible` says whether pedestrians see the vehicle.
    """

    dt: float = 0.25
    time_limit: float = 25.0
    collision: str = "swept"
    visible: bool = False

    def __post_init__(self) -> None:
        if self.collision not in COLLISION_RULES:
            raise InputError(f"collision is {self.collision!r}, but must be one of {', '.join(COLLISION_RULES)}")

    @property
    def max_steps(self) -> int:
        """Steps after which every episode has ended.

        As in CrowdNav, the step is the last whose clock, before it, is within a second of the limit or later.
        """
        return int(np.ceil((self.time_limit - 1.0) / self.dt - 1e-9)) + 1


@dataclass(frozen=True)
class World:
    """A batch of running simulations. Immutable: the simulator returns a new one.

    `present` is False for the padding of worlds with fewer pedestrians than the widest: such agents stand at
    the origin with radius and speed 1, so that no formula divides by zero. `history` holds
    the pedestrians' last positions, oldest first; before there are enough, the first position is
    repeated backwards. `policy` tells by its place in `parameters` which of the scenario's policies moves
    each pedestrian; `parameters[name]` is what that policy is given (column 0, the vehicle's, is not
    used). `key` starts the random streams of a case.
    """

    case: Int[np.ndarray, "world"]
    key: UInt[np.ndarray, "world"]
    step: Int[np.ndarray, "world"]
    position: Float[np.ndarray, "world agent 2"]
    velocity: Float[np.ndarray, "world agent 2"]
    goal: Float[np.ndarray, "world agent 2"]
    radius: Float[np.ndarray, "world agent"]
    preferred_speed: Float[np.ndarray, "world agent"]
    present: Bool[np.ndarray, "world agent"]
    history: Float[np.ndarray, "world time pedestrian 2"]
    policy: Int[np.ndarray, "world pedestrian"]
    parameters: Mapping[str, Mapping[str, Float[np.ndarray, "world agent"]]]
    rules: Rules

    def __len__(self) -> int:
        return len(self.case)

    def replace(self, **changes: object) -> World:
        """A copy in which the named fields are other arrays."""
        return dataclasses.replace(self, **changes)  # type: ignore[arg-type]

    def take(self, rows: np.ndarray) -> World:
        """The worlds of the given rows, a mask or indices."""
        return self._map(lambda own: own[rows])

    def put(self, rows: Int[np.ndarray, "row"], others: World) -> World:
        """These worlds with other ones, of the same scenario, in the given rows."""

        def replaced(own: np.ndarray, other: np.ndarray) -> np.ndarray:
            both = own.copy()
            both[rows] = other
            return both

        return self._map(replaced, others)

    def _map(self, function: Callable[..., np.ndarray], *others: World) -> World:
        """The worlds that a function makes of each array here and in the others."""
        worlds = (self, *others)
        arrays = {
            field.name: function(*(getattr(world, field.name) for world in worlds))
            for field in dataclasses.fields(self)
            if field.name not in ("parameters", "rules")
        }
        parameters = {
            policy: {name: function(*(world.parameters[policy][name] for world in worlds)) for name in table}
            for policy, table in self.parameters.items()
        }
        return World(**arrays, parameters=parameters, rules=self.rules)


@dataclass(frozen=True)
class Vehicle:
    """The vehicle as its planner sees it."""

    position: Float[np.ndarray, "*world 2"]
    velocity: Float[np.ndarray, "*world 2"]
    goal: Float[np.ndarray, "*world 2"]
    radius: Float[np.ndarray, "*world"]
    preferred_speed: Float[np.ndarray, "*world"]


@dataclass(frozen=True)
class Pedestrians:
    """The pedestrians as the vehicle sees them: their goals and policies are not to be seen.

    Only those that are `present` are there: the rest, at the origin, is padding and must be left out.
    `history` is the last 8 positions, oldest first, the last one the present; `observed` says how many
    of them were really seen, the earlier ones repeat the first.
    """

    position: Float[np.ndarray, "*world pedestrian 2"]
    velocity: Float[np.ndarray, "*world pedestrian 2"]
    radius: Float[np.ndarray, "*world pedestrian"]
    present: Bool[np.ndarray, "*world pedestrian"]
    history: Float[np.ndarray, "*world time pedestrian 2"]
    observed: Int[np.ndarray, "*world"]


@dataclass(frozen=True)
class Observation:
    """What a planner is given when it is asked, for every world that is still running.

    `case` tells which case each row is: worlds that have ended leave the batch, so a planner with a
    memory keys it by case. A planner for one world at a time sees the same without the world axis.
    """

    vehicle: Vehicle
    pedestrians: Pedestrians
    case: Int[np.ndarray, "*world"]
    key: UInt[np.ndarray, "*world"]
    step: Int[np.ndarray, "*world"]
    dt: float
    future: Float[np.ndarray, "*world pedestrian 2"] | None = None
    record: Callable[[str, np.ndarray], None] | None = None

    def __len__(self) -> int:
        return len(self.case)

    def take(self, rows: np.ndarray | slice) -> Observation:
        """The worlds of the given rows (a mask, indices, a slice), in arrays of their own; what is logged is lost."""

        def taken(part: Any) -> dict[str, np.ndarray]:
            arrays = {field.name: getattr(part, field.name) for field in dataclasses.fields(part)}
            return {name: array[rows].copy() for name, array in arrays.items() if isinstance(array, np.ndarray)}

        vehicle, pedestrians = Vehicle(**taken(self.vehicle)), Pedestrians(**taken(self.pedestrians))
        return dataclasses.replace(self, vehicle=vehicle, pedestrians=pedestrians, record=None, **taken(self))  # type: ignore[arg-type]

    @property
    def time(self) -> Float[np.ndarray, "*world"]:
        """Seconds since the start."""
        return np.asarray(self.step * self.dt)

    def everybody(
        self,
    ) -> tuple[
        Float[np.ndarray, "world agent 2"],
        Float[np.ndarray, "world agent 2"],
        Float[np.ndarray, "world agent"],
        Bool[np.ndarray, "world agent"],
    ]:
        """Position, velocity, radius and presence of all agents, the vehicle first. For batches only."""
        vehicle, crowd = self.vehicle, self.pedestrians
        return (
            np.concatenate([vehicle.position[:, None], crowd.position], axis=1),
            np.concatenate([vehicle.velocity[:, None], crowd.velocity], axis=1),
            np.concatenate([vehicle.radius[:, None], crowd.radius], axis=1),
            np.concatenate([np.ones((len(self), 1), bool), crowd.present], axis=1),
        )

    def normal(self, purpose: str, n: int) -> Float[np.ndarray, "*world pedestrian n"]:
        """Standard normal noise that depends on seed, case, purpose, step and pedestrian alone.

        It is the same in any batch, at any padding, however often it is asked for.
        """
        pedestrians = self.pedestrians.present.shape[-1]
        # Apart from the simulator's own streams, which no planner may foresee.
        own = f"planner: {purpose}"
        noise = rng.normal(np.atleast_1d(self.key), own, np.atleast_1d(self.step), pedestrians, n)
        return noise.reshape(*np.shape(self.key), pedestrians, n)

    def true_next(self) -> Float[np.ndarray, "*world pedestrian 2"]:
        """The velocities the pedestrians will really take in this step.

        Raises PermissionError unless the planner is `privileged`.
        """
        if self.future is None:
            raise PermissionError(
                "true_next() shows what no vehicle can see: only a planner with `privileged = True` may call it"
            )
        return self.future

    def log(self, name: str, values: np.ndarray | float) -> None:
        """Put something of the planner's own, `[world, ...]`, into the recording.

        Each world's number or numbers `[n]` become curves, `[n, xy]` points, `[..., time, n, xy]` lines over time.
        Raises InputError where the name has other characters than letters, digits and underscores, or a digit first.
        """
        if not name.isidentifier():
            raise InputError(
                f"a log is called {name!r}, but its name must be letters, digits and underscores, a letter first"
            )
        if self.record is not None:
            self.record(name, np.asarray(values))


@dataclass(frozen=True)
class Trace:
    """The episodes that a rollout leaves; metrics are functions of it.

    States are indexed by `time` from 0 (the start) to `steps`, and NaN beyond; step t leads from state
    t to state t + 1, so the command of step t is `velocity[:, t + 1, 0]`. `gap[:, t]` is the closest
    distance between the rims of the vehicle and any pedestrian during step t, as the judge measured it
    (infinite among no pedestrians). `undisturbed` holds where the pedestrians walk when the vehicle is
    not there; it is kept only where they see the vehicle. `logs` holds what the planner logged, `[world, step, ...]`,
    NaN in steps at which it was not asked.
    """

    split: str
    case: Int[np.ndarray, "world"]
    outcome: Int[np.ndarray, "world"]
    steps: Int[np.ndarray, "world"]
    position: Float[np.ndarray, "world time agent 2"]
    velocity: Float[np.ndarray, "world time agent 2"]
    gap: Float[np.ndarray, "world step"]
    goal: Float[np.ndarray, "world agent 2"]
    radius: Float[np.ndarray, "world agent"]
    preferred_speed: Float[np.ndarray, "world agent"]
    present: Bool[np.ndarray, "world agent"]
    rules: Rules
    undisturbed: Float[np.ndarray, "world time pedestrian 2"] | None = None
    logs: Mapping[str, np.ndarray] = dataclasses.field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.case)
