"""The metrics again, from a recording alone."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from crowdbench.evaluate.metrics import Metric
from crowdbench.evaluate.results import Episodes, to_json
from crowdbench.record.read import read
from crowdbench.types import Outcome


@dataclass(frozen=True)
class Score:
    """What a recording says: its episodes, and of how many cases of a run they are."""

    planner: str
    scenario: str
    cases: int
    episodes: Episodes

    @property
    def complete(self) -> bool:
        """Whether every case was recorded: the rates of some alone would mislead."""
        return len(self.episodes) == self.cases

    def to_json(self) -> dict[str, Any]:
        """Every recorded case, and the metrics' means where all cases were recorded."""
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
        metrics = {"metrics": to_json(self.episodes.summary())} if self.complete else {}
        return {"planner": self.planner, "scenario": self.scenario, "cases": self.cases, "episodes": rows, **metrics}


def score(path: Path, metrics: Mapping[str, Metric]) -> Score:
    """Measure a recording. Raises InputError where the file is none of crowdbench's, or broken."""
    recording = read(path)
    return Score(recording.planner, recording.scenario, recording.cases, Episodes.of(recording.trace, metrics))
