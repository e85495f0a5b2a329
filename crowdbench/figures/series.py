"""Trainings on disk, of which figures are drawn, with their labels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from crowdbench.utils import files
from crowdbench.utils.errors import InputError

CURVE, CARD = "curve.csv", "weights.json"


def trainings(
    directories: Sequence[Path], quantity: str
) -> dict[str, list[Mapping[str, Float[np.ndarray, "validation"]]]]:
    """Read the curves of trainings, those of the same network in the same scenario together.

    Args:
        directories: Their directories.
        quantity: A column that all of them must have.

    Returns:
        The columns of each curve by name, by network and scenario.

    Raises:
        InputError: One of them is not a training, has no validation yet, or has no such column.
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
        if quantity not in head:
            raise InputError(f"the training in {directory} has no {quantity}; it has {', '.join(head)}")
        found.setdefault(_trained(directory), []).append(dict(zip(head, table.T, strict=True)))
    return found


def _trained(directory: Path) -> str:
    """The network and the scenario of a finished training; the directory's name of another one."""
    try:
        card = files.read_json(directory / CARD)
        return f"{card['network']}, {card['training']['scenario']['name']}"
    except (OSError, ValueError, KeyError, TypeError):
        return directory.name
