"""A table of planners with its figures, as it is printed."""

from __future__ import annotations

from dataclasses import dataclass

from crowdbench.evaluate.replanning import Replanning
from crowdbench.evaluate.summary import Estimate
from crowdbench.study.claims import NOTES as CLAIM_NOTES
from crowdbench.study.claims import Assessment, claims_grid
from crowdbench.study.measures import PLANNER_MEASURES, SUCCESS, TIME
from crowdbench.study.tables import PRIVILEGED, FilledTable, grid, marked

NOTES = (
    "Figures are means over the networks of a row, which all drive the same cases. Their 95 % intervals are for other "
    "networks and other cases: Student's t over the networks and over the cases, joined as in Banerjee (1960). Success "
    "of a single network has Wilson's score interval instead, and so has success of several networks where each of "
    "them solves every case, or no case. All figures but success are over the cases that are solved."
)
ALONE = "The networks of a row differ only in the seed of their training."


@dataclass(frozen=True)
class FirstNetwork:
    """Success rate and navigation time of the first network of a row alone."""

    validation: dict[str, Estimate]
    cases: dict[str, Estimate]

    def cells(self) -> list[str]:
        """`99.7 %, 10.63 s`, for either."""
        return [
            ", ".join(each.number(of[each.metric].mean) for each in (SUCCESS, TIME))
            for of in (self.validation, self.cases)
        ]


@dataclass(frozen=True)
class FilledPlannerRow:
    """A row with its figures.

    Attributes:
        planner: What the table calls the planner.
        privileged: Whether the planner uses what no vehicle could know.
        weights: The weights of its networks.
        reported: What others report, by metric.
        measured: What the networks do, by metric.
        success_rates: The success rate of each network.
        variant_success_rate: The success rate under the table's variant.
        first_network: What the first network does alone, if the table has validation cases.
    """

    planner: str
    privileged: bool
    weights: list[str]
    reported: dict[str, float]
    measured: dict[str, Estimate]
    success_rates: list[float]
    variant_success_rate: Estimate | None
    first_network: FirstNetwork | None

    @property
    def name(self) -> str:
        """The planner, marked where it is privileged."""
        return marked(self.planner, self.privileged)

    def each_network(self) -> str:
        """A line with the success of each network."""
        each = zip(self.weights, self.success_rates, strict=True)
        return f"- {self.name}: " + ", ".join(f"{weights} {SUCCESS.number(rate)}" for weights, rate in each)


@dataclass(frozen=True)
class FilledPlannerTable(FilledTable):
    """A table of planners with its figures."""

    title: str
    scenario: str
    replanning: Replanning
    cases: str
    validation: str
    variant: str
    rows: list[FilledPlannerRow]
    claims: list[Assessment]

    def markdown(self) -> str:
        """See `FilledTable`."""
        columns = list(zip(*self._columns(), strict=True))
        every = "".join(f", {key}={value}" for key, value in self.replanning.settings.items())
        parts = [f"## {self.title}", f"On {self.scenario}{every}, cases {self.cases}.", grid(columns[0], columns[1:])]
        if self.validation:
            each = [row.each_network() for row in self.rows if row.weights]
            parts += [f"Success of each network on {self.cases}:", "\n".join(each)]
        return "\n\n".join([*parts, claims_grid(self.claims)] if self.claims else parts)

    def notes(self) -> list[str]:
        """See `FilledTable`."""
        notes = [NOTES]
        notes += [ALONE] if self.validation else []
        notes += [PRIVILEGED] if any(row.privileged for row in self.rows) else []
        return notes + ([CLAIM_NOTES] if self.claims else [])

    def _columns(self) -> list[list[str]]:
        """Each column, its heading first."""
        columns = [["planner", *(row.name for row in self.rows)]]
        columns.append(["networks", *(str(len(row.weights)) if row.weights else "" for row in self.rows)])
        for metric in self.rows[0].measured:
            columns += self._columns_of(metric)
        if self.variant:
            rates = [row.variant_success_rate for row in self.rows]
            columns.append([f"success, {self.variant}", *(SUCCESS.estimate(rate) for rate in rates if rate)])
        first = [row.first_network.cells() for row in self.rows if row.first_network]
        if first:
            headings = [f"first network, {cases}" for cases in (self.validation, self.cases)]
            columns += [[heading, *cells] for heading, cells in zip(headings, zip(*first, strict=True), strict=True)]
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
