"""`[[dials]]`: the levels that planners hold on dials, and the distances to the best planner."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field

from crowdbench.runs import Run, directory_name
from crowdbench.utils import Grid, Location, Name, Names, TomlTable, markdown
from studies.dials.dial import FIRST, SECOND, Dial, load_dial
from studies.dials.estimate import WANTED, Crossing, First, Fit, difference, fit, levels_around
from studies.ladder.rungs import RUNGS
from studies.pages import SCORE, draw_bar, read_scores
from studies.schema import Planners, StudyHead

NOTES = " ".join(Path(__file__).with_name("notes.txt").read_text("utf-8").split())
"""The notes below the table."""


class DialsSpec(TomlTable):
    """`[[dials]]`: planners on dials, by their names or files."""

    title: Name
    planners: Planners
    dials: Names


class DialStudy(StudyHead):
    """The TOML file of the study."""

    dials: list[DialsSpec] = Field(min_length=1, description="one table [[dials]] or more")


@dataclasses.dataclass(frozen=True)
class Measurement:
    """A planner on a dial, and its runs of the first stage, one for each level."""

    dial: Dial
    first: list[Run]

    @classmethod
    def of(cls, dial: Dial, planner: str, options: Mapping[str, Any]) -> Measurement:
        """Plan the runs; raises InputError if the planner or the scenario cannot be loaded."""
        return cls(dial, dial.runs(planner, options, FIRST, range(len(dial.levels))))

    @property
    def is_rung(self) -> bool:
        """True if it is a rung of the ladder; False for a planner, also for one in a file P3.py."""
        return self.first[0].spec.planner in RUNGS

    @property
    def name(self) -> str:
        """Name of its file, such as `mppi-density-30-horizon=24`."""
        run = self.first[0]
        return directory_name(run.driver.name, self.dial.name, dataclasses.replace(run.spec, overrides={}))

    def scores(self, out: Path) -> First:
        """Return the scores of the first stage; raises InputError if a run is missing in the folder `out`."""
        return np.stack([read_scores(run, out) for run in self.first])

    def second(self, out: Path) -> dict[int, Run]:
        """Return the runs of the second stage by the numbers of their levels, which follow from the first stage in
        `out`.

        A rung of the ladder has none: 30 cases at each level show the limit of the search.
        """
        if self.is_rung:
            return {}
        levels = levels_around(self.scores(out))
        specs = {level: dataclasses.replace(self.first[level].spec, cases=SECOND) for level in levels}
        return {level: dataclasses.replace(self.first[level], spec=spec) for level, spec in specs.items()}

    def fit(self, out: Path) -> Fit:
        """Return the fit of the runs in the folder `out`."""
        second = {level: read_scores(run, out) for level, run in self.second(out).items()}
        return fit(self.scores(out), second)


@dataclasses.dataclass(frozen=True)
class DialsTable:
    """Planners on dials; `by_dial` has the measurements on each dial in a list."""

    title: str
    by_dial: list[list[Measurement]]

    @classmethod
    def of(cls, spec: DialsSpec, location: Location) -> DialsTable:
        """Plan the runs of a table.

        Args:
            spec: The table of the file.
            location: Its location in the file, for errors.

        Raises:
            InputError: A planner or a dial does not exist, or two planners have the same name and options.
        """
        with location.named():
            dials = [load_dial(name) for name in spec.dials]
            by_dial = [[Measurement.of(dial, each.planner, each.options) for each in spec.planners] for dial in dials]
        labels = [measurement.first[0].label for measurement in by_dial[0]]
        if len(set(labels)) < len(labels):
            raise location.at("planners").wrong(repr(labels), "planners that differ in their names or options")
        return cls(spec.title, by_dial)

    @property
    def runs(self) -> list[Run]:
        """All runs of the first stage."""
        return [run for each in self.by_dial for measurement in each for run in measurement.first]

    def second(self, out: Path) -> list[Run]:
        """Return all runs of the second stage; raises InputError if one of the first is missing in `out`."""
        return [run for each in self.by_dial for measurement in each for run in measurement.second(out).values()]

    def fill(self, out: Path) -> FilledDialsTable:
        """Return the table with the figures of the runs in the folder `out`."""
        return FilledDialsTable(self.title, [FilledDial.of(each, out) for each in self.by_dial])


@dataclasses.dataclass(frozen=True)
class Level:
    """An estimated level in the unit of the dial, -inf below the first level and inf above the last one.

    Attributes:
        level: The level.
        low: The lower bound of its 95 % interval.
        high: The upper bound.
    """

    level: float
    low: float
    high: float

    @classmethod
    def of(cls, dial: Dial, crossing: Crossing) -> Level:
        """Return a crossing in the unit of a dial."""
        return cls(*(dial.level(each) for each in (crossing.level, crossing.low, crossing.high)))


@dataclasses.dataclass(frozen=True)
class DialRow:
    """Result of a planner on a dial.

    Attributes:
        planner: The planner with its options.
        is_rung: True if it is a rung of the ladder, and no planner.
        wanted: The level up to which its mean score is `WANTED`; None if the score rises with the level.
        behind: Number of levels by which the best planner is ahead, with the 95 % interval; NaN if it is unknown, for
            the best planner and for rungs.
        text: Its result as text, such as `41 (12 to 50)` or `below 2`; empty if the score rises with the level.
        p_rising: The p-value of the rise of the score with the level.
        cases: The number of cases at each level.
        score: The mean score at each level.
        bounds: The lower and the upper bounds of its 95 % intervals.
    """

    planner: str
    is_rung: bool
    wanted: Level | None
    behind: Level
    text: str
    p_rising: float
    cases: list[int]
    score: list[float]
    bounds: list[list[float]]

    @classmethod
    def of(cls, measurement: Measurement, found: Fit, best: Fit) -> DialRow:
        """Return the row of a planner, compared with the best one."""
        dial, is_rung, label = measurement.dial, measurement.is_rung, measurement.first[0].label
        wanted = Level.of(dial, found.wanted) if found.is_monotone else None
        is_behind = found is not best and not is_rung
        behind = Level(*difference(best.wanted, found.wanted)) if is_behind else Level(math.nan, math.nan, math.nan)
        text = _with_interval(wanted, dial.say) if wanted else ""
        figures = found.cases.tolist(), found.score.tolist(), found.bounds.tolist()
        return cls(label, is_rung, wanted, behind, text, found.p_rising, *figures)

    def cells(self) -> list[str]:
        """Return the row in a table."""
        if self.wanted is None:
            return [self.planner, f"no result: the score rises with the level (p = {self.p_rising:.2g})", ""]
        behind = "" if math.isnan(self.behind.level) else _with_interval(self.behind, "{:.1f}".format)
        return [
            f"{self.planner}: {RUNGS[self.planner]}" if self.is_rung else self.planner,
            self.text,
            behind,
        ]


@dataclasses.dataclass(frozen=True)
class FilledDial:
    """A dial with its figures: rungs of the ladder, then planners, each by level, the highest first."""

    dial: Dial
    rows: list[DialRow]

    @classmethod
    def of(cls, measurements: Sequence[Measurement], out: Path) -> FilledDial:
        """Fit the scores of planners on the same dial, from the runs in the folder `out`."""
        found = [(each, each.fit(out)) for each in measurements]
        found.sort(key=lambda each: (each[0].is_rung, each[1].is_monotone, each[1].wanted.level), reverse=True)
        best = next((each for measurement, each in found if not measurement.is_rung), found[0][1])
        return cls(measurements[0].dial, [DialRow.of(measurement, each, best) for measurement, each in found])

    def grid(self) -> Grid:
        """Return a row for each planner."""
        wanted = f"score of {WANTED:g} at {self.dial.label.format('...')}"
        header = ["planner", wanted, "levels behind the best"]
        rows = [row.cells() for row in self.rows]
        return Grid(self.dial.name, header, rows, self.rows)

    def curve(self, row: DialRow) -> Grid:
        """Return the mean score of a planner at each level, with bars."""
        each = zip(self.dial.levels, row.score, row.cases, strict=True)
        rows = [[f"{level:g}", SCORE.number(score), draw_bar(score), str(n)] for level, score, n in each]
        return Grid(row.planner, [self.dial.key, "score", "", "cases"], rows, align="rrlr")

    def sentence(self, row: DialRow) -> str:
        """Return the result of a planner in words."""
        if row.wanted is None:
            why = f"its score significantly rises with the level (p = {row.p_rising:.2g})"
            return f"{row.planner} has no result on the dial {self.dial.name}: {why}"
        if row.wanted.level == -math.inf:
            first = self.dial.label.format(f"{self.dial.levels[0]:g}")
            return f"{row.planner} has a mean score below {WANTED:g} at the easiest level, {first}"
        return f"{row.planner}: mean score of {WANTED:g} at {self.dial.label.format(row.text)}"


@dataclasses.dataclass(frozen=True)
class FilledDialsTable:
    """Dials with their figures. `--format json` prints its fields."""

    title: str
    dials: list[FilledDial]

    def markdown(self) -> str:
        """Return the tables in GitHub's Markdown, under their headings."""
        parts = [f"## {self.title}"]
        for each, grid in zip(self.dials, self.grids(), strict=True):
            parts += [f"### {each.dial.name}", f"{each.dial.description}.", markdown(grid.header, grid.rows)]
        return "\n\n".join(parts)

    def grids(self) -> list[Grid]:
        """Return one grid for each dial."""
        return [each.grid() for each in self.dials]

    def notes(self) -> list[str]:
        """Return the notes below the tables of a page."""
        return [NOTES]


def _with_interval(level: Level, say: Callable[[float], str]) -> str:
    """Return a level with its interval, which is left out if all of it is beyond the levels."""
    same = level.low == level.level == level.high
    return say(level.level) if same else f"{say(level.level)} ({say(level.low)} to {say(level.high)})"
