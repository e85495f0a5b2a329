"""The certificates of a scenario, made part by part: a run like any other, and the list of the cases without one."""

from __future__ import annotations

import csv
import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from crowdbench import files
from crowdbench.certify.certificate import Certificate, certificates
from crowdbench.errors import InputError
from crowdbench.evaluate import parts
from crowdbench.evaluate.directory import held
from crowdbench.evaluate.driver import Driver
from crowdbench.evaluate.metrics import METRICS
from crowdbench.evaluate.parts import Parts
from crowdbench.evaluate.playback import Playback
from crowdbench.evaluate.wanted import Wanted, fitting
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.certified import LARGEST, Certified, Examined
from crowdbench.scenario.scenario import Scenario

NAME = "certificate"
"""The name of the planner in a run of certificates."""

PART = 25
"""Cases of a part: what an interrupt loses is no more than one."""

_COLUMNS = ("case", "means", "margin", "gap", "seconds", "exhausted")


@dataclass(frozen=True)
class Row:
    """What was found for a case, without the commands.

    Attributes:
        case: Its number.
        means: What gave the commands, the name of a planner or `search`; empty where none were found.
        margin: The margin that was asked for in metres, not a number where none were found.
        gap: The smallest gap to pedestrians and obstacles in metres, likewise.
        seconds: The time to the goal, likewise.
        exhausted: Whether the whole grid of a search was looked through, and none were found.
    """

    case: int
    means: str
    margin: float
    gap: float
    seconds: float
    exhausted: bool

    @classmethod
    def of(cls, certificate: Certificate, dt: float) -> Row:
        """The row of a certificate; `dt` is the length of a step in seconds."""
        seconds = dt * len(certificate.commands) if certificate.means else math.nan
        found = certificate.case, certificate.means, certificate.margin, certificate.gap
        return cls(*found, seconds, certificate.is_exhausted)

    @classmethod
    def read(cls, texts: Mapping[str, str]) -> Row:
        """A row of the file that `make` writes."""
        margin, gap, seconds = (float(texts[name] or "nan") for name in ("margin", "gap", "seconds"))
        return cls(int(texts["case"]), texts["means"], margin, gap, seconds, texts["exhausted"] == "yes")

    def texts(self) -> list[str]:
        """The row as that file has it."""
        numbers = ("" if math.isnan(each) else repr(each) for each in (self.margin, self.gap, self.seconds))
        return [str(self.case), self.means, *numbers, "yes" if self.exhausted else "no"]


def make(
    scenario: Scenario,
    cases: Cases,
    margin: float,
    out: Path,
    *,
    overrides: Mapping[str, Any],
    overwrite: bool = False,
    progress: Callable[[float], None],
) -> list[Row]:
    """Make certificates, going on from those that are there.

    In `out` they are a run, in a directory named after the split. Beside it, a table `SPLIT.csv` tells what each one
    is from, and `NAME.toml` which cases have none, if the first ones are among the cases.

    Args:
        scenario: The scenario, with all its cases.
        cases: The cases.
        margin: The wider of the margins that are tried, in metres; the other one is 0.
        out: The directory to write.
        overrides: What is changed in the scenario, for `result.json`.
        overwrite: Whether earlier certificates of this split are replaced.
        progress: Called with the number of cases that are done.

    Returns:
        What was found for each case.

    Raises:
        InputError: The margin cannot be, the scenario breaks its contract, or the directory cannot be written.
        KeyboardInterrupt: Interrupted. The parts that are finished are kept.
    """
    if not 0.0 <= margin < LARGEST:
        raise InputError(f"a margin of {margin:g} m is not possible: give 0 m or more, and less than {LARGEST:g} m")
    margins = list(dict.fromkeys([margin, 0.0]))
    directory, table = out / cases.split, out / f"{cases.split}.csv"
    about = {"options": {}, "planner_files": {}, "overrides": overrides}
    asked = {"planner": NAME, "scenario": scenario.name, "margins": margins}
    driver = Driver(Playback(np.empty((0, 0, 2)), privileged=True), NAME)
    wanted = Wanted(driver, scenario, cases, METRICS, about, asked, batch=fitting(PART, scenario))
    of_run = Parts.of(cases, directory, wanted.depends, wanted.batch)

    def drive(part: Cases, folder: Path) -> None:
        found = certificates(scenario, part, margins, progress)
        _write([Row.of(each, scenario.rules.dt) for each in found], of_run.folder / f"{part.start}.csv")
        with held(of_run.folder / ".table"):
            _write(_rows(sorted(of_run.folder.glob("*.csv"))), table)
        commands = np.zeros((len(part), scenario.rules.max_steps, 2))
        for own, each in zip(commands, found, strict=True):
            own[: len(each.commands)] = each.commands
        played = Driver(Playback(commands, privileged=True), NAME)
        dataclasses.replace(wanted, driver=played).drive(part, folder)

    parts.make(drive, of_run, overwrite=overwrite, progress=progress)
    rows = _rows([table])
    if cases.start == 0:
        _list_without(scenario, cases.split, margin, rows, out / f"{scenario.name}.toml")
    return rows


def _write(rows: Sequence[Row], path: Path) -> None:
    with files.whole(path) as partial, partial.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows([_COLUMNS, *(row.texts() for row in rows)])


def _rows(paths: Sequence[Path]) -> list[Row]:
    """The rows of some tables by number. Raises InputError where one of them was changed."""
    rows = []
    for path in paths:
        with path.open(newline="", encoding="utf-8") as file:
            try:
                rows += [Row.read(texts) for texts in csv.DictReader(file)]
            except (KeyError, TypeError, ValueError):
                raise InputError(f"{path} is not a table of certificates as crowdbench writes it") from None
    return sorted(rows, key=lambda row: row.case)


def _list_without(scenario: Scenario, split: str, margin: float, rows: Sequence[Row], path: Path) -> None:
    """Write which cases of a split have no certificate beside what the file says of other splits.

    Args:
        scenario: The scenario.
        split: The split.
        margin: The wider margin in metres.
        rows: What was found for each case, from the first one.
        path: The file; one for another digest or another margin is replaced.
    """
    before = Certified.read(path)
    fits = before is not None and (before.scenario, before.margin) == (scenario.digest, margin)
    left_out = [row.case for row in rows if not row.means]
    narrow = [row.case for row in rows if row.margin < margin]
    found = {split: Examined(examined=len(rows), left_out=left_out, narrow=narrow)}
    others = before.splits if before is not None and fits else {}
    with files.whole(path) as partial:
        text = Certified(scenario=scenario.digest, margin=margin, **{**others, **found}).text()
        partial.write_text(text, encoding="utf-8")
