"""A run as a user writes it, which another process can load: names, files, values, and when the planner observes."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from crowdbench.utils.defaults import BATCH, DECISION_LIMIT, RECORD
from crowdbench.utils.errors import InputError

if TYPE_CHECKING:  # commands read this module before numba may be imported: see `cli.options.use_threads`
    from crowdbench.scenario.cases import Cases

LOOK_FIRST = 8
"""Positions that a planner sees before it gives several commands at once, where nothing else is asked for.

It is the number of observed steps of the predictors (Gupta et al. 2018) and the length of `Pedestrians.history`.
"""


@dataclass(frozen=True)
class Replanning:
    """At which steps a planner observes, and for how many steps it then gives commands.

    Where `every` is above 1, it decides at every single step until it has seen the pedestrians at `look_first`
    positions. Before that nobody has moved for long, and no predictor can tell where anybody is going. Experiment 2 of
    Li et al. (2020) does not say how its episodes begin.

    Attributes:
        every: Commands per observation.
        look_first: Positions to see before several commands are given at once; 1 starts with several at once. Without
            effect where `every` is 1.

    Raises:
        InputError: One of them is below 1.
    """

    every: int = 1
    look_first: int = LOOK_FIRST

    def __post_init__(self) -> None:
        if self.every < 1:
            raise InputError(f"replan_every is {self.every}, but a planner observes again after 1 step or more")
        if self.look_first < 1:
            raise InputError(
                f"look_first is {self.look_first}, but a planner sees 1 position or more at its first step"
            )

    def steps_executed(self, step: int) -> int:
        """Return how many commands of the last observation are executed before a step; the step is counted from 0."""
        return max(0, step - self.look_first + 1) % self.every

    def steps_to_plan(self, step: int) -> int:
        """Return the number of steps for which the planner gives commands when it observes before a step."""
        return self.every if step >= self.look_first - 1 else 1

    @property
    def settings(self) -> dict[str, int]:
        """The settings as names and results show them; nothing where the planner observes every step."""
        return {} if self.every == 1 else {"replan_every": self.every, "look_first": self.look_first}


EVERY_STEP = Replanning()
"""The planner observes at every step."""


@dataclass(frozen=True)
class RunSpec:
    """A run that is not loaded yet. Its fields are what the options of `crowdbench run` say.

    Attributes:
        planner: The name or the file of the planner.
        scenario: The name or the file of the scenario.
        cases: The cases.
        options: The planner's options by name.
        overrides: Other values for keys of the scenario, by dotted key.
        pedestrians: The name or the file of the policy that moves all pedestrians.
        metrics: Files with metrics of the user's own.
        replanning: When the planner observes.
        record: Extent of the recording, one of `defaults.RECORD`.
        batch: Cases that run in lock-step, fewer where their traces would take too much memory.
        isolated: True if the planner runs in a process of its own.
        decision_limit: Seconds that the planner may take for a decision.
        data: The folder with recorded tracks.

    Raises:
        InputError: There is no such way to record.
    """

    planner: str
    scenario: str
    cases: Cases
    options: Mapping[str, Any] = field(default_factory=dict)
    overrides: Mapping[str, Any] = field(default_factory=dict)
    pedestrians: str | None = None
    metrics: tuple[str, ...] = ()
    replanning: Replanning = EVERY_STEP
    record: str = RECORD[0]
    batch: int = BATCH
    isolated: bool = False
    decision_limit: float = DECISION_LIMIT
    data: Path | None = None

    def __post_init__(self) -> None:
        if self.record not in RECORD:
            raise InputError(f"record {self.record!r} is not one of {', '.join(RECORD)}")

    @property
    def changes(self) -> dict[str, Any]:
        """Changes of the scenario, as in results."""
        return {**self.overrides} | ({"pedestrians": self.pedestrians} if self.pedestrians else {})


def directory_name(planner: str, scenario: str, spec: RunSpec) -> str:
    """Return the name of a run's directory, such as `orca-circle_crossing_5-500`, from the names of what it has
    loaded."""
    cases = spec.cases
    count = f"{cases.stop}" if cases.start == 0 else f"{cases.start}-{cases.stop}"
    parts = [planner, scenario, count if cases.split == "test" else f"{cases.split}-{count}"]
    changes = {**spec.options, **spec.changes, **spec.replanning.settings}
    parts += [f"{key}={value}" for key, value in changes.items()]
    # File systems allow 255 bytes, and the directory has a longer name while it is written.
    return re.sub(r"[^A-Za-z0-9_.=-]+", "_", "-".join(parts))[:200]
