"""`[[rankings]]`: agreement of the order of planners in a suite of scenarios with the order in other worlds."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
from jaxtyping import Float, Int
from pydantic import Field

from crowdbench import Cases as CaseRange
from crowdbench.metrics import Estimate, interval
from crowdbench.runs import Run, RunSpec
from crowdbench.utils import Grid, Location, Name, Names, TomlTable, markdown, number
from studies.folder import load_runs, read_episodes
from studies.pages import SUCCESS, SUCCESS_RATE
from studies.schema import CasesText, Planners, StudyHead
from studies.transfer.kendall import Cases, agreement, draw_families, kendall, mean_rates
from studies.transfer.power import TRUE_TAUS, power

SUITE = "suite"
"""Name of the scenarios whose order is tested."""

NOTES = " ".join(Path(__file__).with_name("notes.txt").read_text("utf-8").split())
"""The notes below the table."""


class RankingsSpec(TomlTable):
    """`[[rankings]]`: planners by families, a suite that ranks them, and worlds in which that order is to hold.

    `worlds` has the scenarios of each world. `alone` is a scenario that is compared in place of the suite, on
    `alone_cases`. `criterion` is the bound that the lower end of the interval of Kendall's tau is to exceed.
    """

    title: Name
    families: Annotated[dict[str, Planners], Field(min_length=3, description="a table of three or more families")]
    suite: Names
    worlds: Annotated[dict[str, Names], Field(min_length=1, description="a table of worlds, each a list of scenarios")]
    alone: Name
    alone_cases: CasesText = CaseRange.parse("test:2000")
    criterion: float = number(0.3, least=-1.0, below=1.0)
    cases: CasesText = CaseRange.parse("test:100")


class TransferStudy(StudyHead):
    """The TOML file of the study."""

    rankings: list[RankingsSpec] = Field(min_length=1, description="one table [[rankings]] or more")


@dataclasses.dataclass(frozen=True)
class RankingsTable:
    """Planners in a suite and in worlds, and their runs.

    Attributes:
        spec: The table of the file.
        runs_by_world: The runs of each scenario of the suite and of the worlds, one list for each scenario.
        family: The number of each planner's family.
    """

    spec: RankingsSpec
    runs_by_world: Mapping[str, list[list[Run]]]
    family: Int[np.ndarray, "planner"]

    @classmethod
    def of(cls, spec: RankingsSpec, location: Location, data: Path | None) -> RankingsTable:
        """Plan the runs of a table.

        Args:
            spec: The table of the file.
            location: Its location in the file, for errors.
            data: The folder with the recorded tracks that its scenarios need.

        Raises:
            InputError: A planner or a scenario does not exist, or two planners have the same name and options.
        """
        planners = [each for members in spec.families.values() for each in members]
        family = np.repeat(np.arange(len(spec.families)), [len(members) for members in spec.families.values()])
        worlds = {SUITE: spec.suite, **spec.worlds, spec.alone: [spec.alone]}
        cases = {spec.alone: spec.alone_cases}
        with location.named():
            runs = {
                world: [
                    load_runs(planners, RunSpec("", name, cases.get(world, spec.cases), record="none", data=data))
                    for name in names
                ]
                for world, names in worlds.items()
            }
        labels = [run.label for run in runs[SUITE][0]]
        if len(set(labels)) < len(labels):
            raise location.at("families").wrong(repr(labels), "planners that differ in their names or options")
        return cls(spec, runs, family)

    @property
    def runs(self) -> list[Run]:
        """All runs that it needs."""
        return [run for scenarios in self.runs_by_world.values() for runs in scenarios for run in runs]

    def power(self) -> dict[str, float]:
        """Return the share of simulated studies that meet the criterion, by the true tau."""
        cases = [len(self.spec.cases) * len(names) for names in (self.spec.suite, *self.spec.worlds.values())]
        return {f"{tau:g}": power(tau, self.family, cases, self.spec.criterion) for tau in TRUE_TAUS}

    def fill(self, out: Path) -> FilledRankings:
        """Return the table with the figures of the runs in the folder `out`; raises InputError if one is missing."""
        cases = {
            world: [read_cases(runs, out) for runs in scenarios] for world, scenarios in self.runs_by_world.items()
        }
        planners = [run.label for run in self.runs_by_world[SUITE][0]]
        return FilledRankings.of(self.spec, planners, self.family, cases, self.power())


def read_cases(runs: Sequence[Run], out: Path, metric: str = SUCCESS_RATE) -> Cases:
    """Return the values of a metric of planners in the cases of a scenario. Raises InputError if a run is missing."""
    found = [read_episodes(run, out) for run in runs]
    value = np.stack([each.columns[metric].astype(float) for each in found])
    block, tracks = found[0].block, runs[0].scenario.tracks
    source = tracks.scene if tracks else runs[0].scenario.name
    return Cases(source, value, np.arange(value.shape[1]) if block is None else block)


@dataclasses.dataclass(frozen=True)
class Agreement:
    """Agreement of the order of planners in the suite with the order in a world.

    Attributes:
        world: The world.
        tau: Kendall's tau, with its interval.
        agree: Number of pairs that are decided in both and have the same order.
        decided: Number of pairs that are decided in both.
        alone: Tau of a single scenario in place of the suite.
        more: The difference between the taus of the suite and of the single scenario.
    """

    world: str
    tau: Estimate
    agree: int
    decided: int
    alone: Estimate
    more: Estimate

    def cells(self) -> list[str]:
        """Return its row in a table."""
        share = f"{self.agree} of {self.decided}"
        return [self.world, say_tau(self.tau), share, say_tau(self.alone), say_tau(self.more)]


@dataclasses.dataclass(frozen=True)
class FilledRankings:
    """The table with its figures. `--format json` prints its fields.

    Attributes:
        spec: The table of the file.
        planners: The planners, the highest success in the suite first.
        rates: Their success in the suite and in the worlds.
        worlds: The agreement of each world with the suite.
        mean: The mean of tau over the worlds.
        power: The share of simulated studies that meet the criterion, by the true tau.
    """

    spec: RankingsSpec
    planners: list[str]
    rates: dict[str, list[float]]
    worlds: list[Agreement]
    mean: Estimate
    power: dict[str, float]

    @classmethod
    def of(
        cls,
        spec: RankingsSpec,
        planners: Sequence[str],
        family: Int[np.ndarray, "planner"],
        cases: Mapping[str, list[Cases]],
        power: dict[str, float],
    ) -> FilledRankings:
        """Compare the order of planners in the suite with those in the worlds.

        Args:
            spec: The table of the file.
            planners: The planners.
            family: The number of each one's family.
            cases: Their outcomes in each scenario of the suite, the worlds and the single scenario.
            power: The power of the study.
        """
        rates = {world: mean_rates(scenarios) for world, scenarios in cases.items()}
        times = draw_families(family)
        taus = {world: kendall(rates[SUITE], rates[world], times) for world in spec.worlds}
        alone = {world: kendall(rates[spec.alone], rates[world], times) for world in spec.worlds}
        worlds = [
            Agreement(
                world,
                estimate_tau(tau),
                *agreement(rates[SUITE], rates[world]),
                alone=estimate_tau(alone[world]),
                more=estimate_tau(tau - alone[world]),
            )
            for world, tau in taus.items()
        ]
        order = np.argsort(-rates[SUITE][0], kind="stable")
        ordered = {world: rates[world][0][order].tolist() for world in (SUITE, *spec.worlds)}
        mean = estimate_tau(np.mean(list(taus.values()), axis=0))
        return cls(spec, [planners[each] for each in order], ordered, worlds, mean, power)

    @property
    def verdict(self) -> str:
        """A text with the mean tau, and whether it meets the criterion."""
        met = self.mean.low > self.spec.criterion
        said = "Met" if met else "Not met"
        return (
            f"The mean of tau over the worlds is {say_tau(self.mean)}. The criterion was a lower bound above "
            f"{self.spec.criterion:g}. **{said}.** {say_power(self.power)}"
        )

    def markdown(self) -> str:
        """Return the tables in GitHub's Markdown, under their heading."""
        tables = [markdown(grid.header, grid.rows) for grid in self.grids()]
        return "\n\n".join([f"## {self.spec.title}", f"Cases {self.spec.cases}.", self.verdict, *tables])

    def grids(self) -> list[Grid]:
        """Return a row for each world, then one for each planner."""
        alone = f"{self.spec.alone} ({len(self.spec.alone_cases)} cases) for the suite"
        header = ["world", "tau", "decided pairs that agree", alone, "difference"]
        rates = [
            [name, *(SUCCESS.amount(each[number]) for each in self.rates.values())]
            for number, name in enumerate(self.planners)
        ]
        return [
            Grid(self.spec.title, header, [each.cells() for each in self.worlds], self.worlds),
            Grid("Success", ["success", *self.rates], rates, self.planners),
        ]

    def notes(self) -> list[str]:
        """Return the notes below the tables of a page."""
        return [NOTES]


def say_power(power: Mapping[str, float]) -> str:
    """Return the power of a study in words."""
    shares = ", ".join(f"{100 * share:.0f} % at a true tau of {tau}" for tau, share in power.items())
    return f"Power: {shares}."


def estimate_tau(tau: Float[np.ndarray, "resample"]) -> Estimate:
    """Return a tau, the first of its values, with the interval of the resampled ones."""
    drawn = tau[1:][np.isfinite(tau[1:])]
    return Estimate(float(tau[0]), *interval(drawn), n=len(drawn), max=float(drawn.max()))


def say_tau(tau: Estimate) -> str:
    """Return a tau with its interval in words."""
    return f"{tau.mean:+.2f} ({tau.low:+.2f} to {tau.high:+.2f})"
