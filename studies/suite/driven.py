"""A planner with the cases that it drives, in the TOML files of this folder."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from crowdbench.runs import Run, RunSpec, load_run
from crowdbench.utils import Text
from studies.schema import CasesText, PlannerSpec

MOVING = f"{Path(__file__).with_name('moving.py')}:t_close_moving"
"""The metric that the runs of the study have beside the built-in ones."""


class DrivenPlanner(PlannerSpec):
    """`[[planners]]`: a planner with its options, and the cases of each scenario that it drives."""

    label: Text = ""
    cases: CasesText

    @property
    def name(self) -> str:
        """Its name in tables."""
        return self.label or self.planner

    def load(self, scenario: str, overrides: Mapping[str, Any], pedestrians: str | None = None) -> list[Run]:
        """Load a run with each of its networks.

        Args:
            scenario: The name of the scenario.
            overrides: Other values for keys of the scenario.
            pedestrians: A pedestrian policy that replaces that of the scenario.
        """
        base = RunSpec(
            self.planner,
            scenario,
            self.cases,
            overrides=overrides,
            pedestrians=pedestrians,
            metrics=(MOVING,),
            record="none",
        )
        return [load_run(replace(base, options=options)) for options in self.choices]
