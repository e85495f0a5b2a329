"""`[[ladders]]`: one search with increasing knowledge in scenarios, beside the certificates and the best planner."""

from __future__ import annotations

import dataclasses
import itertools
from pathlib import Path

import numpy as np
from jaxtyping import Bool
from pydantic import Field

from crowdbench import Cases, Scenario, load_scenario
from crowdbench.core import PERFECT_SENSOR
from crowdbench.metrics import Estimate, include_mean, wilson
from crowdbench.runs import Run, RunSpec, load_run
from crowdbench.utils import Grid, Location, Name, Names, TomlTable, markdown
from studies.ladder.futures import adds_nothing
from studies.ladder.rungs import KNOWLEDGE, RUNGS, load_rung
from studies.pages import SUCCESS, draw_bar, read_successes
from studies.schema import CasesText, Planners, StudyHead

CHOICE = Cases("val", 0, 50)
"""The cases on which the best planner is selected."""

STEPS = {
    "P1": "perception",
    "I": "inference",
    "G": "goals",
    "GP": "policies",
    "P2": "attention",
    "P3": "chance",
    "C": "search",
}
"""The additional knowledge of a rung over the rung below."""

NOTES = " ".join(Path(__file__).with_name("notes.txt").read_text("utf-8").split())
"""The notes below the table."""


class LaddersSpec(TomlTable):
    """`[[ladders]]`: scenarios, and planners of which the best one is compared with the rungs."""

    title: Name
    planners: Planners
    scenarios: Names
    cases: CasesText = Cases.parse("test:100")


class LadderStudy(StudyHead):
    """The TOML file of the study."""

    ladders: list[LaddersSpec] = Field(min_length=1, description="one table [[ladders]] or more")


@dataclasses.dataclass(frozen=True)
class Ladder:
    """A scenario with the runs of its rungs, and the runs that select the best planner.

    Attributes:
        scenario: The scenario.
        rungs: The runs by the names of their rungs. Rungs that are equal by construction have the same run.
        choices: Runs of the planners on `CHOICE`.
        certified: True for cases with a certificate; None if some cases were not examined.
    """

    scenario: Scenario
    rungs: dict[str, Run]
    choices: list[Run]
    certified: Bool[np.ndarray, "case"] | None

    @classmethod
    def of(cls, name: str, spec: LaddersSpec) -> Ladder:
        """Plan the runs in a scenario; raises InputError if it or a planner cannot be loaded."""
        sensed = load_scenario(name)
        base = RunSpec("", name, spec.cases, record="none")
        first = load_rung("P1", base, sensed)
        rungs = {"P0": first if sensed.rules.sensor == PERFECT_SENSOR else load_rung("P0", base, sensed), "P1": first}
        rungs["I"] = load_rung("I", base, sensed)
        for below, (rung, knows) in zip(("I", *KNOWLEDGE), KNOWLEDGE.items(), strict=False):
            rungs[rung] = rungs[below] if adds_nothing(sensed, knows) else load_rung(rung, base, sensed)
        choices = [
            dataclasses.replace(base, planner=each.planner, options=each.options, cases=CHOICE)
            for each in spec.planners
        ]
        certified = find_certified(sensed, spec.cases)
        return cls(sensed, rungs, list(map(load_run, choices)), certified)

    @property
    def runs(self) -> list[Run]:
        """Its runs, possibly with duplicates."""
        return [*self.rungs.values(), *self.choices]

    def best(self, out: Path) -> Run:
        """Return the run of the best planner on `CHOICE`; raises InputError if a run is missing in the folder `out`."""
        successes = [read_successes(run, out).mean() for run in self.choices]
        spec = self.choices[int(np.argmax(successes))].spec
        return load_run(dataclasses.replace(spec, cases=self.rungs["P0"].spec.cases))


@dataclasses.dataclass(frozen=True)
class Step:
    """The share of the cases that a rung gains over the one below, with its 95 % interval; None if they are equal."""

    knowledge: str
    gain: Estimate | None


@dataclasses.dataclass(frozen=True)
class FilledLadder:
    """A ladder with its figures.

    Attributes:
        scenario: The scenario.
        cases: The cases.
        success: The success rate at each rung.
        steps: The gains between them.
        best: The planner that was best on `CHOICE`.
        best_success: Its success rate.
    """

    scenario: str
    cases: str
    success: dict[str, Estimate]
    steps: list[Step]
    best: str
    best_success: Estimate

    @classmethod
    def of(cls, ladder: Ladder, out: Path) -> FilledLadder:
        """Fill a ladder from the runs in the folder `out`."""
        outcomes = {rung: read_successes(run, out) for rung, run in ladder.rungs.items()}
        if ladder.certified is not None:
            outcomes["C"] = ladder.certified
        names, steps = list(outcomes), []
        for below, above in itertools.pairwise(names):
            is_equal = above != "C" and ladder.rungs[above] is ladder.rungs[below]
            steps.append(Step(STEPS[above], None if is_equal else paired_gain(outcomes[above], outcomes[below])))
        best, cases = ladder.best(out), ladder.rungs["P0"].spec.cases
        success = {rung: wilson(each) for rung, each in outcomes.items()}
        return cls(ladder.scenario.name, str(cases), success, steps, best.label, wilson(read_successes(best, out)))

    def bars(self) -> Grid:
        """Return a row for each rung, with a bar, and one for the best planner."""
        gains = ["", *(f"{_say_points(step.gain)}, {step.knowledge}" for step in self.steps)]
        rows = [
            [rung, SUCCESS.estimate(each, with_unit=True), draw_bar(each.mean), RUNGS[rung], gain]
            for (rung, each), gain in zip(self.success.items(), gains, strict=True)
        ]
        best = SUCCESS.estimate(self.best_success, with_unit=True), draw_bar(self.best_success.mean)
        rows.append(["best", *best, self.best, ""])
        title = f"{self.scenario}, cases {self.cases}"
        return Grid(title, ["rung", "success", "", "knows", "points gained by this search, with"], rows, align="lrlll")

    def cells(self) -> list[str]:
        """Return its row in a table."""
        cells = [self.scenario]
        for rung, step in itertools.zip_longest(RUNGS, self.steps):
            cells.append(SUCCESS.amount(self.success[rung].mean) if rung in self.success else "")
            if rung != "C":
                cells.append(_say_points(step.gain) if step else "")
        weak = ", above P2: the search is too weak here" if self.best_success.mean > self.success["P2"].mean else ""
        return [*cells, f"{SUCCESS.amount(self.best_success.mean)} ({self.best}{weak})"]


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
        """The runs of all rungs, and the runs that select the best planners."""
        return [run for ladder in self.ladders for run in ladder.runs]

    def second(self, out: Path) -> list[Run]:
        """Return the runs of the best planners; raises InputError if a run that selects them is missing in `out`."""
        return [ladder.best(out) for ladder in self.ladders]

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
        """Return a row for each scenario."""
        between = [STEPS.get(rung, "") for rung in list(RUNGS)[1:]]
        header = [cell for pair in zip(RUNGS, [*between, ""], strict=True) for cell in pair if cell]
        rows = [each.cells() for each in self.ladders]
        return [Grid(self.title, ["scenario", *header, "best planner"], rows, self.ladders)]

    def notes(self) -> list[str]:
        """Return the notes below the tables of a page."""
        return [NOTES]


def paired_gain(above: Bool[np.ndarray, "case"], below: Bool[np.ndarray, "case"]) -> Estimate:
    """Return the gain in success of one run over another in the same cases, with its 95 % interval.

    One discordant case is added to each side, so that the interval has a width if no case differs: the adjusted Wald
    interval of Bonett and Price (2012), Journal of Educational and Behavioral Statistics 37(4), 479-488.
    """
    n = len(above) + 2
    gained, lost = (int(np.sum(x & ~y)) + 1 for x, y in ((above, below), (below, above)))
    centre, width = (gained - lost) / n, 1.96 * np.sqrt(gained + lost - (gained - lost) ** 2 / n) / n
    mean = float(above.mean() - below.mean())
    return Estimate(mean, *include_mean(mean, max(centre - width, -1.0), min(centre + width, 1.0)), len(above), 1.0)


def _say_points(gain: Estimate | None) -> str:
    return f"{100 * gain.mean:+.0f} ({100 * gain.low:+.0f} to {100 * gain.high:+.0f})" if gain else "-"


def find_certified(scenario: Scenario, cases: Cases) -> Bool[np.ndarray, "case"] | None:
    """Return which of some cases have a certificate; None if some were not examined."""
    status = scenario.certificates
    examined = getattr(status.certified, cases.split) if status else None
    if status is None or status.certified.scenario != scenario.digest or not examined or examined.examined < cases.stop:
        return None
    return ~np.isin(cases.indices, examined.uncertified)
