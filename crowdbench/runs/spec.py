"""Specification of a run, which any process can load: names, files, values, and steps at which the planner observes."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from crowdbench.utils.defaults import BATCH, DECISION_LIMIT, RECORD
from crowdbench.utils.errors import InputError

if TYPE_CHECKING:  # commands import this module before numba may be imported: see `cli.options.use_threads`
    from crowdbench.scenario.cases import Cases

LOOK_FIRST = 8
"""Default number of positions that a planner observes before it returns several commands at once.

It is the number of observed steps of the predictors (Gupta et al. 2018) and the length of `Pedestrians.history`.
"""


@dataclass(frozen=True)
class Replanning:
    """Steps at which a planner observes, and number of commands that it returns for each observation.

    If `every` is above 1, it decides at every single step until it has observed the pedestrians at `look_first`
    positions. Before that, the observed motion is too short for predictors. Li et al. (2020) do not describe the first
    steps of the episodes in their experiment 2.

    Attributes:
        every: Commands per observation.
        look_first: Positions to observe before several commands are returned at once; 1 starts with several commands.
            No effect if `every` is 1.

    Raises:
        InputError: `every` or `look_first` is below 1.
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
        """Return the number of commands that the planner returns if it observes before a step."""
        return self.every if step >= self.look_first - 1 else 1

    @property
    def settings(self) -> dict[str, int]:
        """The settings as in names and results; empty if the planner observes at every step."""
        return {} if self.every == 1 else {"replan_every": self.every, "look_first": self.look_first}


EVERY_STEP = Replanning()
"""The planner observes at every step."""


@dataclass(frozen=True)
class RunSpec:
    """Specification of a run that is not loaded yet. Its fields are the options of `crowdbench run`.

    Attributes:
        planner: The name or the file of the planner.
        scenario: The name or the file of the scenario.
        cases: The cases.
        options: The planner's options by name.
        overrides: Other values for keys of the scenario, by dotted key.
        pedestrians: The name or the file of the policy that moves all pedestrians.
        metrics: Files with metrics of the user.
        replanning: The steps at which the planner observes.
        record: Extent of the recording, one of `defaults.RECORD`.
        batch: Number of cases that run in lock-step, fewer if their traces would take too much memory.
        isolated: True if the planner runs in a separate process.
        decision_limit: Seconds that the planner may take for a decision.
        data: The folder with recorded tracks.
        others: The name or the file of the planner of all vehicles but the first, which alone is scored; None if
            `planner` drives and is scored in all vehicles.

    Raises:
        InputError: `record` is not one of `defaults.RECORD`.
    """

    planner: str
    scenario: str
    cases: Cases
    _: KW_ONLY
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
    others: str | None = None

    def __post_init__(self) -> None:
        if self.record not in RECORD:
            raise InputError(f"record {self.record!r} is not one of {', '.join(RECORD)}")

    @property
    def changes(self) -> dict[str, Any]:
        """Changes of the scenario, as in results."""
        return {**self.overrides} | ({"pedestrians": self.pedestrians} if self.pedestrians else {})

    @property
    def team(self) -> dict[str, str]:
        """The planner of the other vehicles, as in names; empty if `planner` drives all vehicles."""
        return {} if self.others is None else {"others": self.others}


def directory_name(planner: str, scenario: str, spec: RunSpec) -> str:
    """Return the name of a run's directory, such as `orca-circle_crossing_5-500`, from the loaded planner and
    scenario."""
    cases = spec.cases
    count = f"{cases.stop}" if cases.start == 0 else f"{cases.start}-{cases.stop}"
    parts = [planner, scenario, count if cases.split == "test" else f"{cases.split}-{count}"]
    changes = {**spec.options, **spec.changes, **spec.replanning.settings, **spec.team}
    parts += [f"{key}={value}" for key, value in changes.items()]
    # File systems allow 255 bytes, and the directory has a longer name while it is written.
    return re.sub(r"[^A-Za-z0-9_.=-]+", "_", "-".join(parts))[:200]
