"""Write a run to disk, and read it with checks that its files are unchanged and agree with each other."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from crowdbench.core.types import Rules, Trace
from crowdbench.metrics.outcomes import COUNTED
from crowdbench.results.episodes import BLOCK, EPISODES, RECORDING, Episodes, result_label
from crowdbench.results.result_file import RESULT, check_result, digest_of, write_result
from crowdbench.results.stored_commands import COMMANDS, StoredCommands, read_commands
from crowdbench.results.stored_tracks import TRACKS, read_tracks
from crowdbench.scenario.cases import Cases, parse_case
from crowdbench.scenario.digest import scenario_digest
from crowdbench.sim.version import SIMULATOR
from crowdbench.utils.errors import InputError, is_number
from crowdbench.utils.tables import flatten, plain


def write_run(
    folder: Path,
    episodes: Episodes,
    *,
    run: Mapping[str, Any],
    scenario: Mapping[str, Any],
    recorded: int,
    stated: Mapping[str, Any],
) -> dict[str, Any]:
    """Write the files of a run beside its exact store (`commands.parquet` or `tracks.parquet`) and its recording.

    Args:
        folder: The folder, which becomes the run's directory.
        episodes: The measured episodes.
        run: Parts of its identity, see `RunId.parts`.
        scenario: The contents of the scenario.
        recorded: The number of recorded episodes.
        stated: Facts that cannot be recomputed from the other files.

    Returns:
        The contents of `result.json`.
    """
    episodes.write(folder / EPISODES)
    result = {
        "id": digest_of(run),
        "run": run,
        "scenario": scenario,
        "recorded": recorded,
        **summary_of(episodes),
        "stated": stated,
    }
    return write_result(folder, result)


def summary_of(episodes: Episodes) -> dict[str, Any]:
    """Return the entries of `result.json` that follow from a table of episodes."""
    metrics = plain(episodes.summary())
    return {"outcomes": episodes.counts(), "metrics": metrics, **episodes.blocks, "rates": episodes.rates}


@dataclass(frozen=True)
class RunResult:
    """A run on disk.

    Attributes:
        directory: Its directory.
        result: The contents of `result.json`.
        episodes: The table in `episodes.csv`.
    """

    directory: Path
    result: dict[str, Any]
    episodes: Episodes

    @classmethod
    def read(cls, directory: Path, tables_only: bool = False) -> RunResult:
        """Read a run and check it: all values that follow from other files of the run are computed again.

        Args:
            directory: Its directory.
            tables_only: True if files other than `result.json` and `episodes.csv` may be missing.

        Raises:
            InputError: A file is missing, cannot be read, is not the one that the run wrote, or contradicts another.
        """
        result = check_result(directory, tables_only)
        run = cls(directory, result, Episodes.read(directory / EPISODES))
        run.check()
        return run

    def check(self, rows_only: bool = False) -> None:
        """Raise InputError with the file and the field if the files of the run contradict each other.

        Args:
            rows_only: True to check only `episodes.csv` and the commands, not `result.json`.
        """
        others = () if rows_only else (self._wrong_fields(), self._wrong_files())
        for file, sentence in itertools.chain(self._wrong_rows(), *others):
            raise InputError(f"{self.directory / file}: {sentence}; make the run again")

    def _wrong_rows(self) -> Iterator[tuple[str, str]]:
        """Yield the errors in `episodes.csv` and in the commands, each as a file and the rest of a sentence."""
        episodes, cases, most = self.episodes, self.cases, self.rules.max_steps
        vehicles = self.vehicles
        scored = 1 if "others" in self.result["run"] else vehicles
        if not np.array_equal(episodes.case, cases.indices.repeat(scored)):
            yield EPISODES, f"its cases differ from {cases}, as in {RESULT}"
        elif not ((episodes.steps >= 1) & (episodes.steps <= most)).all():
            yield EPISODES, f"steps are not all from 1 to {most}"
        if vehicles > 1:
            expected = np.tile(np.arange(scored), len(cases))
            if episodes.vehicle is None or not np.array_equal(episodes.vehicle, expected):
                yield EPISODES, f"its vehicles differ from {RESULT}"
        elif (episodes.block is not None) != ("tracks" in self.result["scenario"]):
            yield EPISODES, f"it must have a column {BLOCK} if pedestrians are recorded, and only then"
        if episodes.columns.keys() != self.result["run"]["metrics"].keys():
            yield RESULT, f"run.metrics are not the columns of {EPISODES}"
        for name in COUNTED.keys() & episodes.columns.keys():
            if not np.array_equal(episodes.columns[name], np.isin(episodes.outcome, COUNTED[name])):
                yield EPISODES, f"{name} contradicts the outcomes"
        if (self.directory / COMMANDS).exists():
            for name in ("case", "steps"):
                if not np.array_equal(getattr(self.commands, name)[:: vehicles // scored], getattr(episodes, name)):
                    yield COMMANDS, f"its {name} differ from {EPISODES}"

    def _wrong_fields(self) -> Iterator[tuple[str, str]]:
        """Yield the fields of `result.json` that do not follow from `episodes.csv` or from the scenario."""
        found = summary_of(self.episodes)
        recomputed = flatten({"blocks": None, **found})
        stated = flatten({name: self.result.get(name) for name in ("blocks", *found)})
        for name in {**stated, **recomputed}:
            if not _agree(stated.get(name), recomputed.get(name)):
                yield RESULT, f"{name} is {stated.get(name)!r}, but {EPISODES} gives {recomputed.get(name)!r}"
        digest, computed = self.result["run"]["scenario"], scenario_digest(self.result["scenario"])
        if self.is_simulated and digest != computed:
            yield RESULT, f"run.scenario is {digest}, but its table scenario has the digest {computed}"

    def _wrong_files(self) -> Iterator[tuple[str, str]]:
        """Yield the errors in the list of files."""
        listed, record, recorded = self.result["files"], self.result["stated"]["record"], self.result["recorded"]
        if (COMMANDS in listed) + (TRACKS in listed) != (record != "none"):
            yield RESULT, f"stated.record is {record!r}, which contradicts files.{COMMANDS} or files.{TRACKS}"
        if (RECORDING in listed) != (recorded > 0):
            yield RESULT, f"recorded is {recorded}, which contradicts files.{RECORDING}"

    def find_case(self, case: int | str) -> int:
        """Return the number of a case, given by its number or its name. Raises InputError if the run has no such
        case."""
        split, number = parse_case(str(case), self.cases.split)
        if split != self.cases.split or number not in self.cases.indices:
            raise InputError(f"case {case} is none of the cases {self.cases} of {self.directory}")
        return number

    @property
    def cases(self) -> Cases:
        """Its cases."""
        return Cases.parse(self.result["run"]["cases"])

    @property
    def vehicles(self) -> int:
        """The number of vehicles in a world of its scenario."""
        return int(self.result["scenario"].get("vehicle", {}).get("number") or 1)

    @property
    def rules(self) -> Rules:
        """The length of a step and the time limit of its scenario; other rules have their defaults."""
        scenario = self.result["scenario"]
        return Rules(dt=scenario["dt"], time_limit=scenario["time_limit"])

    @property
    def label(self) -> str:
        """The planner's name with its settings, for display."""
        return result_label(self.result)

    @property
    def warnings(self) -> list[str]:
        """Reasons why the run may not be comparable with others, a sentence each."""
        made = self.result["run"]["simulator"]
        if made == SIMULATOR:
            return []
        return [f"{self.directory} was made by version {made} of the simulator, and this is version {SIMULATOR}"]

    @property
    def header(self) -> dict[str, Any]:
        """The properties of the run for a recording, see `record.write.Recorder`."""
        scenario = {"scenario": self.result["scenario"]["name"], "scenario_digest": self.result["run"]["scenario"]}
        return {"planner": self.label, **scenario}

    @property
    def is_simulated(self) -> bool:
        """True if the exact store is commands, with which the run is simulated again; False if it is tracks."""
        return TRACKS not in self.result["files"]

    @functools.cached_property
    def commands(self) -> StoredCommands:
        """The commands of its cases. Raises InputError if they were not stored, or the file is damaged."""
        return read_commands(self.directory / COMMANDS)

    @functools.cached_property
    def tracks(self) -> Trace:
        """The stored tracks. Raises InputError if the file is damaged."""
        return read_tracks(self.directory / TRACKS)


def _agree(stated: Any, recomputed: Any) -> bool:
    """Return whether two values are the same up to rounding. Another version of NumPy may sum in another order."""
    if is_number(stated) and isinstance(recomputed, float):
        return math.isclose(stated, recomputed, rel_tol=1e-9, abs_tol=1e-12)
    return type(stated) is type(recomputed) and stated == recomputed
