"""A run as it is kept on disk, checked: its files are those that it wrote, and they agree with each other."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from crowdbench.errors import InputError
from crowdbench.evaluate.metrics import POOLED
from crowdbench.evaluate.results import EPISODES, RESULT, Episodes, read_result
from crowdbench.evaluate.seal import Manifest, checked
from crowdbench.evaluate.summary import weighted_mean
from crowdbench.scenario.cases import Cases
from crowdbench.types import Outcome, Rules

RATES = {
    "success_rate": (Outcome.SUCCESS,),
    "collision_rate": (Outcome.COLLISION, Outcome.WALL_COLLISION),
    "person_collision_rate": (Outcome.COLLISION,),
    "wall_collision_rate": (Outcome.WALL_COLLISION,),
    "timeout_rate": (Outcome.TIMEOUT,),
}
"""The outcomes that each of these metrics counts."""


@dataclass(frozen=True)
class KeptRun:
    """A run on disk.

    Attributes:
        result: The contents of `result.json`.
        episodes: The table in `episodes.csv`.
        manifest: The manifest, or None where the run has none.
    """

    result: dict[str, Any]
    episodes: Episodes
    manifest: Manifest | None


def read_run(directory: Path) -> KeptRun:
    """Read a run and check it.

    Args:
        directory: The directory of the run.

    Returns:
        The run.

    Raises:
        InputError: A file is missing, cannot be read, is not the one that the run wrote, or contradicts another one.
    """
    result = read_result(directory)
    manifest = checked(directory, (RESULT, EPISODES))
    episodes = Episodes.read(directory / EPISODES)
    for contradiction in CONTRADICTIONS:
        if found := contradiction(result, episodes):
            raise InputError(f"{directory / EPISODES} {found}; make the run again")
    return KeptRun(result, episodes, manifest)


def _cases(result: Mapping[str, Any], episodes: Episodes) -> str:
    cases = Cases.parse(result["cases"])
    if len(episodes) != len(cases):
        return f"has {len(episodes)} rows, but {RESULT} says cases {cases}"
    if wrong := np.flatnonzero(episodes.case != cases.indices).tolist():
        return f"has case {episodes.case[wrong[0]]} in the place of case {cases.start + wrong[0]}"
    return ""


def _steps(result: Mapping[str, Any], episodes: Episodes) -> str:
    scenario = result["scenario"]
    most = Rules(dt=scenario["dt"], time_limit=scenario["time_limit"]).max_steps
    if wrong := np.flatnonzero((episodes.steps < 1) | (episodes.steps > most)).tolist():
        return f"has {episodes.steps[wrong[0]]} steps in case {episodes.case[wrong[0]]}, which must be 1 to {most}"
    return ""


def _outcomes(result: Mapping[str, Any], episodes: Episodes) -> str:
    for outcome in Outcome:
        found, told = int((episodes.outcome == outcome).sum()), result["outcomes"].get(outcome.label, 0)
        if found != told:
            return f"has {found} episodes with the outcome {outcome.label}, but {RESULT} says {told}"
    return ""


def _rates(result: Mapping[str, Any], episodes: Episodes) -> str:
    for name in RATES.keys() & episodes.columns.keys():
        values = episodes.columns[name]
        if values.dtype != bool:
            return f"has values in the column {name} that are not true or false"
        if wrong := np.flatnonzero(values != np.isin(episodes.outcome, RATES[name])).tolist():
            label = Outcome(int(episodes.outcome[wrong[0]])).label
            return f"has another {name} than the outcome {label} means in case {episodes.case[wrong[0]]}"
    return ""


def _means(result: Mapping[str, Any], episodes: Episodes) -> str:
    if differ := sorted(result["metrics"].keys() ^ episodes.columns.keys()):
        return f"and {RESULT} have not the same metrics ({', '.join(differ)})"
    for name, column in episodes.columns.items():
        values = column.astype(float)
        defined = ~np.isnan(values)
        weights = episodes.steps * 1.0 if name in POOLED else np.ones(len(values))
        n, told = int(defined.sum()), result["metrics"][name]
        mean = float(weighted_mean(values[defined], weights[defined])) if n else None
        if n != told["n"] or not _close(mean, told["mean"]):
            return f"has {n} values of {name} with the mean {mean}, but {RESULT} says {told['n']} with {told['mean']}"
    return ""


def _close(mean: float | None, told: float | None) -> bool:
    # Another version of NumPy may add in another order.
    return mean is told is None or (
        mean is not None and told is not None and math.isclose(mean, told, rel_tol=1e-9, abs_tol=1e-12)
    )


CONTRADICTIONS = (_cases, _steps, _outcomes, _rates, _means)
"""Each says in which point a table of episodes contradicts its result or itself, or nothing."""
