"""The tables of the study: published networks in scenarios, and the effect of the pedestrians of their training."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from pydantic import Field

from crowdbench import Cases
from crowdbench.metrics import Estimate, mean_over_networks
from crowdbench.runs import Run, RunSpec, load_run
from crowdbench.utils import Grid, Name, Names, TomlTable, markdown
from studies.folder import read_episodes
from studies.pages import NOTES, SUCCESS, SUCCESS_RATE
from studies.schema import CasesText, StudyHead

KINDS = ("sarl", "cadrl", "lstm_rl")
SCENES = {"circular_crossing": "circle", "parallel_traffic": "traffic", "hybrid_scenario": "both"}
PEOPLE = {"orca": "ORCA", "sfm": "social force", "hsfm": "headed social force"}
"""The kind of a network, the scene and the pedestrians of its training: by their names in the name of its file."""

RATES = (SUCCESS_RATE, "at_fault_rate")

DS_RNN = Path(__file__).parents[2] / "adapters" / "ds_rnn" / "ds_rnn.py"


class ScenariosSpec(TomlTable):
    """`[[tables]]`: scenarios, and the predictor of pedestrians for the value networks."""

    title: Name
    scenarios: Names
    predictor: Name
    cases: CasesText = Cases.parse("test:100")


class PublishedSpec(StudyHead):
    """The whole file."""

    tables: list[ScenariosSpec] = Field(min_length=1, description="one table [[tables]] or more")


@dataclass(frozen=True)
class FilledPublished:
    """A table with its figures: of each network, and the differences between the pedestrians of the training."""

    title: str
    cases: str
    parts: list[Grid]

    def markdown(self) -> str:
        """See `studies.pages.FilledTable`."""
        tables = [markdown(grid.header, grid.rows) for grid in self.parts]
        return "\n\n".join([f"## {self.title}", f"Cases {self.cases} of each scenario.", *tables])

    def grids(self) -> list[Grid]:
        """See `studies.pages.FilledTable`."""
        return self.parts

    def notes(self) -> list[str]:
        """See `studies.pages.FilledTable`."""
        return [NOTES["published"], NOTES["published_people"]]


@dataclass(frozen=True)
class PublishedTable:
    """Networks in scenarios.

    Attributes:
        spec: The table of the file.
        by_network: By the name of a network, its run in each scenario.
    """

    spec: ScenariosSpec
    by_network: dict[str, list[Run]]

    @classmethod
    def load(cls, spec: ScenariosSpec, networks: Path) -> PublishedTable:
        """Plan the runs of a table. Raises InputError if a scenario, or a network in the folder, does not exist."""
        weights = {
            _name(kind, people, scene): (kind, {"weights": f"{networks}/{scene}__{kind}_on_{people}.safetensors"})
            for kind, people, scene in itertools.product(KINDS, PEOPLE, SCENES)
        } | {f"{kind}, ours": (kind, {}) for kind in KINDS}
        planners = {name: (kind, {**own, "predictor": spec.predictor}) for name, (kind, own) in weights.items()}
        planners["ds_rnn"] = str(DS_RNN), {"weights": f"{networks}/dsrnn.safetensors"}
        return cls(
            spec,
            {
                name: [
                    load_run(RunSpec(planner, each, spec.cases, options=options, record="none"))
                    for each in spec.scenarios
                ]
                for name, (planner, options) in planners.items()
            },
        )

    @property
    def runs(self) -> list[Run]:
        """All runs that it needs."""
        return [run for runs in self.by_network.values() for run in runs]

    def fill(self, out: Path) -> FilledPublished:
        """Fill the table from the runs in the folder `out`. Raises InputError if one is missing."""
        found = {name: [read_episodes(run, out).columns for run in runs] for name, runs in self.by_network.items()}
        scenarios = [run.scenario.name for run in self.by_network["ds_rnn"]]
        rates = {name: [[float(one[rate].mean()) for rate in RATES] for one in runs] for name, runs in found.items()}
        cells = [[name, *("{} ({})".format(*map(SUCCESS.number, each)) for each in row)] for name, row in rates.items()]
        records = [{"network": name, **dict(zip(scenarios, row, strict=True))} for name, row in rates.items()]
        success = {name: np.concatenate([1.0 * one[SUCCESS_RATE] for one in runs]) for name, runs in found.items()}
        gains = {people: {"all": _gain(success, people, KINDS)} for people in ("sfm", "hsfm")}
        for (people, row), kind in itertools.product(gains.items(), KINDS):
            row[kind] = _gain(success, people, [kind])
        points = [
            [f"{PEOPLE[each]} instead of ORCA", *map(SUCCESS.estimate, row.values())] for each, row in gains.items()
        ]
        parts = [
            Grid(self.spec.title, ["network", *scenarios], cells, records),
            Grid(
                "people", ["trained among", "all", *KINDS], points, [{"people": each, **gains[each]} for each in gains]
            ),
        ]
        return FilledPublished(self.spec.title, str(self.spec.cases), parts)


def _gain(success: Mapping[str, Float[np.ndarray, "case"]], people: str, kinds: Sequence[str]) -> Estimate:
    """Return the gain in success of networks trained among these pedestrians over networks trained among ORCA's."""
    pairs = [[success[_name(kind, each, scene)] for each in (people, "orca")] for kind in kinds for scene in SCENES]
    return mean_over_networks(np.array([theirs - orca for theirs, orca in pairs]))


def _name(kind: str, people: str, scene: str) -> str:
    return f"{kind}, {PEOPLE[people]}, {SCENES[scene]}"
