"""Drive planners among several pedestrian policies in one scenario, and print their scores and orders."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

sys.path.append(str(Path(__file__).parents[2]))

from crowdbench.cli import ThreadsOption, WorkersOption, help_from_docstring, main, use_threads
from crowdbench.metrics import bootstrap_distribution, info_of, interval
from crowdbench.utils import Format, Grid, markdown, printed_by
from studies.command import Sharing, make_runs, print_study

if TYPE_CHECKING:
    from crowdbench import Episodes

PLANNERS = (
    "straight",
    "orca",
    "orca_margin",
    "social_force",
    "dwa",
    "cadrl",
    "sarl_cvm",
    "ppo",
    "ppo_attention",
    "mppi",
)
"""The planners unless others are named: ten of different families."""

CROWDS = ("orca", "orca_people")
SCORE = info_of("score")


@help_from_docstring
def planners(
    planner: Annotated[list[str] | None, typer.Argument(show_default=" ".join(PLANNERS))] = None,
    scenario: str = "circle_20",
    pedestrians: Annotated[list[str] | None, typer.Option(show_default=" ".join(CROWDS))] = None,
    cases: str = "val:100",
    out: Path = Path("runs/study-people"),
    workers: WorkersOption = None,
    threads: ThreadsOption = None,
    format: Format = Format.MARKDOWN,
) -> None:
    """Print the scores of planners among pedestrian policies, and how the first crowd differs from the others.

    Args:
        planner: Planners, by name or ./mine.py.
        scenario: A scenario of the suite.
        pedestrians: A pedestrian policy that replaces that of the scenario. Repeat it for several.
        cases: The cases.
        out: Folder for the runs.
    """
    use_threads(threads)
    from crowdbench import Cases
    from crowdbench.runs import RunSpec, load_run
    from studies.folder import read_episodes

    names, crowds = planner or list(PLANNERS), pedestrians or list(CROWDS)
    chosen = Cases.parse(cases)
    runs = {
        (name, crowd): load_run(RunSpec(name, scenario, chosen, pedestrians=crowd, record="none"))
        for name in names
        for crowd in crowds
    }
    make_runs(list(runs.values()), out, Sharing(None, workers, None, threads))
    episodes = {key: read_episodes(run, out) for key, run in runs.items()}
    grid = table(names, crowds, episodes)
    flags = [f"--cases {cases}", *(f"--pedestrians {shlex.quote(crowd)}" for crowd in pedestrians or [])]
    command = " ".join(["python studies/people/planners.py", *map(shlex.quote, planner or []), *flags])
    print_study(grid.records, [grid], f"{printed_by(command)}\n\n{markdown(grid.header, grid.rows)}", format)


def table(names: Sequence[str], crowds: Sequence[str], episodes: Mapping[tuple[str, str], Episodes]) -> Grid:
    """Return the table: fault, and the score after its rank, in each crowd, and differences of scores to the first one.

    The planner with the best score in the last crowd is first.
    """
    header, rows = ["planner"], [[name] for name in names]
    records: list[dict[str, Any]] = [{"planner": name} for name in names]
    first = [np.asarray(episodes[name, crowds[0]].columns["score"], float) for name in names]
    for crowd in crowds:
        header += [f"{crowd}: at fault", "score"]
        scores = [np.asarray(episodes[name, crowd].columns["score"], float) for name in names]
        order = np.argsort(np.argsort([-values.mean() for values in scores])) + 1
        if crowd != crowds[0]:
            header.append(f"minus {crowds[0]}")
        for number, (name, values) in enumerate(zip(names, scores, strict=True)):
            fault = 100.0 * np.mean(episodes[name, crowd].columns["at_fault_rate"])
            rows[number] += [f"{fault:.0f} %", f"{order[number]}: {with_interval(values)}"]
            records[number] |= {crowd: {"score": values.mean(), "rank": int(order[number])}}
            if crowd != crowds[0]:
                rows[number].append(with_interval(values - first[number], "+"))
    return Grid("Planners", header, [rows[number] for number in np.argsort(order)], records)


def with_interval(values: np.ndarray, sign: str = "-") -> str:
    """Return the mean with its 95 % bootstrap interval over cases."""
    low, high = interval(bootstrap_distribution(np.mean, values))
    mean, least, most = (format(number, f"{sign}.3f") for number in (values.mean(), low, high))
    return f"{mean} ({least} to {most})"


if __name__ == "__main__":
    main(planners)
