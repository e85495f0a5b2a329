"""A dial: the file of a scenario with a table `[dial]`, which names the knob and its levels, from easy to hard."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, Field

from crowdbench import SCENARIOS, Cases, InputError
from crowdbench.runs import Run, RunSpec, load_run
from crowdbench.utils import Location, Name, TomlTable, find_named, parse_table, read_toml
from studies.ladder.rungs import RUNGS, load_rung

FOLDER = SCENARIOS / "dials"
"""The folder of the built-in dials."""

FIRST, SECOND = Cases("test", 0, 30), Cases("test", 30, 270)
"""The cases that are driven at all levels, and the cases that are driven only at the three around the figure."""


def _in_order(levels: list[float]) -> list[float]:
    steps = np.sign(np.diff(levels))
    if len(levels) < 3 or steps[0] == 0.0 or (steps != steps[0]).any():
        raise ValueError
    return levels


def _with_place(words: str) -> str:
    if words.count("{}") != 1 or words.count("{") + words.count("}") != 2:
        raise ValueError
    return words


class DialSpec(TomlTable):
    """`[dial]`."""

    key: Name
    levels: Annotated[list[int | float], AfterValidator(_in_order)] = Field(
        description="a list of three or more numbers that rise or fall, from easy to hard"
    )
    label: Annotated[Name, AfterValidator(_with_place)] = Field(
        description='a text with {} for the level, such as "{} pedestrians on a square of 12 m"'
    )


@dataclasses.dataclass(frozen=True)
class Dial:
    """A scenario with one knob.

    Attributes:
        name: Its name.
        file: The file of the scenario.
        description: Its description in the file.
        key: The knob, a dotted key of the scenario.
        levels: Its values, from easy to hard.
        label: Text for a level, with {} for its value.
    """

    name: str
    file: str
    description: str
    key: str
    levels: tuple[float, ...]
    label: str

    def level(self, number: float) -> float:
        """Interpolate the level at a number; levels are counted from 0. An infinite number is returned unchanged."""
        return float(np.interp(number, range(len(self.levels)), self.levels)) if math.isfinite(number) else number

    def say(self, level: float) -> str:
        """Return a level as text, with three digits; an infinite one is beyond the first or the last."""
        if math.isfinite(level):
            return f"{level:.3g}"
        end, rises = self.levels[0 if level < 0.0 else -1], self.levels[0] < self.levels[-1]
        return f"{'below' if rises == (level < 0.0) else 'above'} {end:g}"

    def runs(self, planner: str, options: Mapping[str, Any], cases: Cases, levels: Iterable[int]) -> list[Run]:
        """Return the runs of a planner, or of a rung of the ladder, at some levels.

        Args:
            planner: Its name or file, or the rung.
            options: Its options; a rung has none.
            cases: The cases.
            levels: The numbers of the levels, from 0.

        Raises:
            InputError: The scenario or the planner cannot be loaded.
        """
        if planner in RUNGS and options:
            raise InputError(f"{planner} is a rung of the ladder, which takes no options: give none")
        base = RunSpec(planner, self.file, cases, options=options, record="none")
        specs = [dataclasses.replace(base, overrides={self.key: self.levels[level]}) for level in levels]
        return [load_rung(planner, spec) if planner in RUNGS else load_run(spec) for spec in specs]


def load_dial(spec: str) -> Dial:
    """Load a dial.

    Args:
        spec: The name of a built-in dial, or `file.toml`.

    Raises:
        InputError: There is no such dial, or its table `[dial]` is missing or wrong.
    """
    path = Path(spec)
    if not spec.endswith(".toml"):
        path = find_named("dial", spec, {file.stem: file for file in _files()}, ", or give a file: ./mine.toml")
    table = read_toml(path, "dial")
    if not isinstance(table.get("dial"), dict):
        raise InputError(f"{path} has no table [dial]: a dial has one, with key, levels and label")
    found = parse_table(DialSpec, table["dial"], Location(path.name, "dial"))
    return Dial(path.stem, str(path), str(table.get("description", "")), found.key, tuple(found.levels), found.label)


def dials() -> list[tuple[str, str]]:
    """Return name and description of each built-in dial."""
    return [(path.stem, load_dial(str(path)).description) for path in _files()]


def _files() -> list[Path]:
    return sorted(FOLDER.glob("*.toml"))
