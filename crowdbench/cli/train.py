"""The command that trains networks: value networks, and Social GAN."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from crowdbench.cli.options import INTERRUPTED, SetOption, ThreadsOption, use_threads
from crowdbench.errors import InputError

EPISODES = 4000
EPOCHS = 50
SCENARIO = "circle_crossing_mixed"
SGAN_ONLY = ("data", "held_out", "dt", "pooling", "epochs")
VALUE_ONLY = ("predictor", "episodes")

if TYPE_CHECKING:
    from crowdbench.train.sgan_request import SganRequest
    from crowdbench.train.value_request import ValueRequest


def train(
    network: Annotated[str, typer.Argument(help="cadrl, lstm_rl, sarl or sgan.")],
    scenario: Annotated[str | None, typer.Option(help=f"A name or ./mine.toml; {SCENARIO} if not given.")] = None,
    overrides: SetOption = None,
    predictor: Annotated[
        str | None, typer.Option(help="What foresees the pedestrians: a name or ./mine.py; oracle if not given.")
    ] = None,
    data: Annotated[
        Path | None, typer.Option(help="For sgan: a folder of recorded tracks, instead of a scenario's crowds.")
    ] = None,
    held_out: Annotated[str | None, typer.Option(help="For sgan: the scene of the data to leave out.")] = None,
    dt: Annotated[
        float | None, typer.Option(min=0.01, help="For sgan: seconds a step to resample the data to; 0.4 as recorded.")
    ] = None,
    pooling: Annotated[bool, typer.Option("--pooling", help="For sgan: let pedestrians see each other.")] = False,
    seed: Annotated[int, typer.Option(min=0, help="Another seed, another network.")] = 0,
    episodes: Annotated[
        int | None, typer.Option(min=1, help=f"Episodes to learn from, {EPISODES} unless told.")
    ] = None,
    epochs: Annotated[
        int | None, typer.Option(min=1, help=f"For sgan: times through the data, {EPOCHS} unless told.")
    ] = None,
    minutes: Annotated[float | None, typer.Option(min=0.1, help="Minutes of training, instead.")] = None,
    device: Annotated[str, typer.Option(help="cpu or cuda.")] = "cpu",
    threads: ThreadsOption = None,
    resume: Annotated[Path | None, typer.Option(help="Go on with the interrupted training in this directory.")] = None,
    out: Annotated[Path | None, typer.Option(help="runs/train-<network>-seed<seed> unless told.")] = None,
) -> None:
    """Train a network: a value network on demonstrations and its own episodes, or Social GAN on tracks.

    A value network is validated with constant-velocity lookahead, whatever it is trained with.
    """
    use_threads(threads)
    from crowdbench.cli.console import announce_compilation
    from crowdbench.train import session

    given = {"data": data, "held_out": held_out, "dt": dt, "pooling": pooling or None, "epochs": epochs}
    given |= {"predictor": predictor, "episodes": episodes}
    _refuse(network, given, VALUE_ONLY if network == "sgan" else SGAN_ONLY)
    if minutes is not None and (episodes or epochs):
        raise InputError(f"--minutes and --{'episodes' if episodes else 'epochs'} both say how long to train: give one")
    if data is not None and (scenario or overrides):
        raise InputError("--data and --scenario both say what to learn from: give one of them")
    announce_compilation()
    if resume is not None:
        running = session.Session.resumed(resume, device)
    else:
        asked = _request(network, given, scenario or SCENARIO, overrides or [], seed, minutes)
        running = session.Session.new(asked, out or Path("runs") / f"train-{network}-seed{seed}", device)
    _run(running, network)


def _refuse(network: str, given: dict[str, Any], foreign: tuple[str, ...]) -> None:
    for name in foreign:
        if given[name] is not None:
            raise InputError(f"--{name.replace('_', '-')} is not for {network}")


def _request(
    network: str, given: dict[str, Any], scenario: str, overrides: list[str], seed: int, minutes: float | None
) -> ValueRequest | SganRequest:
    from crowdbench import catalog
    from crowdbench.predict.tracks import DT
    from crowdbench.train.sgan_request import SganRequest
    from crowdbench.train.value_request import ValueRequest

    settings = catalog.assignments(overrides, "--set")
    if network != "sgan":
        predictor, episodes = given["predictor"] or "oracle", given["episodes"] or EPISODES
        return ValueRequest(network, scenario, settings, predictor, seed, episodes, minutes)
    if given["data"] is None and (given["held_out"] is not None or given["dt"] is not None):
        raise InputError("--held-out and --dt are for recorded tracks: give them with --data")
    data = None if given["data"] is None else str(given["data"])
    return SganRequest(
        network=network,
        data=data,
        held_out=given["held_out"],
        dt=given["dt"] or DT,
        scenario=scenario,
        overrides=settings,
        pooling=bool(given["pooling"]),
        seed=seed,
        epochs=given["epochs"] or EPOCHS,
        minutes=minutes,
    )


def _run(running: Any, network: str) -> None:
    from crowdbench.cli.console import progress, say

    try:
        with progress(100, "% of the training") as advance:
            shown = 0

            def tell(point: Any, done: float) -> None:
                nonlocal shown
                say(str(point))
                advance(int(100 * done) - shown)
                shown = int(100 * done)

            running.train(tell)
        with progress(running.request.measured, "cases for the card") as advance:
            weights = running.finish(advance)
    except KeyboardInterrupt:
        kept = running.directory.exists()
        left = f"go on with crowdbench train {network} --resume {running.directory}" if kept else "nothing was kept yet"
        say(f"crowdbench: interrupted: {left}")
        sys.exit(INTERRUPTED)
    use = f"evaluate-predictor {network}" if network == "sgan" else f"run --planner {network}"
    print(f"The weights are {weights}: crowdbench {use} --option weights={weights}")
