"""`[[ladders]]`: one search with increasing knowledge in scenarios, beside the best planner and best known scores."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float
from pydantic import Field

from crowdbench import Cases, Scenario, load_scenario, read_suite
from crowdbench.metrics import Estimate, bootstrap
from crowdbench.runs import Run, RunSpec, load_run
from crowdbench.utils import Grid, Location, Name, Names, TomlTable, markdown
from studies.best_times.entries import BestTimes
from studies.ladder.futures import adds_nothing
from studies.ladder.rungs import KNOWLEDGE, RUNGS, load_rung
from studies.pages import SCORE, draw_bar, read_scores
from studies.schema import CasesText, Planners, StudyHead

SENSED = {"sensor.track": "realistic"}
"""The sensor of P0 and of the planners."""

KNOWN = "best known"
"""The rung above all others."""

STEPS = {
    "P1": "perception",
    "I": "inference",
    "G": "goals",
    "GP": "policies",
    "P2": "attention",
    "P3": "chance",
    KNOWN: "search",
}
"""The additional knowledge of a rung over the rung below."""

NOTES = " ".join(Path(__file__).with_name("notes.txt").read_text("utf-8").split())
"""The notes below the table."""

Scores = Float[np.ndarray, "case"]


class LaddersSpec(TomlTable):
    """`[[ladders]]`: scenarios, and planners of which the best one is compared with the rungs."""

    title: Name
    planners: Planners
    scenarios: Names = Field(default_factory=lambda: [*read_suite().ranked])
    cases: CasesText = Cases.parse("val:50")


class LadderStudy(StudyHead):
    """The TOML file of the study."""

    ladders: list[LaddersSpec] = Field(min_length=1, description="one table [[ladders]] or more")


@dataclasses.dataclass(frozen=True)
class Ladder:
    """A scenario with the runs of its rungs and of planners.

    Attributes:
        scenario: The scenario.
        rungs: The runs by the names of their rungs. Rungs that are equal by construction have the same run.
        planners: The runs of the planners, with the sensor of P0.
        known: The best known scores of validation cases, by the number of the case.
    """

    scenario: Scenario
    rungs: dict[str, Run]
    planners: list[Run]
    known: Mapping[int, float]

    @classmethod
    def of(cls, name: str, spec: LaddersSpec) -> Ladder:
        """Plan the runs in a scenario; raises InputError if it or a planner cannot be loaded."""
        scenario, sensed = load_scenario(name), load_scenario(name, SENSED)
        base = RunSpec("", name, spec.cases, record="none")
        as_sensed = dataclasses.replace(base, overrides=SENSED)
        rungs = {"P0": load_rung("P0", as_sensed, sensed)}
        rungs |= {rung: load_rung(rung, base, scenario) for rung in ("P1", "I")}
        for below, (rung, knows) in zip(("I", *KNOWLEDGE), KNOWLEDGE.items(), strict=False):
            rungs[rung] = rungs[below] if adds_nothing(scenario, knows) else load_rung(rung, base, scenario)
        planners = [
            load_run(dataclasses.replace(as_sensed, planner=each.planner, options=each.options), scenario=sensed)
            for each in spec.planners
        ]
        known = {entry.case: entry.score for entry in BestTimes.read(scenario).entries}
        return cls(scenario, rungs, planners, known if spec.cases.split == "val" else {})

    @property
    def runs(self) -> list[Run]:
        """Its runs, possibly with duplicates."""
        return [*self.rungs.values(), *self.planners]


@dataclasses.dataclass(frozen=True)
class Step:
    """The gain in score of a rung over the one below, with its 95 % interval; None if they are equal."""

    knowledge: str
    gain: Estimate | None


@dataclasses.dataclass(frozen=True)
class FilledLadder:
    """A ladder with its figures.

    Attributes:
        scenario: The scenario.
        cases: The cases.
        score: The mean score at each rung; `KNOWN` is among them if cases have best known scores, and over these cases.
        steps: The gains between them.
        best: The planner with the best mean score.
        best_score: Its mean score.
    """

    scenario: str
    cases: str
    score: dict[str, Estimate]
    steps: list[Step]
    best: str
    best_score: Estimate

    @classmethod
    def of(cls, ladder: Ladder, out: Path) -> FilledLadder:
        """Fill a ladder from the runs in the folder `out`."""
        scores = {rung: read_scores(run, out) for rung, run in ladder.rungs.items()}
        steps = [
            Step(
                STEPS[above], None if ladder.rungs[above] is ladder.rungs[below] else gain(scores[above], scores[below])
            )
            for below, above in itertools.pairwise(scores)
        ]
        cases = ladder.rungs["P0"].spec.cases
        compared = np.isin(cases.indices, list(ladder.known))
        if compared.any():
            known = np.array([ladder.known[case] for case in cases.indices[compared].tolist()])
            steps.append(Step(STEPS[KNOWN], gain(known, scores["P3"][compared])))
            scores[KNOWN] = known
        of_planners = {run.label: read_scores(run, out) for run in ladder.planners}
        best = max(of_planners, key=lambda label: of_planners[label].mean())
        means = {rung: estimate(each) for rung, each in scores.items()}
        return cls(ladder.scenario.name, str(cases), means, steps, best, estimate(of_planners[best]))

    def bars(self) -> Grid:
        """Return a row for each rung, with a bar, and one for the best planner."""
        gains = ["", *(f"{_say_gain(step.gain)}, {step.knowledge}" for step in self.steps)]
        knows = {**RUNGS, KNOWN: f"the true future, with another search{self._say_cases()}"}
        rows = [
            [rung, SCORE.estimate(each), draw_bar(each.mean), knows[rung], gained]
            for (rung, each), gained in zip(self.score.items(), gains, strict=True)
        ]
        rows.append(["best", SCORE.estimate(self.best_score), draw_bar(self.best_score.mean), self.best, ""])
        title = f"{self.scenario}, cases {self.cases}"
        return Grid(title, ["rung", "score", "", "knows", "gained by this search, with"], rows, align="lrlll")

    def cells(self) -> list[str]:
        """Return its column in a table: the rungs, with the gains between them, and the best planner."""
        cells = []
        for rung, step in itertools.zip_longest(self.score, self.steps):
            cells.append(SCORE.number(self.score[rung].mean))
            if step:
                cells.append(_say_gain(step.gain))
        if KNOWN not in self.score:
            cells += ["-", "-"]
        else:
            cells[-1] += self._say_cases()
        weak = ", above P2: the search is too weak here" if self.best_score.mean > self.score["P2"].mean else ""
        return [*cells, f"{SCORE.number(self.best_score.mean)} ({self.best}{weak})"]

    def _say_cases(self) -> str:
        """Return the number of cases with best known scores, if there are any and other cases have none."""
        known = self.score[KNOWN].n if KNOWN in self.score else 0
        return f" ({known} cases)" if 0 < known < self.score["P0"].n else ""


@dataclasses.dataclass(frozen=True)
class LaddersTable:
    """Ladders of scenarios, and their runs."""

    title: str
    ladders: list[Ladder]

    @classmethod
    def of(cls, spec: LaddersSpec, location: Location) -> LaddersTable:
        """Plan the runs of a table.

        Args:
            spec: The table of the file.
            location: Its location in the file, for errors.

        Raises:
            InputError: A scenario or a planner does not exist, or two scenarios have the same name.
        """
        with location.named():
            ladders = [Ladder.of(name, spec) for name in spec.scenarios]
        names = [ladder.scenario.name for ladder in ladders]
        if len(set(names)) < len(names):
            raise location.at("scenarios").wrong(", ".join(names), "scenarios of different names")
        return cls(spec.title, ladders)

    @property
    def runs(self) -> list[Run]:
        """The runs of all rungs and planners."""
        return [run for ladder in self.ladders for run in ladder.runs]

    def fill(self, out: Path) -> FilledLaddersTable:
        """Return the table with the figures of the runs in the folder `out`."""
        return FilledLaddersTable(self.title, [FilledLadder.of(ladder, out) for ladder in self.ladders])


@dataclasses.dataclass(frozen=True)
class FilledLaddersTable:
    """Ladders with their figures. `--format json` prints its fields."""

    title: str
    ladders: list[FilledLadder]

    def markdown(self) -> str:
        """Return the table in GitHub's Markdown, under its heading."""
        (grid,) = self.grids()
        return "\n\n".join([f"## {self.title}", f"Cases {self.ladders[0].cases}.", markdown(grid.header, grid.rows)])

    def grids(self) -> list[Grid]:
        """Return a row for each rung, and one for the gain over the rung above it, with a column for each scenario."""
        titles = ["P0", *(title for rung, knowledge in STEPS.items() for title in (f"+ {knowledge}", rung))]
        columns = [each.cells() for each in self.ladders]
        rows = [list(row) for row in zip([*titles, "best planner"], *columns, strict=True)]
        return [Grid(self.title, ["rung", *(each.scenario for each in self.ladders)], rows, self.ladders)]

    def notes(self) -> list[str]:
        """Return the notes below the tables of a page."""
        return [NOTES]


def estimate(scores: Scores) -> Estimate:
    """Return a mean score with the 95 % interval of a bootstrap over cases."""
    return bootstrap(scores, np.ones(len(scores)))


def gain(above: Scores, below: Scores) -> Estimate:
    """Return the gain in mean score of one run over another in the same cases, with its 95 % interval."""
    return estimate(above - below)


def _say_gain(gain: Estimate | None) -> str:
    if gain is None:
        return "-"
    shown = gain.for_display()
    interval = "" if np.isnan(shown.low) else f" ({shown.low:+z.2f} to {shown.high:+z.2f})"
    return f"{shown.mean:+z.2f}{interval}"
