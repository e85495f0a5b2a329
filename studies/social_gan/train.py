"""Train Social GAN, as in README.md beside this file."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

sys.path.append(str(Path(__file__).parents[2]))

from crowdbench import InputError
from crowdbench.cli import ThreadsOption, help_from_docstring, main, run_training, use_threads, with_method_options
from crowdbench.train import MOST_SEED, SCENARIO
from studies.social_gan.config import METHODS


@help_from_docstring
def train(
    scenario: Annotated[str | None, typer.Option(show_default=SCENARIO)] = None,
    overrides: list[str] | None = None,
    data: Path | None = None,
    seed: Annotated[int | None, typer.Option(min=0, max=MOST_SEED, show_default="0")] = None,
    minutes: Annotated[float | None, typer.Option(min=0.1)] = None,
    device: str = "cpu",
    threads: ThreadsOption = None,
    resume: Path | None = None,
    out: Annotated[Path | None, typer.Option(show_default="runs/train-sgan-seed<seed>")] = None,
    **method: Any,
) -> None:
    """Train Social GAN on recorded tracks, or on the simulated pedestrians of a scenario.

    The checkpoint with the smallest ADE on validation windows is kept.

    Args:
        scenario: Name of the scenario to train in, or a file: ./mine.toml.
        data: Folder with recorded tracks to train on, instead of a scenario's pedestrians.
        seed: Seed of the weights and of everything random in training.
        minutes: Train for this many minutes, validations included, instead of --epochs.
        device: cpu or cuda.
        resume: Continue the interrupted training in this directory, with the options and the number of threads that it
            was started with; only --device and --threads can be different.
        out: Directory for the results.
    """
    use_threads(threads)
    common = {"scenario": scenario, "overrides": overrides, "data": data, "seed": seed, "minutes": minutes}
    check_options(common | method)
    run_training("sgan", common | method, device, threads, resume, out, METHODS)


def check_options(options: Mapping[str, Any]) -> None:
    """Raise InputError if the given options, by name, contradict each other; None means that one is not given."""
    given = {name for name, value in options.items() if value is not None}
    if "data" in given and given & {"scenario", "overrides"}:
        raise InputError(
            "sgan learns from the tracks in --data themselves: leave out --scenario and --set, or else --data"
        )
    if "data" not in given and given & {"held_out", "dt"}:
        raise InputError("--held-out and --dt are for recorded tracks: give them with --data")


# Typer reads the options from the signature.
train.__signature__ = with_method_options(inspect.signature(train), METHODS)  # type: ignore[attr-defined]


if __name__ == "__main__":
    main(train)
