"""The command that checks a plug-in against the contract of its kind."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from crowdbench.cli.console import BAD, GOOD, announce_compilation, print_table, progress
from crowdbench.cli.options import assignments
from crowdbench.utils.defaults import DECISION_LIMIT
from crowdbench.utils.errors import InputError
from crowdbench.utils.tables import Grid

if TYPE_CHECKING:
    from crowdbench.check.checks import CheckResult

PASSED, FAILED = "passed", "failed"

SCENARIOS = "circle_crossing_5 for planners, else circle_crossing_mixed with a visible vehicle"


def check(
    plugin: str,
    kind: Annotated[str | None, typer.Option(show_default="as the file's function says")] = None,
    option: list[str] | None = None,
    scenario: Annotated[str | None, typer.Option(show_default=SCENARIOS)] = None,
    cases: str = "val:20",
    data: Path | None = None,
    decision_limit: float = DECISION_LIMIT,
) -> None:
    """Check a plug-in against the contract of its kind: valid outputs, equal when repeated and in any batch.

    Args:
        plugin: A file (./mine.py, ./mine.py:function, or ./mine.toml for a scenario), or a name. A name without
            --kind is a planner.
        kind: planners, pedestrians, predictors, metrics, layouts, rewards or scenarios.
        scenario: A name or ./mine.toml.
        cases: The cases of the scenario.
    """
    from crowdbench.check.checks import check_plugin
    from crowdbench.check.kinds import PROCEDURES, find_kind, load_subject
    from crowdbench.scenario.cases import Cases

    kind = find_kind(plugin) if kind is None else kind
    if kind not in PROCEDURES:
        *others, last = PROCEDURES
        raise InputError(f"nothing is checked as {kind!r}: --kind is {', '.join(others)} or {last}")
    announce_compilation()
    options = assignments(option or [], "--option")
    with progress(1.0, "checked") as report:
        subject = load_subject(kind, plugin, options, scenario, decision_limit, data)
        results = check_plugin(subject, Cases.parse(cases), report)
    colors = {PASSED: GOOD, FAILED: BAD}
    print_table(check_table(subject.name, results), lambda row, cell: colors.get(cell, ""))
    if not all(result.passed for result in results):
        raise typer.Exit(1)


def check_table(name: str, results: Sequence[CheckResult]) -> Grid:
    """Return the table of the checks of a plug-in."""
    verdicts = {True: PASSED, False: FAILED, None: "?"}
    rows = [(verdicts[result.passed], result.name, result.observation) for result in results]
    return Grid(f"Contract checks of {name}", ("", "check", "observation"), rows, align="lll")
