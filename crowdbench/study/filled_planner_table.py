"""A table of planners with its figures, as it is printed."""

from __future__ import annotations

from dataclasses import dataclass

from crowdbench.evaluate.formats import Grid, markdown
from crowdbench.evaluate.summary import Estimate
from crowdbench.study.claims import NOTES as CLAIM_NOTES
from crowdbench.study.claims import Assessment, claims_grid
from crowdbench.study.measures import PLANNER_MEASURES, SUCCESS, TIME
from crowdbench.study.tables import PRIVILEGED, FilledTable, marked

NOTES = (
    "Figures are means over the networks of a row, which all drive the same cases. Their 95 % intervals are for other "
    "networks and other cases: Student's t over the networks and over the cases, joined as in Banerjee (Sankhyā 22, "
    "1960, 357-358). Success of a single network has Wilson's score interval instead, and so has success of several "
    "networks where each of them solves every case, or no case. All figures but success are over the cases that are "
    "solved."
)
ALONE = "The networks of a row differ only in the seed of their training."


@dataclass(frozen=True)
class SecondReading:
    """Success rate and navigation time of the first network of a row alone, on the table's cases and on others.

    Attributes:
        cases: The other cases.
        first: What it does on the table's cases, by metric.
        second: What it does on the other cases.
    """

    cases: str
    first: dict[str, Estimate]
    second: dict[str, Estimate]


@dataclass(frozen=True)
class FilledPlannerRow:
    """A row with its figures.

    Attributes:
        planner: What the table calls the planner.
        privileged: Whether the planner uses what no vehicle could know.
        weights: The weights of its networks, where it was given any.
        networks: Number of its networks; 0 for a planner without any.
        reported: What others report, by metric.
        measured: What the networks do, by metric.
        success_rates: The success rate of each network.
        variant_success_rate: The success rate under the table's variant.
        second_reading: What the first network does on other cases, if the row has them.
    """

    planner: str
    privileged: bool
    weights: list[str]
    networks: int
    reported: dict[str, float]
    measured: dict[str, Estimate]
    success_rates: list[float]
    variant_success_rate: Estimate | None
    second_reading: SecondReading | None

    @property
    def name(self) -> str:
        """The planner, marked where it is privileged."""
        return marked(self.planner, self.privileged)

    def each_network(self) -> str:
        """A line with the success of each network."""
        each = zip(self.weights, self.success_rates, strict=True)
        return f"- {self.name}: " + ", ".join(f"{weights} {SUCCESS.number(rate)}" for weights, rate in each)

    def read_again(self, cases: str) -> list[str]:
        """A line with the second reading, if there is one, beside the first one on `cases`."""
        if self.second_reading is None:
            return []
        figures = [
            " in ".join(each.estimate(of[each.metric]) for each in (SUCCESS, TIME))
            for of in (self.second_reading.second, self.second_reading.first)
        ]
        network = f" with {self.weights[0]}" if self.weights else ""
        return [f"- {self.name}{network}: {figures[0]} on {self.second_reading.cases}; {figures[1]} on {cases}"]


@dataclass(frozen=True)
class FilledPlannerTable(FilledTable):
    """A table of planners with its figures."""

    title: str
    scenario: str
    replanning: dict[str, int]
    cases: str
    variant: str
    rows: list[FilledPlannerRow]
    claims: list[Assessment]

    def markdown(self) -> str:
        """See `FilledTable`."""
        (planners,) = self.grids()
        every = "".join(f", {key}={value}" for key, value in self.replanning.items())
        on = f"On {self.scenario}{every}, cases {self.cases}."
        parts = [f"## {self.title}", on, markdown(planners.header, planners.rows)]
        if each := [row.each_network() for row in self.rows if len(row.weights) > 1]:
            parts += ["Success of each network:", "\n".join(each)]
        if again := [line for row in self.rows for line in row.read_again(self.cases)]:
            parts += ["Second reading, of the first network on other cases:", "\n".join(again)]
        return "\n\n".join([*parts, claims_grid(self.claims)] if self.claims else parts)

    def grids(self) -> list[Grid]:
        """See `FilledTable`."""
        header, *rows = zip(*self._columns(), strict=True)
        return [Grid(self.title, header, rows, self.rows)]

    def notes(self) -> list[str]:
        """See `FilledTable`."""
        notes = [NOTES]
        notes += [ALONE] if any(len(row.weights) > 1 for row in self.rows) else []
        notes += [PRIVILEGED] if any(row.privileged for row in self.rows) else []
        return notes + ([CLAIM_NOTES] if self.claims else [])

    def _columns(self) -> list[list[str]]:
        """Each column, its heading first."""
        columns = [["planner", *(row.name for row in self.rows)]]
        columns.append(["networks", *(str(row.networks) if row.networks else "" for row in self.rows)])
        for metric in self.rows[0].measured:
            columns += self._columns_of(metric)
        if self.variant:
            rates = [row.variant_success_rate for row in self.rows]
            columns.append([f"success, {self.variant}", *(SUCCESS.estimate(rate) for rate in rates if rate)])
        return columns

    def _columns_of(self, metric: str) -> list[list[str]]:
        """What is measured of a metric, after what is reported where anything is."""
        measure = PLANNER_MEASURES[metric]
        measured = [measure.word, *(measure.estimate(row.measured[metric]) for row in self.rows)]
        if not any(metric in row.reported for row in self.rows):
            return [measured]
        return [
            [f"{measure.word}, reported", *(measure.reported(row.reported.get(metric)) for row in self.rows)],
            measured,
        ]
