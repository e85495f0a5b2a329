"""What a study's TOML file may hold: its tables, their keys, and the default of each key.

Planners, options, scenarios and overrides are what one would give to `crowdbench run`.
"""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, Field, InstanceOf

from crowdbench.runs.spec import LOOK_FIRST
from crowdbench.scenario.cases import Cases
from crowdbench.study.measures import PLANNER_MEASURES
from crowdbench.utils.toml import Name, Names, Text, TomlTable, Values, choice, integer, number, table


def _cases(value: Any) -> Any:
    return Cases.parse(value) if isinstance(value, str) else value


def _known(measures: list[str]) -> list[str]:
    if not set(measures) <= set(PLANNER_MEASURES):
        raise ValueError
    return measures


CasesText = Annotated[
    InstanceOf[Cases], BeforeValidator(_cases), Field(description='a text in quotes, such as "test:500"')
]


class ReportedSpec(TomlTable):
    """`reported`: what somebody else measured, by metric, in the metrics' own units."""

    success_rate: float | None = number(None, least=0.0, below=1000.0)
    navigation_time: float | None = number(None, least=0.0, below=1000.0)
    max_velocity_change: float | None = number(None, least=0.0, below=1000.0)
    jerk: float | None = number(None, least=0.0, below=1000.0)


class RowSpec(TomlTable):
    """`[[tables.rows]]`: a planner, with each of several networks or seeds or without any, and what the table calls it.

    Seeds are values of the planner's option `seed`. They are shown as networks are.

    The first network, which is the shipped one, is run on the cases of `second_reading` too, where there are any: cases
    that nobody has looked at, while those of the table have been looked at often.
    """

    label: Text = ""
    planner: Name
    weights: Names = Field(default=[])
    seeds: list[int] = Field(default=[], description="a list of whole numbers")
    options: Values = Field(default={})
    reported: ReportedSpec = table("reported")
    second_reading: CasesText | None = None


class VariantSpec(TomlTable):
    """`variant`: the same runs under another rule of the scenario, with all networks of a row or its first."""

    title: Name
    overrides: Values = Field(default={})
    networks: str = choice(("all", "first"), default="all")


class PlannersSpec(TomlTable):
    """`[[tables]]`: planners on the cases of one scenario."""

    title: Name
    scenario: Name
    replan_every: int = integer(1, least=1, most=1000)
    look_first: int = integer(LOOK_FIRST, least=1, most=1000)
    cases: CasesText = Cases.parse("test:500")
    measures: Annotated[Names, AfterValidator(_known)] = Field(
        default=list(PLANNER_MEASURES),
        description=f"a list of some of {', '.join(PLANNER_MEASURES)}, none of them twice",
    )
    variant: VariantSpec | None = Field(default=None, description="a table with a title and overrides")
    rows: list[RowSpec] = Field(min_length=1, description="one table or more")


class CrowdPlannerSpec(TomlTable):
    """A planner with its options; a name or a file stands for one without options."""

    planner: Name
    options: Values = Field(default={})


def _named(planner: Any) -> Any:
    return {"planner": planner} if isinstance(planner, str) else planner


Planners = Annotated[
    list[Annotated[CrowdPlannerSpec, BeforeValidator(_named)]],
    Field(
        min_length=1, description='a list of names such as "orca", or tables such as { planner = "orca", options = {} }'
    ),
]


class CrowdsSpec(TomlTable):
    """`[[crowds]]`: planners in several scenarios; "all" stands for all built-in ones without `[tracks]`."""

    title: Name
    planners: Planners
    scenarios: Annotated[str, Field(pattern="^all$")] | Names = Field(description='"all" or a list of scenarios')
    overrides: Values = Field(default={})
    cases: CasesText = Cases.parse("test:500")


class StudyHead(TomlTable):
    """The description of a study, and its references."""

    description: Text = ""
    sources: list[Text] = Field(default=[], description="a list of texts in quotes")


class StudySpec(StudyHead):
    """The whole file."""

    tables: list[PlannersSpec] = Field(default=[], description="a list of tables [[tables]]")
    crowds: list[CrowdsSpec] = Field(default=[], description="a list of tables [[crowds]]")
