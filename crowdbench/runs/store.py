"""A run on disk: written, and read and checked: its files are those that it wrote, and they agree with each other."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from crowdbench.core.types import Outcome, Rules
from crowdbench.metrics import info_of, is_rate
from crowdbench.metrics.outcomes import COUNTED
from crowdbench.metrics.summary import weighted_mean
from crowdbench.runs.recording import COMMANDS, Commands, read_commands
from crowdbench.runs.result_file import RESULT, check_result, read_result, write_result
from crowdbench.runs.results import EPISODES, RECORDING, Episodes, result_label
from crowdbench.scenario.cases import Cases
from crowdbench.utils.errors import InputError

if TYPE_CHECKING:
    from crowdbench.record.contents import Recording


def write_run(folder: Path, episodes: Episodes, result: Mapping[str, Any]) -> None:
    """Write the files of a run beside its commands and its recording.

    Args:
        folder: The folder, which becomes the run's directory.
        episodes: What was measured.
        result: The contents of `result.json`, without the digests of the files.
    """
    episodes.write(folder / EPISODES)
    write_result(folder, result)


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
    def read(cls, directory: Path) -> RunResult:
        """Read a run and check it.

        Raises:
            InputError: A file is missing, cannot be read, is not the one that the run wrote, or contradicts another.
        """
        result = check_result(directory, (EPISODES,))
        episodes = Episodes.read(directory / EPISODES)
        for contradiction in _contradictions(result, episodes):
            raise InputError(f"{directory / EPISODES} {contradiction}; make the run again")
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

    @functools.cached_property
    def commands(self) -> Commands:
        """The commands of its cases. Raises InputError where they were not kept, or the file is damaged."""
        return read_commands(self.directory / COMMANDS)

    @functools.cached_property
    def recording(self) -> Recording | None:
        """What is recorded, None where nothing is. Raises InputError where the file is damaged."""
        if not (self.directory / RECORDING).exists():
            return None
        from crowdbench.record.contents import read

        return read(self.directory / RECORDING)


def _contradictions(result: Mapping[str, Any], episodes: Episodes) -> Iterator[str]:
    """In which points a table of episodes contradicts its result or itself."""
    cases, scenario = Cases.parse(result["run"]["cases"]), result["scenario"]
    if len(episodes) != len(cases):
        yield f"has {len(episodes)} rows, but {RESULT} says cases {cases}"
    if wrong := np.flatnonzero(episodes.case != cases.indices).tolist():
        yield f"has case {episodes.case[wrong[0]]} in the place of case {cases.start + wrong[0]}"
    most = Rules(dt=scenario["dt"], time_limit=scenario["time_limit"]).max_steps
    if wrong := np.flatnonzero((episodes.steps < 1) | (episodes.steps > most)).tolist():
        yield f"has {episodes.steps[wrong[0]]} steps in case {episodes.case[wrong[0]]}, which must be 1 to {most}"
    for outcome in Outcome:
        number, stated = int((episodes.outcome == outcome).sum()), result["outcomes"].get(outcome.label, 0)
        if number != stated:
            yield f"has {number} episodes with the outcome {outcome.label}, but {RESULT} says {stated}"
    for name in COUNTED.keys() & episodes.columns.keys():
        values = episodes.columns[name]
        if not is_rate(values):
            yield f"has values in the column {name} that are not true or false"
        if wrong := np.flatnonzero(values != np.isin(episodes.outcome, COUNTED[name])).tolist():
            label = Outcome(int(episodes.outcome[wrong[0]])).label
            yield f"has another {name} than the outcome {label} means in case {episodes.case[wrong[0]]}"
    for named in (result["metrics"], result["run"]["metrics"]):
        if differ := sorted(named.keys() ^ episodes.columns.keys()):
            yield f"and {RESULT} have not the same metrics ({', '.join(differ)})"
    if result.get("rates") != episodes.rates:
        yield f"has other rates than {RESULT}"
    for name in episodes.columns:
        (n, mean), estimate = _mean(name, episodes), result["metrics"][name]
        if n != estimate["n"] or not _is_close(mean, estimate["mean"]):
            yield (
                f"has {n} values of {name} with the mean {mean}, but {RESULT} says {estimate['n']} with "
                f"{estimate['mean']}"
            )


def _mean(name: str, episodes: Episodes) -> tuple[int, float | None]:
    """In how many episodes a metric is defined, and its mean, if it is in any."""
    values = episodes.columns[name].astype(float)
    is_defined = ~np.isnan(values)
    weights = episodes.steps * 1.0 if info_of(name).pooled else np.ones(len(values))
    n = int(is_defined.sum())
    return n, float(weighted_mean(values[is_defined], weights[is_defined])) if n else None


def _is_close(one: float | None, two: float | None) -> bool:
    if one is None or two is None:
        return one is two
    return math.isclose(one, two, rel_tol=1e-9, abs_tol=1e-12)  # another version of NumPy may add in another order
