"""The command that checks whether a planner keeps its contract."""

from __future__ import annotations

from typing import Annotated

import typer

from crowdbench.cli.options import CasesOption, LimitOption, OptionOption, ScenarioOption, assignments, print_table
from crowdbench.settings import DECISION_LIMIT


def check(
    planner: Annotated[str, typer.Argument(help="A planner's name, or a file: ./mine.py or ./mine.py:factory.")],
    option: OptionOption = None,
    scenario: ScenarioOption = "circle_crossing_5",
    cases: CasesOption = "val:20",
    decision_limit: LimitOption = DECISION_LIMIT,
) -> None:
    """Check point by point whether a planner keeps the contract: valid commands, in time, the same in any batch."""
    from crowdbench import catalog
    from crowdbench.cli.console import announce_compilation
    from crowdbench.cli.tables import check_table
    from crowdbench.evaluate.check import check as examine
    from crowdbench.scenario.cases import Cases

    announce_compilation()
    options = assignments(option or [], "--option")
    name, _ = catalog.load_planner(planner, options)
    points = examine(
        lambda: catalog.load_planner(planner, options)[1],
        name,
        catalog.load_scenario(scenario),
        Cases.parse(cases),
        decision_limit,
    )
    print_table(check_table(name, points))
    if not all(point.kept for point in points):
        raise typer.Exit(1)
