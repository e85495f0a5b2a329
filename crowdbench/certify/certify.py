"""The certificates of a scenario, made part by part: a run like any other, and the list of the cases without one."""

from __future__ import annotations

import csv
import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from crowdbench.certify.certificate import Certificate, certificates
from crowdbench.metrics import METRICS
from crowdbench.planners.driver import Driver
from crowdbench.runs.replay import Playback
from crowdbench.runs.run import Run, fit_batch
from crowdbench.runs.shards import Parts, make_run
from crowdbench.runs.spec import RunSpec
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.certified import LARGEST, Certified, Examined
from crowdbench.scenario.scenario import Scenario
from crowdbench.utils import files
from crowdbench.utils.errors import InputError

NAME = "certificate"
"""The name of the planner in a run of certificates."""

PART = 25
"""Cases of a part: what an interrupt loses is no more than one."""

_COLUMNS = ("case", "means", "margin", "gap", "seconds", "exhausted")


def make(
    scenario: Scenario,
    cases: Cases,
    margin: float,
    out: Path,
    *,
    overrides: Mapping[str, Any],
    overwrite: bool = False,
    progress: Callable[[float], None],
) -> list[Certificate]:
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
    spec = RunSpec(NAME, scenario.name, cases, overrides=overrides, batch=fit_batch(PART, scenario))
    origin = {"planner": NAME, "scenario": scenario.name, "margins": margins}
    driver = Driver(Playback(np.empty((0, 0, 2)), privileged=True), NAME)
    run = Run(spec, driver, scenario, METRICS, origin, {"planner_files": {}})
    kept = Parts.of(run, directory).folder

    def drive(part: Cases, folder: Path) -> None:
        found = certificates(scenario, part, margins, progress)
        _write(found, kept / f"{part.start}.csv")
        with files.hold_lock(kept / ".table"):
            _write(_read(sorted(kept.glob("*.csv"))), table)
        commands = np.zeros((len(part), scenario.rules.max_steps, 2))
        for own, each in zip(commands, found, strict=True):
            own[: len(each.commands)] = each.commands
        played = Driver(Playback(commands, privileged=True), NAME)
        dataclasses.replace(run, driver=played).drive(part, folder)

    make_run(run, directory, drive=drive, overwrite=overwrite, progress=progress)
    rows = _read([table])
    if cases.start == 0:
        _list_without(scenario, cases.split, margin, rows, out / f"{scenario.name}.toml")
    return rows


def _write(found: Sequence[Certificate], path: Path) -> None:
    with files.whole(path) as partial, partial.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(_COLUMNS)
        for each in found:
            numbers = ("" if math.isnan(number) else repr(number) for number in (each.margin, each.gap, each.seconds))
            writer.writerow([each.case, each.means, *numbers, "yes" if each.is_exhausted else "no"])


def _read(paths: Sequence[Path]) -> list[Certificate]:
    """What some tables say, by the number of the case. Raises InputError where one of them was changed."""
    found = []
    for path in paths:
        with path.open(newline="", encoding="utf-8") as file:
            try:
                for row in csv.DictReader(file):
                    margin, gap, seconds = (float(row[name] or "nan") for name in ("margin", "gap", "seconds"))
                    is_exhausted = row["exhausted"] == "yes"
                    found.append(Certificate(int(row["case"]), row["means"], margin, gap, seconds, is_exhausted))
            except (KeyError, TypeError, ValueError):
                raise InputError(f"{path} is not a table of certificates as crowdbench writes it") from None
    return sorted(found, key=lambda each: each.case)


def _list_without(scenario: Scenario, split: str, margin: float, found: Sequence[Certificate], path: Path) -> None:
    """Write which cases of a split have no certificate beside what the file says of other splits.

    Args:
        scenario: The scenario.
        split: The split.
        margin: The wider margin in metres.
        found: What was found for each case, from the first one.
        path: The file; one for another digest or another margin is replaced.
    """
    before = Certified.read(path)
    is_same = before is not None and (before.scenario, before.margin) == (scenario.digest, margin)
    splits = before.splits if before is not None and is_same else {}
    left_out = [each.case for each in found if not each.means]
    narrow = [each.case for each in found if each.margin < margin]
    splits[split] = Examined(examined=len(found), left_out=left_out, narrow=narrow)
    with files.whole(path) as partial:
        partial.write_text(Certified(scenario=scenario.digest, margin=margin, **splits).text(), encoding="utf-8")
