"""Pictures of the docs that show numbers: success over time, scores on a dial, and with increasing knowledge."""

import itertools
import json
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace

import numpy as np

sys.path.append(str(Path(__file__).parents[1]))

from tables import split_row

import crowdbench
from crowdbench.api import rollout
from crowdbench.figures import plots
from crowdbench.figures.plots import learning_curves, success_over_time
from crowdbench.metrics.registry import METRICS
from crowdbench.scenario.cases import Cases
from studies.dials import plot as dial_figure
from studies.dials.dial import load_dial
from studies.dials.estimate import fit
from studies.dials.table import DialRow, FilledDial, Measurement
from studies.ladder import plot as ladder_figure
from studies.pages import keep

CURVES = Path(__file__).parent / "curves"
"""A folder per seed, with a folder per network, as a training leaves it."""

CROSS = Path(__file__).parents[1] / "studies" / "fleets" / "cross.md"

LADDERS = Path(__file__).parents[1] / "studies" / "ladder" / "README.md"


def draw_success(out: Path) -> None:
    """Draw the share of validation cases that each of four planners solves, over time."""
    with tempfile.TemporaryDirectory() as folder:
        runs = [Path(folder) / planner for planner in ("ppo", "sarl_cvm", "orca_margin", "orca")]
        for run in runs:
            crowdbench.run(run.name, "circle_crossing_5", "val:100", out=run, record="none", progress=lambda _: None)
        success_over_time(runs, out)


def draw_curves(out: Path) -> None:
    """Draw the learning curves of networks that ship."""
    learning_curves(sorted(CURVES.glob("*/*"), key=lambda folder: (folder.name, folder)), out)


def draw_matrix(out: Path) -> None:
    """Draw the scores of planners among vehicles of other planners, from the page of the study."""
    lines = [split_row(line) for line in CROSS.read_text().splitlines() if line.startswith("|")]
    columns = [name.removesuffix(".py") for name in lines[0]]
    records = [
        {"planner": planner.removesuffix(".py")}
        | {
            column: SimpleNamespace(mean=float(cell.split()[0]))
            for column, cell in zip(columns[1:], cells, strict=True)
        }
        for planner, *cells in lines[2:]
    ]
    plots.draw_matrix(records, out)


def draw_dial(out: Path) -> None:
    """Draw the scores of four fast planners on the dial of density, in validation cases."""
    dial, cases = load_dial("density"), Cases("val", 0, 20)
    with tempfile.TemporaryDirectory() as folder:
        files = [Path(folder) / planner for planner in ("dwa", "orca_margin", "social_force", "orca")]
        for file in files:
            runs = dial.runs(file.name, {}, cases, range(len(dial.levels)))
            traces = [rollout(run.driver.planner, run.scenario, cases, undisturbed=False) for run in runs]
            found = fit(np.stack([METRICS["score"](trace) for trace in traces]), {})
            keep(FilledDial(dial, [DialRow.of(Measurement(dial, runs), found, found)]), file)
        dial_figure.plot(files, out)


def draw_ladders(out: Path) -> None:
    """Draw the ladders of the study's page."""
    head, _, *rows = map(split_row, [line for line in LADDERS.read_text().splitlines() if line.startswith("| ")])
    titles, *columns = zip(*rows, strict=True)
    with tempfile.TemporaryDirectory() as folder:
        files = [Path(folder) / f"{scenario}.json" for scenario in head[1:]]
        for file, column in zip(files, columns, strict=True):
            file.write_text(json.dumps(read_ladder(file.stem, titles, column)))
        ladder_figure.plot(files, out)


def read_ladder(scenario: str, titles: Sequence[str], column: Sequence[str]) -> dict[str, object]:
    """Return a column of the study's page in the format of `studies/ladder/run.py`: rungs, with gains between them."""
    rungs = dict(zip(titles[:-1:2], column[:-1:2], strict=True))
    score = {name: {"mean": mean(cell), "n": cell.count("cases")} for name, cell in rungs.items() if cell != "-"}
    steps = [{"knowledge": title.removeprefix("+ ")} for title in itertools.islice(titles[1:-1:2], len(score) - 1)]
    return {"scenario": scenario, "score": score, "steps": steps, "best_score": {"mean": mean(column[-1])}}


def mean(cell: str) -> float:
    """Return the score at the beginning of a cell such as `0.820 (mppi)`."""
    return float(cell.split()[0])
