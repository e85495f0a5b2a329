"""Find the cases of a scenario in which the vehicle can succeed."""

from __future__ import annotations

import sys
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

sys.path.append(str(Path(__file__).parents[2]))

from crowdbench.cli import (
    ThreadsOption,
    WorkersOption,
    announce_compilation,
    assignments,
    exit_on_interrupt,
    help_from_docstring,
    main,
    progress,
    use_threads,
)
from studies.command import EngineOption

if TYPE_CHECKING:
    from crowdbench import Cases, Scenario
    from studies.certificates.certificate import Certificate


@help_from_docstring
def certify(
    scenario: str,
    cases: str = "test:500",
    margin: float = 0.1,
    overrides: list[str] | None = None,
    data: Path | None = None,
    out: Annotated[Path | None, typer.Option(show_default="runs/certified-SCENARIO")] = None,
    overwrite: bool = False,
    workers: WorkersOption = None,
    engine: EngineOption = None,
    threads: ThreadsOption = None,
) -> None:
    """Find commands by which the vehicle succeeds in the cases of a scenario, given the pedestrians' future.

    They are stored as a run, which `crowdbench score DIR` simulates again.

    Args:
        scenario: Name of a scenario, or a file of your own: ./mine.toml.
        cases: test:500 (the first 500 test cases), val:100, test/37 (one case).
        margin: Smallest gap in metres to pedestrians and obstacles in the first attempt; in the second one it is 0.
        out: Directory for the certificates.
        overwrite: Replace earlier certificates.
    """
    use_threads(threads)
    from crowdbench import Cases, load_scenario, scenario_path
    from crowdbench.scenario import CERTIFICATES
    from crowdbench.utils import command, open_executor
    from studies.certificates.certificate import make

    examined, changes = Cases.parse(cases), assignments(overrides or [], "--set")
    loaded = load_scenario(scenario, changes, data=data)
    loaded.check_data(data)
    directory = out or Path("runs") / f"certified-{loaded.name}"
    announce_compilation()
    start = time.monotonic()
    with (
        exit_on_interrupt(),
        open_executor(engine, workers, threads) as executor,
        progress(len(examined)) as tell,
    ):
        rows = make(
            loaded,
            examined,
            margin,
            directory,
            overrides=changes,
            overwrite=overwrite,
            executor=executor,
            progress=tell,
        )
    seconds = time.monotonic() - start
    print("\n".join(_report(loaded, examined, margin, rows, seconds)))
    run = directory / examined.split
    given = [] if data is None else ["--data", data]
    print(f"\nKept in {run}; `{command('score', run, *given)}` checks it.")
    if examined.start == 0:
        folder = scenario_path(scenario).parent
        listed, place = directory / f"{loaded.name}.toml", folder / CERTIFICATES / f"{loaded.name}.toml"
        print(f"{listed} lists the cases without certificate: copy it to {place}, and runs print their share.")


def _report(scenario: Scenario, cases: Cases, margin: float, rows: Sequence[Certificate], seconds: float) -> list[str]:
    """Return the report on the certificates, line by line."""
    total = len(rows)
    by = Counter(row.means for row in rows if row.means)
    lines = [f"{scenario.name}, cases {cases}: {seconds:.0f} s", ""]
    for least in dict.fromkeys([margin, 0.0]):
        number = sum(row.margin >= least for row in rows)
        lines.append(f"certified with gaps of at least {least:g} m: {number} of {total} ({number / total:.1%})")
    lines.append("by " + (", ".join(f"{means}: {number}" for means, number in by.most_common()) or "nothing"))
    without = [row for row in rows if not row.means]
    for exhausted, what in ((False, "no certificate found"), (True, "no certificate exists on the grid of the search")):
        those = [f"{cases.split}/{row.case}" for row in without if row.is_exhausted == exhausted]
        if those:
            lines.append(f"{what}: {', '.join(those)}")
    return lines


if __name__ == "__main__":
    main(certify)
