"""Train Social GAN, as in README.md beside this file."""

from __future__ import annotations

import inspect
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

sys.path.append(str(Path(__file__).parents[2]))

from crowdbench.cli import ThreadsOption, help_from_docstring, main, run_training, with_method_options
from studies.social_gan.config import METHODS


@help_from_docstring
def train(
    device: str = "cpu",
    threads: ThreadsOption = None,
    resume: Path | None = None,
    out: Annotated[Path | None, typer.Option(show_default="runs/train-sgan-seed<seed>")] = None,
    **options: Any,
) -> None:
    """Train Social GAN on recorded tracks, or on the simulated pedestrians of a scenario.

    The checkpoint with the smallest ADE on validation windows is kept.

    Args:
        device: cpu or cuda.
        resume: Continue the interrupted training in this directory, with the options and the number of threads that it
            was started with; only --device and --threads can be different.
        out: Directory for the results.
    """
    run_training("sgan", options, device, threads, resume, out, METHODS)


# Typer reads the options from the signature.
train.__signature__ = with_method_options(inspect.signature(train), METHODS)  # type: ignore[attr-defined]


if __name__ == "__main__":
    main(train)
