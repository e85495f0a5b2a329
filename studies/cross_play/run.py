"""Measure vehicles in crowds that they know and among strangers. Prints README.md beside this file."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

sys.path.append(str(Path(__file__).parents[2]))

from crowdbench.cli import ThreadsOption, help_from_docstring, main, use_threads
from crowdbench.utils import Format, markdown, printed_by
from studies.cross_play.train import SCENARIO, train_together, train_with_orca

if TYPE_CHECKING:
    from crowdbench import Cases
    from crowdbench.runs import Run
    from studies.cross_play.strangers import Crossed, Standing

HERE = Path(__file__).parent
WEIGHTS = HERE.parents[1] / "agents" / "pedestrians" / "learned"

LEARNED, WITH_ORCA = "learned-seed", "with_orca"
TOGETHER = {f"together-seed{seed}": f"{LEARNED}{seed}" for seed in range(3)}
"""The crowd that has the network of a vehicle, by vehicle."""

KNOWN: Mapping[str, tuple[str, ...]] = {
    "straight": (),
    "orca": ("orca",),
    "orca_margin": ("orca",),
    "social_force": ("social_force",),
    "dwa": (),
    "mppi": (),
    "mppi_interactive": (),
    "cadrl": ("orca",),
    "sarl_cvm": ("orca",),
    "ppo_attention": ("orca", "social_force"),
    WITH_ORCA: ("orca",),
    **{vehicle: (crowd,) for vehicle, crowd in TOGETHER.items()},
}
"""The crowds that each vehicle knows; all others are strangers."""

CROWDS = ("orca", "social_force", "power_law", "orca_people", "learned_people", *TOGETHER.values())
CASES = "val:200"
METRICS = "score", "at_fault_rate", "imposed_delay"

DESCRIPTION = (HERE / "description.txt").read_text("utf-8").strip()


@help_from_docstring
def cross_play(
    train: Annotated[float | None, typer.Option(min=0.0)] = None,
    cases: str = CASES,
    out: Path = Path("runs/study-cross_play"),
    threads: ThreadsOption = None,
    format: Format = Format.MARKDOWN,
) -> None:
    """Execute the missing runs of each vehicle in each crowd, and print the page of the study.

    Args:
        train: Train all networks first, for this many minutes of processor time each, and replace the shipped ones.
        cases: The cases of each run.
        out: Folder for the runs.
    """
    use_threads(threads)
    from crowdbench import Cases
    from crowdbench.results import RunResult, RunTable
    from crowdbench.runs import run_directory
    from studies.command import make_runs, print_study
    from studies.cross_play.strangers import standings, table

    if train is not None:
        train_all(train)
    drawn = Cases.parse(cases)
    runs = {(vehicle, crowd): load(vehicle, crowd, drawn) for vehicle in KNOWN for crowd in CROWDS}
    make_runs(list(runs.values()), out)
    found = {pair: RunResult.read(run_directory(run, out), tables_only=True) for pair, run in runs.items()}
    scores, delays = (
        {vehicle: {crowd: found[vehicle, crowd].episodes.columns[metric] for crowd in CROWDS} for vehicle in KNOWN}
        for metric in ("score", "imposed_delay")
    )
    ranked = standings(scores, delays, KNOWN)
    crossed = RunTable({crowd: {vehicle: found[vehicle, crowd] for vehicle in ranked} for crowd in CROWDS})
    grids = [table(ranked), *map(crossed.cross, METRICS)]
    command = f"python studies/cross_play/run.py{'' if cases == CASES else f' --cases {cases}'}"
    parts = [printed_by(command), "# Cross-play", summary(ranked, scores), DESCRIPTION]
    for grid in grids:
        parts += [f"## {grid.title.capitalize()}", markdown(grid.header, grid.rows), grid.note]
    print_study({"standings": ranked, "tables": grids}, grids, "\n\n".join(filter(None, parts)), format)


def summary(ranked: Mapping[str, Standing], scores: Crossed) -> str:
    """Return the result of the study in a few sentences.

    Args:
        ranked: The return value of `standings`.
        scores: The scores.
    """
    from studies.cross_play.strangers import DELAY, SCORE, self_play

    first, best = next(iter(ranked.items()))
    safest = max(ranked, key=lambda vehicle: ranked[vehicle].worst[0])
    worst, crowd = ranked[safest].worst
    learned = {name: SCORE.estimate(each) for name, each in self_play(scores, TOGETHER, KNOWN).items()}
    also = "It also" if safest == first else f"`{safest}`"
    delays = {vehicle: each.delay for vehicle, each in ranked.items() if not math.isnan(each.delay)}
    kind, rude = min(delays, key=lambda name: delays[name]), max(delays, key=lambda name: delays[name])
    foreign = [
        float(scores[vehicle][crowd].mean())
        for vehicle, own in TOGETHER.items()
        for crowd in TOGETHER.values()
        if crowd != own
    ]
    return (
        f"`{first}` is best among strangers, with a mean score of {SCORE.estimate(best.strangers)}. "
        f"{also} has the best score in its worst crowd of strangers: {SCORE.number(worst)}, in `{crowd}`. Strangers "
        f"lose {DELAY.amount(delays[kind])} of their time to `{kind}`, the least, and {DELAY.amount(delays[rude])} to "
        f"`{rude}`, the most.\n\n"
        f"A vehicle that learned together with its crowd scores {learned['own']} in this crowd, and "
        f"{learned['strangers']} among strangers: self-play overstates its score by {learned['excess']}. The excess is "
        f"{learned['familiarity']} larger than for vehicles that know no crowd. In crowds from another seed of the "
        f"same training it scores from {SCORE.interval(min(foreign), max(foreign))}."
    )


def load(vehicle: str, crowd: str, cases: Cases) -> Run:
    """Load the run of a vehicle in a crowd, both named as in `KNOWN` and `CROWDS`."""
    from crowdbench.runs import RunSpec, load_run

    file = HERE / f"{vehicle}.onnx"
    seed = {"pedestrians.learned.seed": int(crowd.removeprefix(LEARNED))} if crowd in TOGETHER.values() else {}
    policy, planner = "learned" if seed else crowd, str(file) if file.exists() else vehicle
    return load_run(RunSpec(planner, SCENARIO, cases, pedestrians=policy, overrides=seed, record="none"))


def train_all(minutes: float) -> None:
    """Train each vehicle together with its crowd, and a vehicle among ORCA pedestrians, for some minutes each."""
    for seed, (vehicle, crowd) in enumerate(TOGETHER.items()):
        train_together(seed, minutes, HERE / f"{vehicle}.onnx", WEIGHTS / f"{crowd}.safetensors")
    train_with_orca(minutes, HERE / f"{WITH_ORCA}.onnx")


if __name__ == "__main__":
    main(cross_play)
