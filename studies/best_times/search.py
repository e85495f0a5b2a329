"""Search for the best commands of validation cases, with knowledge of the pedestrians' future."""

from __future__ import annotations

import sys
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

sys.path.append(str(Path(__file__).parents[2]))

from crowdbench.cli import (
    ThreadsOption,
    announce_compilation,
    exit_on_interrupt,
    help_from_docstring,
    main,
    use_threads,
)

if TYPE_CHECKING:
    from crowdbench import Scenario

HOLDER = "search"


@help_from_docstring
def search(
    scenario: Annotated[list[str] | None, typer.Argument(show_default="the ranked scenarios of the suite")] = None,
    cases: str = "val:50",
    seconds: float = 10.0,
    again: int = 0,
    out: Annotated[Path | None, typer.Option(show_default="studies/best_times/found")] = None,
    threads: ThreadsOption = None,
) -> None:
    """Search for commands with the best score, and keep them where they are better than the known ones.

    Cases that have commands are left out, so that the same command continues after an interrupt.

    Args:
        scenario: Names of scenarios.
        cases: Validation cases, such as val:50 or val:20:50.
        seconds: Processor time for each case; longer only until first commands are found.
        again: Above 0, cases that have commands are searched again, with this random seed.
        out: Folder of the files.
    """
    use_threads(threads)
    from crowdbench import Cases, InputError, load_scenario, read_suite
    from studies.best_times.entries import FOLDER

    searched = Cases.parse(cases)
    if searched.split != "val":
        raise InputError(f"cases {cases} are not validation cases: commands of other cases are not published")
    announce_compilation()
    with exit_on_interrupt("the same command goes on with the cases that are left"):
        for name in scenario or read_suite().ranked:
            loaded = load_scenario(name)
            for case in searched.indices.tolist():
                _search(loaded, case, seconds, again, out or FOLDER)


def _search(scenario: Scenario, case: int, seconds: float, again: int, folder: Path) -> None:
    """Search one case, unless it has commands, and print the result; see `search` for the arguments."""
    from studies.best_times.beam import search_case
    from studies.best_times.entries import BestTimes, Entry, replay

    before = BestTimes.read(scenario, folder).of(case)
    if before is not None and before.commands and not again:
        return
    start, date = time.process_time(), datetime.now(UTC).date().isoformat()
    found = search_case(scenario, case, seconds, again)
    entry = Entry(case=case, date=date)
    if len(found.commands):
        entry = replay(scenario, case, found.commands, HOLDER, date)
    best = BestTimes.read(scenario, folder)
    is_kept = best.put(entry)
    if is_kept:
        folder.mkdir(parents=True, exist_ok=True)
        best.write(folder)
    result = f"score {entry.score:.3f}, {entry.time:g} s + {entry.close:.2f} s close" if entry.holder else "unsolved"
    known = "" if is_kept else ", not better than the known commands"
    print(f"{scenario.name} val/{case}: {result}{known} ({time.process_time() - start:.0f} s)", flush=True)


if __name__ == "__main__":
    main(search)
