"""The command that trains value networks."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from crowdbench.cli.options import INTERRUPTED, ScenarioOption, SetOption, ThreadsOption, use_threads
from crowdbench.errors import InputError

EPISODES = 4000

if TYPE_CHECKING:
    from crowdbench.train.value import Validated


def train(
    network: Annotated[str, typer.Argument(help="cadrl, lstm_rl or sarl.")],
    scenario: ScenarioOption = "circle_crossing_mixed",
    overrides: SetOption = None,
    predictor: Annotated[str, typer.Option(help="A name or ./mine.py: what foresees the pedestrians.")] = "oracle",
    seed: Annotated[int, typer.Option(min=0, help="Another seed, another network.")] = 0,
    episodes: Annotated[int | None, typer.Option(min=1, help="Episodes to learn from, 4000 unless told.")] = None,
    minutes: Annotated[float | None, typer.Option(min=0.1, help="Minutes of training, instead of episodes.")] = None,
    device: Annotated[str, typer.Option(help="cpu or cuda.")] = "cpu",
    threads: ThreadsOption = None,
    resume: Annotated[Path | None, typer.Option(help="Go on with the interrupted training in this directory.")] = None,
    out: Annotated[Path | None, typer.Option(help="runs/train-<network>-seed<seed> unless told.")] = None,
) -> None:
    """Train a value network: demonstrations by ORCA, imitation, then episodes of its own."""
    use_threads(threads)
    from crowdbench import catalog
    from crowdbench.console import announce_compilation, progress, say
    from crowdbench.train import session

    if episodes is not None and minutes is not None:
        raise InputError("--episodes and --minutes both say how long to train: give one of them")
    announce_compilation()
    if resume is not None:
        running = session.Session.resumed(resume, device)
    else:
        settings = catalog.assignments(overrides or [], "--set")
        asked = session.Request(network, scenario, settings, predictor, seed, episodes or EPISODES, minutes)
        running = session.Session.new(asked, out or Path("runs") / f"train-{network}-seed{seed}", device)
    try:
        with progress(100, "% of the training") as advance:
            shown = 0

            def tell(point: Validated, done: float) -> None:
                nonlocal shown
                say(_line(point))
                advance(int(100 * done) - shown)
                shown = int(100 * done)

            running.train(tell)
        with progress(sum(map(len, session.FIGURES.values())), "cases for the card") as advance:
            weights = running.finish(advance)
    except KeyboardInterrupt:
        kept = running.directory.exists()
        left = f"go on with crowdbench train {network} --resume {running.directory}" if kept else "nothing was kept yet"
        say(f"crowdbench: interrupted: {left}")
        sys.exit(INTERRUPTED)
    print(f"The weights are {weights}: crowdbench run --planner {network} --option weights={weights}")


def _line(point: Validated) -> str:
    return (
        f"{point.episodes:6d} episodes, {point.seconds:4.0f} s: on validation cases {100 * point.success:.1f} % "
        f"success in {point.navigation_time_or_limit:.2f} s (a failure counts as the time limit)"
    )
