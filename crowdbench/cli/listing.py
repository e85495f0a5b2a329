"""The command that lists what there is, and explains one thing with its options."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from crowdbench import files
from crowdbench.cli.options import print_table
from crowdbench.errors import InputError

if TYPE_CHECKING:
    from crowdbench.cli.explain import OptionRow
    from crowdbench.plugins import Kind


def list_(
    kind: Annotated[
        str, typer.Argument(help="planners, pedestrians, predictors, weights, scenarios, layouts or metrics.")
    ],
    name: Annotated[str | None, typer.Argument(help="One of them, to be explained with its options.")] = None,
) -> None:
    """List planners, pedestrians, predictors, weights, scenarios, layouts or metrics, or explain one of them."""
    kinds = _kinds()
    if kind not in kinds:
        *others, last = kinds
        raise InputError(f"nothing is listed as {kind!r}: ask for {', '.join(others)} or {last}")
    from crowdbench.cli.tables import listing_table

    if name is None:
        print_table(listing_table(kind, kinds[kind].names()))
        return
    page = kinds[kind].page(name)
    print(page.text.strip())
    if page.options:
        columns = [field.name for field in dataclasses.fields(page.options[0])]
        print_table(listing_table(f"\n{page.title}", map(dataclasses.astuple, page.options), columns))


@dataclass(frozen=True)
class Page:
    """What is said of one thing: a text, and its options under a title."""

    text: str
    options: list[OptionRow] = dataclasses.field(default_factory=list)
    title: str = "Options: --option name=value, and a table --option 'name={parameter=value}'"


@dataclass(frozen=True)
class Listed:
    """A kind of thing that is listed: the names with a description of each, and the page of one by its name."""

    names: Callable[[], list[tuple[str, str]]]
    page: Callable[[str], Page]


def _kinds() -> dict[str, Listed]:
    from crowdbench import catalog
    from crowdbench.evaluate.metrics import METRICS
    from crowdbench.predict.load import PREDICTORS
    from crowdbench.train.methods import built_in_weights

    return {
        "planners": Listed(catalog.PLANNERS.names, _planner),
        "pedestrians": Listed(catalog.PEDESTRIANS.names, _pedestrians),
        "predictors": Listed(lambda: _described(PREDICTORS), _predictor),
        "weights": Listed(built_in_weights, _weights),
        "scenarios": Listed(catalog.scenarios, _scenario),
        "layouts": Listed(catalog.LAYOUTS.names, _layout),
        "metrics": Listed(lambda: _described(METRICS), _metric),
    }


def _described(things: Mapping[str, object]) -> list[tuple[str, str]]:
    """Each name with the first line of the docstring."""
    return [(name, (thing.__doc__ or "").partition("\n")[0]) for name, thing in things.items()]


def _text(kind: Kind, name: str) -> str:
    """What the file of a plug-in says of it."""
    return kind.docstring(name) or f"{name} has no docstring: its file says nothing about the {kind.word}."


def _planner(name: str) -> Page:
    from crowdbench.catalog import PLANNERS
    from crowdbench.cli.explain import option_rows

    _, factory = PLANNERS.find(name)
    return Page(_text(PLANNERS, name), option_rows(factory))


def _pedestrians(name: str) -> Page:
    from crowdbench.catalog import PEDESTRIANS
    from crowdbench.cli.explain import parameter_rows

    found, factory = PEDESTRIANS.find(name)
    return Page(_text(PEDESTRIANS, name), parameter_rows(found, factory), "Parameters: --set name=value")


def _predictor(name: str) -> Page:
    from crowdbench.cli.explain import description, option_rows
    from crowdbench.predict.load import find_predictor

    _, factory = find_predictor(name)
    said = description(factory.__doc__) or f"{name} has no docstring: its file says nothing about the predictor."
    return Page(said, option_rows(factory))


def _weights(name: str) -> Page:
    from crowdbench.weights.store import weights_file

    card = weights_file(name).with_suffix(".md")
    try:
        return Page(files.read_text(card))
    except OSError as error:
        raise InputError(f"there is no card {card}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise InputError(f"the card {card} is no text in UTF-8") from None


def _scenario(name: str) -> Page:
    from crowdbench.catalog import SCENARIOS, load_scenario, scenarios, simulated_scenarios

    recorded = {each for each, _ in scenarios()} - set(simulated_scenarios())
    if name not in recorded:  # which could be loaded only with their data
        load_scenario(name)
    path = Path(name) if name.endswith(".toml") else SCENARIOS / f"{name}.toml"
    return Page(files.read_text(path))


def _layout(name: str) -> Page:
    from crowdbench.catalog import load_layout
    from crowdbench.cli.explain import description, option_rows

    _, layout, _ = load_layout(name)
    rows = [dataclasses.replace(row, name=f"layout.{row.name}") for row in option_rows(layout, keyword_only=True)]
    said = description(layout.__doc__) or f"{name} has no docstring: its file says nothing about the layout."
    return Page(said, rows, "Options: --set name=value")


def _metric(name: str) -> Page:
    from crowdbench.cli.explain import description
    from crowdbench.evaluate.metrics import METRICS

    if name not in METRICS:
        raise InputError(f"no metric is called {name!r}; there are {', '.join(METRICS)}")
    return Page(description(METRICS[name].__doc__))
