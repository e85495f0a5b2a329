"""A planner with the number of cases that it drives, in the TOML files of this folder."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from crowdbench.runs import Run, RunSpec, load_run
from crowdbench.utils import Name, TomlTable
from studies.schema import CasesText

MOVING = f"{Path(__file__).with_name('moving.py')}:t_close_moving"
"""The metric that the runs of the study have beside the built-in ones."""


class DrivenPlanner(TomlTable):
    """`[[planners]]`: a planner, and the cases of each scenario that it drives."""

    planner: Name
    cases: CasesText

    def load(self, scenario: str, overrides: Mapping[str, Any]) -> Run:
        """Load the run in a scenario with other values for some keys."""
        spec = RunSpec(self.planner, scenario, self.cases, overrides=overrides, metrics=(MOVING,), record="none")
        return load_run(spec)
