"""The command `view`, and functions that choose a case of runs and load their scenarios."""

from __future__ import annotations

import functools
import inspect
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from crowdbench.cli.console import BAD, GOOD, announce_compilation, write
from crowdbench.utils.errors import InputError

if TYPE_CHECKING:
    from crowdbench.results.run_result import RunResult
    from crowdbench.runs.replay import Loader
    from crowdbench.scenario.scenario import Scenario

NAMED = 10
"""How many cases of an outcome are named."""


def view(
    run: Path,
    case: str | None = None,
    worst: str | None = None,
    web: bool = False,
    pedestrians: list[str] | None = None,
    layout: str | None = None,
    data: Path | None = None,
) -> None:
    """Play a case of a run in the Rerun viewer: its first failure, or else its first case.

    A case that was not recorded is simulated again from its commands.

    Args:
        run: Directory of a run, or an .rrd file. Without --case, all cases of an .rrd file are shown.
        case: Show this case: val/37, or its number.
        worst: Show the case in which this metric, such as jerk, is worst.
        web: Open it in a browser.
        pedestrians: Your file of a pedestrian policy that the run used, ./mine.py. Repeatable.
        layout: Your file of a layout that the run used, ./mine.py.
    """
    from crowdbench.record import viewer
    from crowdbench.record.recorded_cases import find_case
    from crowdbench.results.episodes import EPISODES
    from crowdbench.results.run_result import RunResult
    from crowdbench.runs.replay import recording_of

    if not run.is_dir():
        if worst is not None:
            raise InputError(f"--worst needs the directory of a run, whose {EPISODES} has the metrics, not {run}")
        viewer.view(run, None if case is None else find_case(run, case), web=web)
        return
    result = RunResult.read(run, tables_only=True)
    number = choose_case([result], case, worst)
    announce_compilation()
    with tempfile.TemporaryDirectory() as folder:
        recording = recording_of(result, make_loader(pedestrians, layout, data), number, Path(folder))
        viewer.view(recording, number, web=web)


def choose_case(runs: Sequence[RunResult], case: str | None, worst: str | None) -> int:
    """Return the number of a case of the first run. Unless the user gave it, print it and the outcomes.

    Args:
        runs: The runs.
        case: The name or the number of the case; None for the first failure, or else the first case.
        worst: A metric, to choose the case in which it is worst.

    Raises:
        InputError: There is no such case or metric.
    """
    import numpy as np

    from crowdbench.core.types import Outcome
    from crowdbench.metrics.registry import info_of, no_metric

    if worst is not None and case is not None:
        raise InputError("--worst chooses the case: leave out --case or --worst")
    if case is not None:
        return runs[0].find_case(case)
    cases, episodes = runs[0].cases, runs[0].episodes
    if worst is None:
        solved = episodes.case[episodes.outcome == Outcome.SUCCESS].tolist()
        outcomes = episodes.failures | ({Outcome.SUCCESS.label: solved} if solved else {})
        for outcome, found in outcomes.items():
            write(describe_cases(outcome, found), GOOD if outcome == Outcome.SUCCESS.label else BAD)
        number = next(iter(outcomes.values()))[0]
    else:
        if worst not in episodes.columns:
            raise InputError(f"{runs[0].directory} {no_metric(worst, episodes.columns)}")
        values = -info_of(worst).sign * episodes.columns[worst].astype(float)
        values[~np.all([np.isin(episodes.case, run.episodes.case) for run in runs], axis=0)] = np.nan
        if np.isnan(values).all():
            raise InputError(f"{worst} is not defined in any case of {runs[0].directory}")
        number = int(episodes.case[np.nanargmax(values)])
    print(f"case {cases.split}/{number}")
    return number


def describe_cases(outcome: str, cases: Sequence[int]) -> str:
    """Return how many cases had an outcome, and the first of them, such as `2 collisions (cases 3, 8)`."""
    many = ("es" if outcome.endswith("s") else "s") * (len(cases) != 1)
    which = f"case{'s'[: len(cases) != 1]} {', '.join(map(str, cases[:NAMED]))}{', ...' * (len(cases) > NAMED)}"
    return f"{len(cases)} {outcome.replace('_', ' ')}{many} ({which})"


def replay_options(scenario: Scenario, data: Path | None) -> list[str]:
    """Return the options by which commands simulate the cases of a run again: the user's files and recorded tracks."""
    table = scenario.table
    files = table["pedestrians"].get("policy_files", {})
    plugins: list[tuple[str, Any]] = [("--pedestrians", type(scenario.policies[name])) for name in files]
    if scenario.layout is not None and table["layout"]["generator_file"] is not None:
        layout = scenario.layout.func
        # A `LayoutWithRespawn` has no file; its function `again` is the user's, its layout may be a built-in one.
        plugins.append(("--layout", getattr(layout, "again", layout)))
    words = [word for option, plugin in plugins for word in (option, inspect.getfile(plugin))]
    return words if data is None else [*words, "--data", str(data)]


def make_loader(pedestrians: Sequence[str] | None, layout: str | None, data: Path | None) -> Loader:
    """Return a function that loads the scenario of a stored run, with the files that the run had."""
    from crowdbench.runs.loading import load_stored_scenario

    return functools.partial(load_stored_scenario, pedestrians=pedestrians or (), layout=layout, data=data)
