"""The metrics, computed from a recording alone."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from crowdbench.core.types import Outcome
from crowdbench.metrics import Metric
from crowdbench.record.contents import read
from crowdbench.runs.results import Episodes, to_json


@dataclass(frozen=True)
class Score:
    """What is measured in a recording.

    Attributes:
        planner: The planner's name with its options.
        scenario: The scenario's name.
        cases: The number of cases of the run, of which some or all were recorded.
        episodes: The recorded ones.
    """

    planner: str
    scenario: str
    cases: int
    episodes: Episodes

    @property
    def complete(self) -> bool:
        """Whether every case was recorded: the rates of a part would be biased, because failures are preferred."""
        return len(self.episodes) == self.cases

    def to_json(self) -> dict[str, Any]:
        """Every recorded case, and the metrics' means if all cases were recorded."""
        rows = [
            {"case": case, "outcome": Outcome(outcome).label, "steps": steps}
            | {name: values[row].item() for name, values in self.episodes.columns.items()}
            for row, (case, outcome, steps) in enumerate(
                zip(
                    self.episodes.case.tolist(),
                    self.episodes.outcome.tolist(),
                    self.episodes.steps.tolist(),
                    strict=True,
                )
            )
        ]
        for row in rows:
            row |= {name: None for name, value in row.items() if isinstance(value, float) and not math.isfinite(value)}
        found = {"planner": self.planner, "scenario": self.scenario, "cases": self.cases, "episodes": rows}
        if self.complete:
            found |= {"metrics": to_json(self.episodes.summary()), "rates": self.episodes.rates}
        return found


def score(path: Path, metrics: Mapping[str, Metric]) -> Score:
    """Measure a recording.

    Args:
        path: The recording, an `.rrd` file.
        metrics: What is measured, by name.

    Raises:
        InputError: The file is not a recording of crowdbench, or is damaged.
    """
    recording = read(path)
    return Score(recording.planner, recording.scenario, recording.cases, Episodes.of(recording.trace, metrics))
