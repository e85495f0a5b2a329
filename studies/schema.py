"""The content of a study's TOML file: its tables, their keys, and the default of each key.

Planners, options, scenarios and overrides have the same values as for `crowdbench run`.
"""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator, Field, InstanceOf

from crowdbench import Cases
from crowdbench.runs import LOOK_FIRST
from crowdbench.utils import Name, Names, Text, TomlTable, Values, integer


def _cases(value: Any) -> Any:
    return Cases.parse(value) if isinstance(value, str) else value


CasesText = Annotated[
    InstanceOf[Cases], BeforeValidator(_cases), Field(description='a text in quotes, such as "test:500"')
]


class PlannerSpec(TomlTable):
    """A planner with its options; a name or a file means a planner without options. Each of its `weights` is a run."""

    planner: Name
    weights: Names = Field(default=[])
    options: Values = Field(default={})

    @property
    def choices(self) -> list[dict[str, Any]]:
        """The options of its runs."""
        return [{"weights": weights, **self.options} for weights in self.weights] or [self.options]


def _named(planner: Any) -> Any:
    return {"planner": planner} if isinstance(planner, str) else planner


Planners = Annotated[
    list[Annotated[PlannerSpec, BeforeValidator(_named)]],
    Field(
        min_length=1, description='a list of names such as "orca", or tables such as { planner = "orca", options = {} }'
    ),
]


class TableSpec(TomlTable):
    """`[[tables]]`: planners in several scenarios; "all" means all built-in scenarios without `[tracks]`."""

    title: Name
    planners: Planners
    scenarios: Annotated[str, Field(pattern="^all$")] | Names = Field(description='"all" or a list of scenarios')
    overrides: Values = Field(default={})
    cases: CasesText = Cases.parse("test:500")
    replan_every: int = integer(1, least=1, most=1000)
    look_first: int = integer(LOOK_FIRST, least=1, most=1000)


class StudyHead(TomlTable):
    """The description of a study, and its references."""

    description: Text = ""
    sources: list[Text] = Field(default=[], description="a list of texts in quotes")
