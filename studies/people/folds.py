"""Score a fitted policy at each location with the parameters that were fitted without it."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

sys.path.append(str(Path(__file__).parents[2]))

from crowdbench import InputError
from crowdbench.cli import ThreadsOption, announce_compilation, help_from_docstring, main, use_threads
from crowdbench.utils import Format, markdown, printed_by
from studies.command import print_study
from studies.people.run import BASELINE, BLIND

if TYPE_CHECKING:
    from studies.people.windows import Window


@help_from_docstring
def folds(
    policy: str,
    data: Annotated[Path, typer.Option()],
    fits: Annotated[Path, typer.Option()],
    location: list[str] | None = None,
    threads: ThreadsOption = None,
    format: Format = Format.MARKDOWN,
) -> None:
    """Score a fitted policy, shipped `orca`, and a blind walker with the same population, at all locations together.

    Args:
        policy: The policy that was fitted.
        data: The folder with the tracks of ETH/UCY.
        fits: The folder with the files of `fit.py`.
        location: hotel, zara, univ or confirmation; the first three if not given. Repeat it for several.
    """
    use_threads(threads)
    announce_compilation()
    from studies.people.simulate import population_options
    from studies.people.table import describe, grid_of, rows_beside, rows_of
    from studies.people.windows import FOLDS, read_windows

    windows = read_windows(data, location or FOLDS)
    options = {name: fitted_without(fits, name) for name in windows}
    populations = {name: population_options(policy, own) for name, own in options.items()}
    model = score_folds(policy, windows, options)
    rows = rows_of(f"{policy}, fitted", model)
    rows += rows_beside(model, f"{BASELINE} as shipped", score_folds(BASELINE, windows, {}))
    rows += rows_beside(model, "blind, same population", score_folds(BLIND, windows, populations))
    grid = grid_of(rows)
    flags = [text for name in location or [] for text in ("--location", name)]
    command = shlex.join(["python", "studies/people/folds.py", policy, "--data", "DIR", "--fits", str(fits), *flags])
    page = [printed_by(command), markdown(grid.header, grid.rows), describe(model["shown"])]
    print_study(grid.records, [grid], "\n\n".join(page), format)


def score_folds(
    policy: str, windows: Mapping[str, Sequence[Window]], options: Mapping[str, Mapping[str, Any]]
) -> dict[str, list[Any]]:
    """Return the scores of a policy by goal, with options by location."""
    from studies.people.likelihood import score
    from studies.people.simulate import simulate

    scores: dict[str, list[Any]] = {"shown": [], "hidden": []}
    for name, each in windows.items():
        for goal, found in scores.items():
            found += score(each, simulate(policy, each, options.get(name), hidden=goal == "hidden"))
    return scores


def fitted_without(fits: Path, location: str) -> dict[str, Any]:
    """Return the options that were fitted without a location, and without others at the same place.

    Raises InputError if there is no such file, or if it is not one of `fit.py`.
    """
    from studies.people.windows import PLACE

    held_out = PLACE.get(location, location)
    file = fits / f"{held_out}.json"
    if not file.is_file():
        raise InputError(f"there is no {file}: run studies/people/fit.py with --held-out {held_out}")
    try:
        return dict(json.loads(file.read_text())["options"])
    except (ValueError, KeyError, TypeError):
        raise InputError(f"{file} is no file of studies/people/fit.py: run it with --held-out {held_out}") from None


if __name__ == "__main__":
    main(folds)
