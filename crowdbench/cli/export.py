"""The command that writes a run as other programs read it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from crowdbench.cli.console import announce_compilation, progress
from crowdbench.cli.options import help_from_docstring


@help_from_docstring
def export(
    run: Path,
    out: Annotated[Path, typer.Option()],
    pedestrians: list[str] | None = None,
    layout: str | None = None,
    data: Path | None = None,
    overwrite: bool = False,
) -> None:
    """Write the tracks of a run, and a table of what the vehicle saw, did and gained, for other programs.

    The cases are simulated again from the recorded commands, without the planner.

    Args:
        run: Directory of a run.
        out: Directory to write: `tracks/` has a file for each case, with a line `frame person x y` for each position
            in metres; the vehicle is person 0, and a frame is a step. `steps.parquet` has a row for each step, with the
            observation of the environments, the command, CrowdNav's reward, and whether the episode ends.
        pedestrians: The file of a pedestrian policy of your own that the run had, ./mine.py. Repeatable.
        layout: The file of a layout of your own that the run had, ./mine.py.
    """
    from crowdbench import catalog
    from crowdbench.runs.export import STEPS
    from crowdbench.runs.export import export as write
    from crowdbench.runs.result_file import RESULT
    from crowdbench.runs.store import RunResult
    from crowdbench.utils import files

    files.check_free(out, overwrite, STEPS)
    announce_compilation()
    found = RunResult.read(run)
    source = str(run / RESULT)
    scenario = catalog.load_recorded_scenario(found.result["scenario"], source, pedestrians or [], layout, data)
    scenario.check_data(data)
    with files.new_directory(out, overwrite, STEPS) as folder, progress(len(found.commands.case)) as tell:
        cases = write(found, scenario, folder, tell)
    print(f"{cases} cases in {out}")
