"""The command that lists what there is, and explains one thing with its options."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from crowdbench.cli.options import help_from_docstring
from crowdbench.cli.tables import print_table
from crowdbench.utils.errors import InputError
from crowdbench.utils.files import read_text
from crowdbench.utils.tables import Grid

if TYPE_CHECKING:
    from crowdbench.cli.explain import OptionRow

LISTED = ("planners", "pedestrians", "predictors", "weights", "scenarios", "layouts", "metrics")


@help_from_docstring
def list_(kind: str, name: Annotated[str | None, typer.Argument()] = None) -> None:
    """List planners, pedestrians, predictors, weights, scenarios, layouts or metrics, or explain one of them.

    Args:
        kind: planners, pedestrians, predictors, weights, scenarios, layouts or metrics.
        name: One of them, to be explained with its options.
    """
    if kind not in LISTED:
        *others, last = LISTED
        raise InputError(f"nothing is listed as {kind!r}: ask for {', '.join(others)} or {last}")
    if name is None:
        print_table(Grid(kind, ("name", "description"), _names(kind), align="ll"))
        return
    if kind == "weights":
        page = _weights_page(name)
    elif kind == "scenarios":
        page = _scenario_page(name)
    else:
        page = _plugin_page(kind, name)
    print(page.text.strip())
    if page.options:
        columns = [field.name for field in dataclasses.fields(page.options[0])]
        rows = [dataclasses.astuple(option) for option in page.options]
        print_table(Grid(f"\n{page.title}", columns, rows, align="l" * len(columns)))


@dataclass(frozen=True)
class Page:
    """What is said of one thing: a text, and its options under a title."""

    text: str
    options: list[OptionRow] = dataclasses.field(default_factory=list)
    title: str = "Options: --option name=value, and a table --option 'name={parameter=value}'"


def _names(kind: str) -> list[tuple[str, str]]:
    """The names of all things of a kind, with a description of each."""
    if kind == "weights":
        from crowdbench.train.methods import built_in_weights

        return built_in_weights()
    if kind == "scenarios":
        from crowdbench.catalog import scenarios

        return scenarios()
    from crowdbench.check.kinds import KINDS

    return KINDS[kind].plugins.names()


def _weights_page(name: str) -> Page:
    from crowdbench.networks.weights import weights_file

    card = weights_file(name).with_suffix(".md")
    try:
        return Page(read_text(card))
    except OSError as error:
        raise InputError(f"there is no card {card}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise InputError(f"the card {card} is no text in UTF-8") from None


def _scenario_page(name: str) -> Page:
    from crowdbench.catalog import SCENARIOS, load_scenario, scenarios, simulated_scenarios

    recorded = {each for each, _ in scenarios()} - set(simulated_scenarios())
    if name not in recorded:  # which could be loaded only with their data
        load_scenario(name)
    return Page(read_text(Path(name) if name.endswith(".toml") else SCENARIOS / f"{name}.toml"))


def _plugin_page(kind: str, name: str) -> Page:
    """What the file of a plug-in says of it, or its function where a file may define several, and its options."""
    from crowdbench.check.kinds import KINDS
    from crowdbench.cli.explain import description, option_rows, parameter_rows

    plugins = KINDS[kind].plugins
    if kind == "metrics" and name not in plugins.functions:
        raise InputError(f"no metric is called {name!r}; there are {', '.join(plugins.functions)}")
    found, factory = plugins.find(name)
    text = description(factory.__doc__) if plugins.functions else plugins.docstring(name)
    text = text or f"{name} has no docstring: its file says nothing about the {plugins.word}."
    if kind == "metrics":
        return Page(text)
    if kind == "pedestrians":
        return Page(text, parameter_rows(found, factory), "Parameters: --set name=value")
    if kind == "layouts":
        rows = [dataclasses.replace(row, name=f"layout.{row.name}") for row in option_rows(factory, keyword_only=True)]
        return Page(text, rows, "Options: --set name=value")
    return Page(text, option_rows(factory))
