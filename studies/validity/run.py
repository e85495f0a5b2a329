"""Measure crowds of pedestrian policies beside published figures, and print the page: README.md beside this file."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import Annotated

import typer

sys.path.append(str(Path(__file__).parents[2]))

from crowdbench.cli import ThreadsOption, announce_compilation, help_from_docstring, main, progress, use_threads

SHIPPED = ("orca", "social_force")
"""The pedestrian policies whose crowds are measured unless others are named."""


@help_from_docstring
def validity(
    policies: Annotated[list[str] | None, typer.Argument(show_default=" ".join(SHIPPED))] = None,
    threads: ThreadsOption = None,
) -> None:
    """Measure speed against density, lanes and flow through a door beside published figures, and print a page of them.

    Takes about five minutes, and prints studies/validity/README.md.

    Args:
        policies: Pedestrian policies, by name or ./mine.py.
    """
    use_threads(threads)
    from crowdbench import PEDESTRIANS
    from studies.validity.experiments import run_experiment, settings
    from studies.validity.page import page

    chosen = policies or list(SHIPPED)
    for policy in chosen:
        PEDESTRIANS.load(policy)  # raises errors before minutes of simulation of another policy
    announce_compilation()
    experiments = list(settings(chosen))
    results = {}
    with progress(len(experiments), f"of {len(experiments)} measurements") as tell:
        for setting in experiments:
            results[setting] = run_experiment(setting)
            tell(1)
    print(page(results, shlex.join(["python", "studies/validity/run.py", *(policies or [])])))


if __name__ == "__main__":
    main(validity)
