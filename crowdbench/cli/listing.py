"""The command that lists what there is."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Annotated

import typer

from crowdbench.cli.options import print_table
from crowdbench.errors import InputError


def list_(
    kind: Annotated[str, typer.Argument(help="planners, pedestrians, predictors, weights, scenarios or metrics.")],
) -> None:
    """List planners, pedestrians, predictors, weights, scenarios or metrics."""
    from crowdbench import catalog
    from crowdbench.cli.tables import listing_table
    from crowdbench.evaluate.metrics import METRICS
    from crowdbench.predict.load import PREDICTORS
    from crowdbench.train.methods import built_in_weights

    listings: dict[str, Callable[[], list[tuple[str, str]]]] = {
        "planners": catalog.PLANNERS.names,
        "pedestrians": catalog.PEDESTRIANS.names,
        "predictors": lambda: _described(PREDICTORS),
        "weights": built_in_weights,
        "scenarios": catalog.scenarios,
        "metrics": lambda: _described(METRICS),
    }
    if kind not in listings:
        *others, last = listings
        raise InputError(f"nothing is listed as {kind!r}: ask for {', '.join(others)} or {last}")
    print_table(listing_table(kind, listings[kind]()))


def _described(things: Mapping[str, object]) -> list[tuple[str, str]]:
    """Each name with the first line of the docstring."""
    return [(name, (thing.__doc__ or "").partition("\n")[0]) for name, thing in things.items()]
