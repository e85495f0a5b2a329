"""`[[rankings]]`: agreement of the order of planners in the suite with the order in other worlds."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field

from crowdbench.core import SENSING_TRACKS
from crowdbench.metrics import Estimate
from crowdbench.results import holm
from crowdbench.runs import Run, RunSpec
from crowdbench.utils import Grid, Location, Name, Names, TomlTable, markdown
from studies.folder import load_runs
from studies.orders import Cases, agreement, decided_signs, read_cases, resample_means
from studies.pages import SCORE
from studies.schema import CasesText, Planners, PlannerSpec, StudyHead
from studies.transfer.permutation import p_value, reliability, share
from studies.transfer.power import CORRELATIONS, LEVEL, power

RELIABLE = 0.7
"""Least reliability of the suite and of a world that are compared."""

NOTES = " ".join(Path(__file__).with_name("notes.txt").read_text("utf-8").split())
"""The notes below the tables."""


class WorldSpec(TomlTable):
    """`[rankings.worlds.NAME]`: scenarios in which the order of the suite in the same track of sensing is to hold.

    `pedestrians` is a policy that replaces that of the scenarios. `through` is a planner with an option `name` that
    executes each planner. `cases` replaces the cases of the table.
    """

    scenarios: Names
    track: str = Field(pattern=f"^({'|'.join(SENSING_TRACKS)})$", description='"perfect" or "realistic"')
    pedestrians: str | None = Field(default=None, description="a text in quotes")
    through: PlannerSpec | None = Field(default=None, description="a table with planner and options")
    cases: CasesText | None = None


class RankingsSpec(TomlTable):
    """`[[rankings]]`: planners, a suite of scenarios that ranks them, and worlds in which that order is to hold."""

    title: Name
    planners: Planners
    suite: Names
    worlds: Annotated[dict[str, WorldSpec], Field(min_length=1, description="a table of worlds")]
    cases: CasesText

    def orders(self) -> dict[str, WorldSpec]:
        """Return all orders of planners: the suite in the tracks of its worlds, and the worlds."""
        tracks = [track for track in SENSING_TRACKS if track in {world.track for world in self.worlds.values()}]
        return {_suite(track): WorldSpec(scenarios=self.suite, track=track) for track in tracks} | self.worlds


class TransferStudy(StudyHead):
    """The TOML file of the study."""

    rankings: list[RankingsSpec] = Field(min_length=1, description="one table [[rankings]] or more")


@dataclasses.dataclass(frozen=True)
class RankingsTable:
    """Planners in a suite and in worlds, and their runs.

    Attributes:
        spec: The table of the file.
        runs_by_order: The runs of each scenario of each order, see `RankingsSpec.orders`.
    """

    spec: RankingsSpec
    runs_by_order: Mapping[str, list[list[Run]]]

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
        with location.named():
            runs = {name: _load(spec, order, data) for name, order in spec.orders().items()}
        labels = _labels(runs)
        if len(set(labels)) < len(labels):
            raise location.at("planners").wrong(repr(labels), "planners that differ in their names or options")
        return cls(spec, runs)

    @property
    def runs(self) -> list[Run]:
        """All runs that it needs."""
        return [run for scenarios in self.runs_by_order.values() for runs in scenarios for run in runs]

    def power(self) -> str:
        """Return the power of the study in words."""
        planners, ranges = self.spec.planners, {name: each.cases for name, each in self.spec.orders().items()}
        cases = [len(ranges[name] or self.spec.cases) * len(runs) for name, runs in self.runs_by_order.items()]
        worlds = cases[len(cases) - len(self.spec.worlds) :]
        shares = [f"{power(each, len(planners), [cases[0], *worlds]):.0%} at {each:g}" for each in CORRELATIONS]
        return f"Power, by the true rank correlation: {', '.join(shares)}.".replace("%", " %")

    def read(self, out: Path) -> dict[str, list[Cases]]:
        """Return the scores in each scenario of each order. Raises InputError if a run is missing."""
        return {name: [read_cases(runs, out) for runs in each] for name, each in self.runs_by_order.items()}

    def reliability(self, out: Path) -> Grid:
        """Return the reliability of each order, without any comparison of orders."""
        rows = []
        for name, scenarios in self.read(out).items():
            blocks = sum(len(np.unique(each.block)) for each in scenarios)
            found = reliability(scenarios)
            cases = sum(each.value.shape[1] for each in scenarios)
            rows.append([name, f"{found:.2f}", "" if found >= RELIABLE else "too low", str(cases), str(blocks)])
        return Grid("Split-half reliability", ["order", "reliability", "", "cases", "cases or blocks of time"], rows)

    def fill(self, out: Path) -> FilledRankings:
        """Return the table with the figures of the runs in the folder `out`; raises InputError if one is missing."""
        return FilledRankings.of(self.spec, _labels(self.runs_by_order), self.read(out), self.power())


def _suite(track: str) -> str:
    """Return the name of the suite's order in a track."""
    return f"suite, {track}"


def _labels(runs: Mapping[str, list[list[Run]]]) -> list[str]:
    """Return the names of planners in the suite."""
    return [run.label for run in next(iter(runs.values()))[0]]


def _load(spec: RankingsSpec, world: WorldSpec, data: Path | None) -> list[list[Run]]:
    """Return the runs of all planners in each scenario of a world."""
    planners = spec.planners
    if world.through is not None:
        planners = [_through(world.through, each) for each in planners]
    base = RunSpec(
        "",
        "",
        world.cases or spec.cases,
        overrides={"sensor.track": world.track},
        pedestrians=world.pedestrians,
        record="none",
        data=data,
    )
    return [load_runs(planners, dataclasses.replace(base, scenario=name)) for name in world.scenarios]


def _through(outer: PlannerSpec, inner: PlannerSpec) -> PlannerSpec:
    """Return a planner that executes another one."""
    options = {**outer.options, "name": inner.planner}
    if inner.options:
        options["options"] = inner.options
    return PlannerSpec(planner=outer.planner, options=options)


@dataclasses.dataclass(frozen=True)
class WorldResult:
    """Agreement of the order of planners in a world with the suite's order.

    Attributes:
        world: The world.
        track: The track of sensing.
        reliability: The split-half reliability of the world.
        share: The share of the pairs decided in both that agree. It and all below are None if an order is unreliable.
        agree: Number of pairs that are decided in both and have the same order.
        disagree: Number of pairs that are decided in both and have opposite orders.
        undecided: Number of all other pairs.
        p: The p-value of the permutation test.
        corrected: The p-value after Holm over the tested worlds.
    """

    world: str
    track: str
    reliability: float
    share: Estimate | None = None
    agree: int | None = None
    disagree: int | None = None
    undecided: int | None = None
    p: float | None = None
    corrected: float | None = None

    @property
    def verdict(self) -> str:
        """The result of the test in words."""
        if self.corrected is None:
            return "undecided"
        return "holds" if self.corrected < LEVEL else "not shown"

    def cells(self) -> list[str]:
        """Return its row in a table."""
        head = [self.world, self.track, f"{self.reliability:.2f}"]
        if self.corrected is None or self.share is None:
            return [*head, "", "", "", "", self.verdict]
        counts = np.array([self.agree, self.disagree, self.undecided], float)
        parts = " / ".join(f"{part:.0f}" for part in 100.0 * counts / counts.sum())
        decided = f"{self.agree} of {self.share.n}"
        if self.share.n:
            decided += f": {self.share.mean:.0%} ({self.share.low:.0%} to {self.share.high:.0%})".replace("%", " %")
        return [*head, decided, parts, f"{self.p:.4f}", f"{self.corrected:.4f}", self.verdict]


@dataclasses.dataclass(frozen=True)
class FilledRankings:
    """The table with its figures. `--format json` prints its fields.

    Attributes:
        spec: The table of the file.
        planners: The planners, the highest mean score in the suite first.
        scores: Their mean scores in the suite and in the worlds.
        reliability: The split-half reliability of the suite in each track.
        worlds: The agreement of each world with the suite.
        power: The power of the study in words.
    """

    spec: RankingsSpec
    planners: list[str]
    scores: dict[str, list[float]]
    reliability: dict[str, float]
    worlds: list[WorldResult]
    power: str

    @classmethod
    def of(
        cls, spec: RankingsSpec, planners: Sequence[str], cases: Mapping[str, list[Cases]], power: str
    ) -> FilledRankings:
        """Compare the order of planners in the suite with those in the worlds.

        Args:
            spec: The table of the file.
            planners: The planners.
            cases: Their scores in each scenario of each order, see `RankingsSpec.orders`.
            power: The power of the study in words.
        """
        reliable = {name: reliability(scenarios) for name, scenarios in cases.items()}
        means = {name: resample_means(scenarios) for name, scenarios in cases.items()}
        signs = {name: decided_signs(each)[0] for name, each in means.items()}
        worlds = []
        for name, world in spec.worlds.items():
            suite, result = _suite(world.track), WorldResult(name, world.track, reliable[name])
            if min(reliable[suite], reliable[name]) >= RELIABLE:
                agree, decided = agreement(means[suite], means[name])
                result = dataclasses.replace(
                    result,
                    share=share(means[suite], means[name]),
                    agree=agree,
                    disagree=decided - agree,
                    undecided=len(signs[name]) - decided,
                    p=p_value(signs[suite], signs[name], np.random.default_rng(0)),
                )
            worlds.append(result)
        corrected = iter(holm(np.array([world.p for world in worlds if world.p is not None])))
        worlds = [each if each.p is None else dataclasses.replace(each, corrected=next(corrected)) for each in worlds]
        order = np.argsort(-next(iter(means.values()))[0], kind="stable")
        scores = {name: each[0][order].tolist() for name, each in means.items()}
        suites = {name: each for name, each in reliable.items() if name not in spec.worlds}
        return cls(spec, [planners[each] for each in order], scores, suites, worlds, power)

    @property
    def verdict(self) -> str:
        """A text with the worlds in which the order holds, and with the power."""
        named = {
            verdict: [world.world for world in self.worlds if world.verdict == verdict]
            for verdict in ("holds", "not shown", "undecided")
        }
        holds, unshown, undecided = (", ".join(each) or "none" for each in named.values())
        reliabilities = ", ".join(f"{value:.2f} ({name})" for name, value in self.reliability.items())
        return (
            f"**The suite's order holds in {len(named['holds'])} of {len(self.worlds)} worlds: {holds}.** Not shown: "
            f"{unshown}. Undecided because of a reliability below {RELIABLE:g}: {undecided}. "
            f"Reliability of the suite: {reliabilities}. {self.power}"
        )

    def markdown(self) -> str:
        """Return the tables in GitHub's Markdown, under their heading."""
        tables = [markdown(grid.header, grid.rows) for grid in self.grids()]
        ranges = [f"{world.cases} in {name}" for name, world in self.spec.worlds.items() if world.cases]
        cases = f"Cases {', '.join([str(self.spec.cases), *ranges])}."
        return "\n\n".join([f"## {self.spec.title}", cases, self.verdict, *tables])

    def grids(self) -> list[Grid]:
        """Return a row for each world, then one for each planner."""
        header = ["world", "sensing", "reliability", "decided pairs that agree", "agree / disagree / undecided, %"]
        header += ["p", "p after Holm", "the suite's order"]
        scores = [
            [name, *(SCORE.number(each[number]) for each in self.scores.values())]
            for number, name in enumerate(self.planners)
        ]
        return [
            Grid(self.spec.title, header, [each.cells() for each in self.worlds], self.worlds),
            Grid("Scores", ["score", *self.scores], scores, self.planners),
        ]

    def notes(self) -> list[str]:
        """Return the notes below the tables of a page."""
        return [NOTES]
