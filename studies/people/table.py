"""The rows of the table: models with intervals, and their differences."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from crowdbench.utils import Grid
from studies.people.likelihood import WindowScore
from studies.people.summary import Figure, compare, summarize

HEADER = ("model", "goal", "v3", "motion", "path", "encounter", "new contacts", "ratio to recorded", "closest [m]")

Scores = Mapping[str, Sequence[WindowScore]]
"""By goal, `shown` or `hidden`, the score in each window."""

Blocks = Sequence[str] | None
"""The block of each window, see `summarize`."""


class Row(NamedTuple):
    """A row of the table.

    Attributes:
        model: Its name.
        goal: `shown`, `hidden` or none.
        figures: Its figures, or differences.
        sign: `+` to show the sign of positive numbers.
    """

    model: str
    goal: str
    figures: Mapping[str, Figure]
    sign: str = "-"

    @property
    def cells(self) -> list[str]:
        """The cells for readers."""
        return [self.model, self.goal, *(_cell(name, figure, self.sign) for name, figure in self.figures.items())]

    @property
    def record(self) -> dict[str, Any]:
        """The content for programs."""
        figures = {name: figure._asdict() for name, figure in self.figures.items()}
        return {"model": self.model, "goal": self.goal, **figures}


def grid_of(rows: Sequence[Row]) -> Grid:
    """Return the table."""
    return Grid("People", HEADER, [row.cells for row in rows], [row.record for row in rows])


def rows_of(name: str, model: Scores, blocks: Blocks = None) -> list[Row]:
    """Return the rows of a model, one for each goal."""
    return [Row(name, goal, summarize(scores, blocks)) for goal, scores in model.items()]


def rows_beside(model: Scores, name: str, other: Scores, blocks: Blocks = None) -> list[Row]:
    """Return the rows of another model, and of the difference of a model to it."""
    differences = {goal: compare(model[goal], other[goal], blocks) for goal in model}
    rows = [Row(f"difference to {name}", goal, figures, "+") for goal, figures in differences.items()]
    return rows_of(name, other, blocks) + rows


def _cell(name: str, figure: Figure, sign: str) -> str:
    if math.isnan(figure.value):
        return "-"
    is_share = name == "contacts"
    value, low, high = (format(100.0 * number if is_share else number, _digits(name, sign)) for number in figure)
    return f"{value} ({low} to {high}){' %' * is_share}"


def _digits(name: str, sign: str) -> str:
    return f"{sign}.{ {'contacts': 1, 'ratio': 2, 'closest': 2}.get(name, 3) }f"


def describe(scores: Sequence[WindowScore]) -> str:
    """Return the numbers of windows and persons, and what was recorded."""

    def total(name: str) -> float:
        return sum(getattr(each, name) for each in scores)

    persons, conflicts = total("persons"), total("conflicts")
    recorded = f"{total('recorded_contacts') / persons:.1%} have a new contact"
    closest = f"the mean closest approach is {total('recorded_closest') / conflicts:.2f} m" if conflicts else ""
    numbers = f"{len(scores)} windows, {persons:.0f} persons, {conflicts:.0f} of them in conflict"
    return f"{numbers}. Recorded: {recorded}; {closest}."
