"""A planner with the number of cases that it drives, in the TOML files of this folder."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from crowdbench.runs import Run, RunSpec, load_run
from crowdbench.utils import Name, TomlTable
from studies.schema import CasesText


class DrivenPlanner(TomlTable):
    """`[[planners]]`: a planner, and the cases of each scenario that it drives."""

    planner: Name
    cases: CasesText

    def load(self, scenario: str, overrides: Mapping[str, Any]) -> Run:
        """Load the run in a scenario with other values for some keys."""
        return load_run(RunSpec(self.planner, scenario, self.cases, overrides=overrides, record="none"))
