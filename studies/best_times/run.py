"""Replay the best known commands of validation cases, and print their scores beside the scores of planners."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

sys.path.append(str(Path(__file__).parents[2]))

from crowdbench.cli import ThreadsOption, WorkersOption, help_from_docstring, main, use_threads
from crowdbench.utils import Format, Grid, markdown, printed_by
from studies.command import EngineOption, Sharing, make_runs, print_study

if TYPE_CHECKING:
    from crowdbench import Scenario
    from crowdbench.runs import Run
    from studies.best_times.entries import BestTimes

PLANNERS = ("mppi", "mppi_interactive", "hybrid", "ppo_attention", "dwa", "orca_margin", "straight")

NOTE = (
    "Means over the cases; an unsolved case counts 0. J is time plus seconds close to pedestrians. A planner has "
    "its score with perfect and with realistic sensing on the same cases. Best known is not optimal."
)


@help_from_docstring
def best_times(
    scenario: Annotated[list[str] | None, typer.Argument(show_default="the ranked scenarios of the suite")] = None,
    planner: Annotated[list[str] | None, typer.Option(show_default=", ".join(PLANNERS))] = None,
    folder: Annotated[Path | None, typer.Option(show_default="studies/best_times/found")] = None,
    out: Path = Path("runs/study-best-times"),
    workers: WorkersOption = None,
    engine: EngineOption = None,
    threads: ThreadsOption = None,
    format: Format = Format.MARKDOWN,
) -> None:
    """Print the best known scores of validation cases beside planners, which replace entries where better.

    Args:
        scenario: Names of scenarios.
        planner: Planners to compare; `--planner none` for the best known commands alone.
        folder: Folder of the best known commands.
        out: Folder for the runs of the planners.
    """
    use_threads(threads)
    from crowdbench import load_scenario, read_suite
    from studies.best_times.entries import FOLDER, BestTimes, check_replays

    place = folder or FOLDER
    planners = [] if planner == ["none"] else planner or PLANNERS
    loaded = [load_scenario(name) for name in scenario or read_suite().ranked]
    best = {each.name: BestTimes.read(each, place) for each in loaded}
    best = {name: each for name, each in best.items() if each.entries}
    for each in loaded:
        if each.name in best:
            check_replays(each, best[each.name])
    runs = {name: _load_runs(each, planners) for name, each in best.items()}
    make_runs([run for each in runs.values() for run in each.values()], out, Sharing(None, workers, engine, threads))
    for each in loaded:
        if each.name in best:
            _replace(each, best[each.name], runs[each.name].values(), out, place)
    grid = _table(best, runs, planners, out)
    given = "".join(f" --planner {name}" for name in planner or [])
    page = [printed_by(f"python studies/best_times/run.py{given}"), markdown(grid.header, grid.rows), NOTE]
    print_study(grid.records, [grid], "\n\n".join(page), format)


def _load_runs(best: BestTimes, planners: Sequence[str]) -> dict[tuple[str, str], Run]:
    """Return the runs of planners in the cases of a file, by planner and track of sensing."""
    from crowdbench import Cases
    from crowdbench.core import SENSING_TRACKS
    from crowdbench.runs import RunSpec, load_run

    cases = Cases("val", best.entries[0].case, best.entries[-1].case + 1)
    return {
        (name, track): load_run(
            RunSpec(name, best.scenario, cases, overrides={"sensor.track": track}, record="commands")
        )
        for name in planners
        for track in SENSING_TRACKS
    }


def _replace(scenario: Scenario, best: BestTimes, runs: Iterable[Run], out: Path, folder: Path) -> None:
    """Replace entries by the commands of planners that are better, and write the file if there are any."""
    from crowdbench.results import COMMANDS, read_commands
    from crowdbench.runs import run_directory
    from studies.best_times.entries import replace_by_planner
    from studies.folder import read_episodes

    date, replaced = datetime.now(UTC).date().isoformat(), 0
    for run in runs:
        episodes, commands = read_episodes(run, out), read_commands(run_directory(run, out) / COMMANDS)
        for case, score in zip(episodes.case.tolist(), episodes.columns["score"], strict=True):
            replaced += replace_by_planner(scenario, best, case, float(score), commands.of(case), run.label, date)
    if replaced:
        best.write(folder)


def _table(
    best: Mapping[str, BestTimes],
    runs: Mapping[str, Mapping[tuple[str, str], Run]],
    planners: Sequence[str],
    out: Path,
) -> Grid:
    """Return the table: a row for each scenario."""
    from crowdbench.core import SENSING_TRACKS
    from studies.folder import read_episodes

    header = ["scenario", "cases", "solved", "J [s]", "best known", *planners, "holders", "date"]
    rows, records = [], []
    for name, each in best.items():
        entries, solved = each.entries, [entry for entry in each.entries if entry.holder]
        cost = float(np.mean([entry.time + entry.close for entry in solved])) if solved else np.nan
        known = float(np.mean([entry.score for entry in entries]))
        index = [entry.case - entries[0].case for entry in entries]
        scores = {
            place: float(np.mean(read_episodes(run, out).columns["score"][index])) for place, run in runs[name].items()
        }
        holders = Counter(entry.holder for entry in solved)
        said = ", ".join(f"{holder} {number}" for holder, number in holders.most_common())
        of_planners = [" / ".join(f"{scores[planner, track]:.3f}" for track in SENSING_TRACKS) for planner in planners]
        cells = [str(len(entries)), str(len(solved)), f"{cost:.2f}", f"{known:.3f}", *of_planners]
        rows.append([name, *cells, said, max(entry.date for entry in entries)])
        by_planner = {planner: {track: scores[planner, track] for track in SENSING_TRACKS} for planner in planners}
        records.append({"scenario": name, "cases": len(entries), "solved": len(solved), "cost": cost, "best": known})
        records[-1] |= {"planners": by_planner, "holders": dict(holders)}
    return Grid("Best known", header, rows, records, "l" + "r" * (len(header) - 3) + "ll")


if __name__ == "__main__":
    main(best_times)
