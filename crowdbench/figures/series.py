"""What figures are drawn of: runs and trainings on disk, with their labels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from crowdbench.runs.results import result_label
from crowdbench.runs.store import RunResult
from crowdbench.utils import files
from crowdbench.utils.errors import InputError

CURVE, CARD = "curve.csv", "weights.json"


@dataclass(frozen=True)
class Labelled:
    """A run and what it is called in a figure."""

    label: str
    run: RunResult


def runs(directories: Sequence[Path]) -> list[Labelled]:
    """Read runs. Each is called by its planner, and by its scenario too where these differ.

    Args:
        directories: Their directories.

    Raises:
        InputError: One of them is not a run, or two of them have the same label.
    """
    kept = [RunResult.read(directory) for directory in directories]
    names = {run.result["scenario"]["name"] for run in kept}
    labels = [_label(run.result, with_scenario=len(names) > 1) for run in kept]
    for directory, label in zip(directories, labels, strict=True):
        if labels.count(label) > 1:
            raise InputError(f"{directory} and another run are both of {label}: a figure cannot tell them apart")
    return [Labelled(label, run) for label, run in zip(labels, kept, strict=True)]


def by_planner(directories: Sequence[Path]) -> dict[str, list[RunResult]]:
    """Read runs, those of the same planner together.

    Args:
        directories: Their directories.

    Raises:
        InputError: One of them is not a run.
    """
    found: dict[str, list[RunResult]] = {}
    for directory in directories:
        run = RunResult.read(directory)
        found.setdefault(_label(run.result, with_scenario=False), []).append(run)
    return found


def _label(result: Mapping[str, Any], *, with_scenario: bool) -> str:
    planner = result_label(result)
    return f"{planner}, {result['scenario']['name']}" if with_scenario else planner


def trainings(directories: Sequence[Path]) -> dict[str, list[Mapping[str, Float[np.ndarray, "validation"]]]]:
    """Read the curves of trainings, those of the same network in the same scenario together.

    Args:
        directories: Their directories.

    Returns:
        The columns of each curve by name, by network and scenario.

    Raises:
        InputError: One of them is not a training, or has no validation yet.
    """
    found: dict[str, list[Mapping[str, np.ndarray]]] = {}
    for directory in directories:
        try:
            head, *rows = (line.split(",") for line in files.read_text(directory / CURVE).splitlines())
            table = np.array(rows, float).reshape(len(rows), len(head))
        except (OSError, ValueError):
            raise InputError(f"{directory} is no directory of a training: it has no {CURVE} that can be read") from None
        if not rows:
            raise InputError(f"{directory / CURVE} has no validation yet")
        found.setdefault(_trained(directory), []).append(dict(zip(head, table.T, strict=True)))
    return found


def _trained(directory: Path) -> str:
    """The network and the scenario of a finished training; the directory's name of another one."""
    try:
        card = files.read_json(directory / CARD)
        return f"{card['network']}, {card['training']['scenario']['name']}"
    except (OSError, ValueError, KeyError, TypeError):
        return directory.name
