"""Write a run to disk, and read it with checks that its files are unchanged and agree with each other."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from crowdbench.core.types import Outcome, Rules, Trace
from crowdbench.metrics.outcomes import COUNTED
from crowdbench.results.episodes import BLOCK, EPISODES, RECORDING, Episodes, result_label
from crowdbench.results.result_file import RESULT, check_result, digest_of, read_result, write_result
from crowdbench.results.stored_commands import COMMANDS, StoredCommands, check_size, read_commands
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.digest import scenario_digest
from crowdbench.sim.version import SIMULATOR
from crowdbench.utils.errors import InputError, is_number
from crowdbench.utils.tables import flatten, plain

if TYPE_CHECKING:
    from crowdbench.record.contents import Recording


BAG_DIGEST_LENGTH = 64
"""Number of digits of the digest of a robot's bags, which replaces the digest of a scenario."""


def write_run(
    folder: Path,
    episodes: Episodes,
    *,
    run: Mapping[str, Any],
    scenario: Mapping[str, Any],
    recorded: int,
    stated: Mapping[str, Any],
) -> dict[str, Any]:
    """Write the files of a run beside its commands and its recording.

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
        broken: The message on the first check of the files that failed; empty for a run that passed the checks.
    """

    directory: Path
    result: dict[str, Any]
    episodes: Episodes
    broken: str = ""

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

    @classmethod
    def read_unchecked(cls, directory: Path) -> RunResult:
        """Read a run for a replay, also if its checks fail. Raises InputError if a file is missing or damaged."""
        if not directory.is_dir():
            raise InputError(f"{directory} is not the directory of a run, which --replay needs")
        try:
            return cls.read(directory)
        except InputError as error:  # the replay reports the errors in the file
            return cls(directory, read_result(directory), Episodes.read(directory / EPISODES), str(error))

    def check(self) -> None:
        """Raise InputError with the file and the field if the files of the run contradict each other."""
        rules = self.rules
        rows, files = self._wrong_rows(rules), self._wrong_files(rules)
        for file, sentence in itertools.chain(rows, self._wrong_fields(), files):
            raise InputError(f"{self.directory / file}: {sentence}; make the run again")

    def _wrong_rows(self, rules: Rules) -> Iterator[tuple[str, str]]:
        """Yield the errors in the rows of `episodes.csv`, each as a file and the rest of a sentence."""
        episodes, cases = self.episodes, self.cases
        if len(episodes) != len(cases) or not (episodes.case == cases.indices).all():
            yield EPISODES, f"its cases differ from {cases}, as in {RESULT}"
        elif not ((episodes.steps >= 1) & (episodes.steps <= rules.max_steps)).all():
            yield EPISODES, f"steps are not all from 1 to {rules.max_steps}"
        if (episodes.block is not None) != ("tracks" in self.result["scenario"]):
            yield EPISODES, f"it must have a column {BLOCK} if pedestrians are recorded, and only then"
        if episodes.columns.keys() != self.result["run"]["metrics"].keys():
            yield RESULT, f"run.metrics are not the columns of {EPISODES}"
        for name in COUNTED.keys() & episodes.columns.keys():
            if not np.array_equal(episodes.columns[name], np.isin(episodes.outcome, COUNTED[name])):
                yield EPISODES, f"{name} contradicts the outcomes"

    def _wrong_fields(self) -> Iterator[tuple[str, str]]:
        """Yield the fields of `result.json` that do not follow from `episodes.csv` or from the scenario."""
        found = summary_of(self.episodes)
        recomputed = flatten({"blocks": None, **found})
        stated = flatten({name: self.result.get(name) for name in ("blocks", *found)})
        for name in {**stated, **recomputed}:
            if not _agree(stated.get(name), recomputed.get(name)):
                yield RESULT, f"{name} is {stated.get(name)!r}, but {EPISODES} gives {recomputed.get(name)!r}"
        digest, computed = self.result["run"]["scenario"], scenario_digest(self.result["scenario"])
        if len(digest) != BAG_DIGEST_LENGTH and digest != computed:
            yield RESULT, f"run.scenario is {digest}, but its table scenario has the digest {computed}"

    def _wrong_files(self, rules: Rules) -> Iterator[tuple[str, str]]:
        """Yield the errors in the commands and the recording."""
        result, record, recorded = self.result, self.result["stated"]["record"], self.result["recorded"]
        has_commands = record != "none" and len(result["run"]["scenario"]) != BAG_DIGEST_LENGTH
        for name, is_written in ((COMMANDS, has_commands), (RECORDING, recorded > 0)):
            if is_written != (name in result["files"]):
                yield RESULT, f"stated.record is {record!r} and recorded {recorded}, which contradicts files.{name}"
        commands, recording = self.directory / COMMANDS, self.directory / RECORDING
        if commands.exists():
            check_size(commands, len(self.cases), rules.max_steps)
            for name in ("case", "steps"):
                if not np.array_equal(getattr(self.commands, name), getattr(self.episodes, name)):
                    yield COMMANDS, f"its {name} differ from {EPISODES}"
        if recording.exists():
            from crowdbench.record.recorded_cases import read_header

            header, ends = read_header(recording)
            right = {**self.header, "split": self.cases.split, "recorded": recorded}
            for name, value in {**header, "recorded": len(ends)}.items():
                if value != right[name]:
                    yield RECORDING, f"its {name} is {value!r}, but {RESULT} says {right[name]!r}"
            labels = [Outcome(outcome).label for outcome in self.episodes.outcome]
            if not ends.items() <= dict(zip(self.episodes.case.tolist(), labels, strict=True)).items():
                yield RECORDING, f"its outcomes differ from {EPISODES}"

    @property
    def cases(self) -> Cases:
        """Its cases."""
        return Cases.parse(self.result["run"]["cases"])

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
        names = {"planner": self.label, "scenario": self.result["scenario"]["name"], "cases": len(self.cases)}
        return names | {"scenario_digest": self.result["run"]["scenario"]}

    @functools.cached_property
    def commands(self) -> StoredCommands:
        """The commands of its cases. Raises InputError if they were not recorded, or the file is damaged."""
        return read_commands(self.directory / COMMANDS)

    @property
    def drives(self) -> Trace | None:
        """The recorded drives of a robot; None for a simulated run."""
        is_simulated = len(self.result["run"]["scenario"]) != BAG_DIGEST_LENGTH
        return None if is_simulated or self.recording is None else self.recording.trace

    @functools.cached_property
    def recording(self) -> Recording | None:
        """The recording; None if nothing is recorded. Raises InputError if the file is damaged."""
        if not (self.directory / RECORDING).exists():
            return None
        from crowdbench.record.contents import read

        return read(self.directory / RECORDING)


def _agree(stated: Any, recomputed: Any) -> bool:
    """Return whether two values are the same up to rounding. Another version of NumPy may sum in another order."""
    if is_number(stated) and isinstance(recomputed, float):
        return math.isclose(stated, recomputed, rel_tol=1e-9, abs_tol=1e-12)
    return type(stated) is type(recomputed) and stated == recomputed
