"""A run on disk: written, and read and checked: its files are those that it wrote, and they agree with each other."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from crowdbench.core.types import Rules
from crowdbench.metrics.outcomes import COUNTED
from crowdbench.runs.identity import digest
from crowdbench.runs.recording import COMMANDS, Commands, read_commands
from crowdbench.runs.result_file import RESULT, check_result, read_result, write_result
from crowdbench.runs.results import EPISODES, RECORDING, Episodes, read_estimate, result_label
from crowdbench.scenario.cases import Cases
from crowdbench.utils.errors import InputError
from crowdbench.utils.tables import plain

if TYPE_CHECKING:
    from crowdbench.record.contents import Recording


def write_run(
    folder: Path,
    episodes: Episodes,
    *,
    run: Mapping[str, Any],
    scenario: Mapping[str, Any],
    recorded: int,
    stated: Mapping[str, Any],
    interrupted: bool = False,
) -> dict[str, Any]:
    """Write the files of a run beside its commands and its recording.

    Args:
        folder: The folder, which becomes the run's directory.
        episodes: The result.
        run: Parts of its identity, see `RunId.parts`.
        scenario: The contents of the scenario.
        recorded: The number of recorded episodes.
        stated: Facts that cannot be recomputed from the other files.
        interrupted: True if cases are missing that were asked for.

    Returns:
        The contents of `result.json`.
    """
    episodes.write(folder / EPISODES)
    result = {
        "id": digest(run),
        "run": run,
        "scenario": scenario,
        "interrupted": interrupted,
        "recorded": recorded,
        "outcomes": episodes.counts(),
        "metrics": plain(episodes.summary()),
        **episodes.blocks,
        "rates": episodes.rates,
        "stated": stated,
    }
    return write_result(folder, result)


@dataclass(frozen=True)
class RunResult:
    """A run on disk.

    Attributes:
        directory: Its directory.
        result: The contents of `result.json`.
        episodes: The table in `episodes.csv`.
        broken: The sentence on the first file that is not as the run wrote it, empty for a run that was checked.
    """

    directory: Path
    result: dict[str, Any]
    episodes: Episodes
    broken: str = ""

    @classmethod
    def read(cls, directory: Path, tables_only: bool = False) -> RunResult:
        """Read a run and check it.

        Args:
            directory: Its directory.
            tables_only: True to check `result.json` and `episodes.csv` alone; other files may be missing.

        Raises:
            InputError: A file is missing, cannot be read, is not the one that the run wrote, or contradicts another.
        """
        result = check_result(directory, (EPISODES,), tables_only)
        episodes = Episodes.read(directory / EPISODES)
        if differences := _contradictions(result, episodes):
            raise InputError(f"{directory / EPISODES} and {RESULT} differ in {differences[0]}; make the run again")
        return cls(directory, result, episodes)

    @classmethod
    def read_unchecked(cls, directory: Path) -> RunResult:
        """Read a run that a replay checks. Raises InputError where a file is missing or damaged."""
        if not directory.is_dir():
            raise InputError(f"{directory} is not the directory of a run, which --replay needs")
        result, broken = read_result(directory), ""
        try:
            check_result(directory, (EPISODES, COMMANDS, RECORDING))
        except InputError as error:
            broken = str(error)  # and the replay says what in the file is wrong
        return cls(directory, result, Episodes.read(directory / EPISODES), broken)

    @property
    def cases(self) -> Cases:
        """Its cases."""
        return Cases.parse(self.result["run"]["cases"])

    @property
    def label(self) -> str:
        """The planner's name with its settings, as shown to people."""
        return result_label(self.result)

    @property
    def header(self) -> dict[str, Any]:
        """Return the properties of the run for a recording, see `record.write.Recorder`."""
        names = {"planner": self.label, "scenario": self.result["scenario"]["name"], "cases": len(self.cases)}
        return names | {"scenario_digest": self.result["run"]["scenario"]}

    @functools.cached_property
    def commands(self) -> Commands:
        """The commands of its cases. Raises InputError where they were not kept, or the file is damaged."""
        return read_commands(self.directory / COMMANDS)

    @functools.cached_property
    def recording(self) -> Recording | None:
        """The recording, None where nothing is recorded. Raises InputError where the file is damaged."""
        if not (self.directory / RECORDING).exists():
            return None
        from crowdbench.record.contents import read

        return read(self.directory / RECORDING)


def _contradictions(result: Mapping[str, Any], episodes: Episodes) -> list[str]:
    """Return the points in which a table of episodes contradicts its result or itself."""
    cases, metrics = Cases.parse(result["run"]["cases"]), set(episodes.columns)
    rules = Rules(dt=result["scenario"]["dt"], time_limit=result["scenario"]["time_limit"])
    agreement = {
        "the cases": len(episodes) == len(cases) and bool((episodes.case == cases.indices).all()),
        "steps": bool(((episodes.steps >= 1) & (episodes.steps <= rules.max_steps)).all()),
        "outcomes": episodes.counts() == result["outcomes"],
        "metrics": metrics == result["metrics"].keys() == result["run"]["metrics"].keys(),
        "rates": episodes.rates == result.get("rates"),
    }
    for name in COUNTED.keys() & metrics:
        agreement[name] = np.array_equal(episodes.columns[name], np.isin(episodes.outcome, COUNTED[name]))
    for name in metrics & result["metrics"].keys() if agreement["steps"] else ():
        n, mean = episodes.mean(name)
        stated = read_estimate(result["metrics"][name])
        # Another version of NumPy may add in another order.
        is_close = np.isclose(mean, stated.mean, rtol=1e-9, atol=1e-12, equal_nan=True)
        agreement[f"the mean of {name}"] = n == stated.n and bool(is_close)
    return [name for name, agrees in agreement.items() if not agrees]
