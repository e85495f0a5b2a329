"""The command that measures how crowds of a pedestrian policy behave."""

from __future__ import annotations

from typing import Annotated

import typer

from crowdbench.cli.options import ThreadsOption, use_threads

SHIPPED = ("orca", "social_force")
"""The pedestrian policies that are measured unless others are named."""


def validity(
    policies: Annotated[
        list[str] | None,
        typer.Argument(help="Pedestrian policies, by name or ./mine.py.", show_default=" ".join(SHIPPED)),
    ] = None,
    threads: ThreadsOption = None,
) -> None:
    """Measure speed against density, lanes and flow through a door beside published figures, and print a page of them.

    Takes about two minutes, and prints Markdown: docs/validity.md.
    """
    use_threads(threads)
    from crowdbench.catalog import load_policy
    from crowdbench.cli.console import announce_compilation, progress
    from crowdbench.study.validity.measure import measured, settings
    from crowdbench.study.validity.page import page

    asked = policies or list(SHIPPED)
    for policy in asked:
        load_policy(policy)  # before minutes of work with another one
    announce_compilation()
    wanted = list(settings(asked))
    found = {}
    with progress(len(wanted), f"of {len(wanted)} measurements") as tell:
        for setting in wanted:
            found[setting] = measured(setting)
            tell(1)
    print(page(found))
