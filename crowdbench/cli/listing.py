"""The command that lists what there is, and explains one thing with its options."""

from __future__ import annotations

import dataclasses
import json
import re
import types
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from crowdbench.cli.console import print_table
from crowdbench.cli.options import help_from_docstring, parse_docstring
from crowdbench.plugins.options import REQUIRED, Option, read_options
from crowdbench.utils.errors import InputError, find_named
from crowdbench.utils.files import read_text
from crowdbench.utils.tables import Grid

if TYPE_CHECKING:
    from crowdbench.boards.board import Board

LISTED = ("planners", "pedestrians", "predictors", "weights", "scenarios", "layouts", "metrics", "boards")

WORDS: dict[Any, str] = {
    bool: "true or false",
    float: "number",
    int: "whole number",
    str: "text",
    types.NoneType: "false",
}
"""How types are called; a dataclass is a table."""


@help_from_docstring
def list_(kind: str, name: Annotated[str | None, typer.Argument()] = None) -> None:
    """List planners, scenarios, boards and whatever else has a name, or explain one of them.

    Args:
        kind: planners, pedestrians, predictors, weights, scenarios, layouts, metrics or boards.
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
    elif kind == "boards":
        from crowdbench.boards.board import FILE, ROOT, find_board

        page = Page(read_text(ROOT / find_board(name, ROOT).name / FILE))
    else:
        page = _plugin_page(kind, name)
    print(page.text.strip())
    if page.options:
        print_table(Grid(f"\n{page.title}", OptionRow._fields, page.options, align="l" * len(OptionRow._fields)))


class OptionRow(NamedTuple):
    """An option as a user sees it.

    Attributes:
        name: Its name, indented where it is a parameter of the table above.
        default: Its value where it is not given, as it would be written; empty where it must be given.
        type: What can be given.
        unit: The unit of a number, 1 for a number without one.
        meaning: What it is.
    """

    name: str
    default: str
    type: str
    unit: str
    meaning: str


FILTER = OptionRow("filter", "false", "text or false", "", "kalman: estimates in place of what a sensor measures.")
"""The option of every planner, which `catalog.load_planner` reads."""


class Page(NamedTuple):
    """What is said of one thing: a text, and its options under a title."""

    text: str
    options: Sequence[OptionRow] = ()
    title: str = "Options: --option name=value, and a table --option 'name={parameter=value}'"


def _names(kind: str) -> list[tuple[str, str]]:
    """The names of all things of a kind, with a description of each."""
    if kind == "weights":
        from crowdbench.networks.card import headline
        from crowdbench.networks.weights import built_in, read_card

        return [(path.stem, headline(read_card(path))) for path in built_in()]
    if kind == "scenarios":
        from crowdbench.catalog import scenarios

        return scenarios()
    if kind == "boards":
        from crowdbench.boards.board import read_boards

        return [(board.name, _describe_board(board)) for board in read_boards()]
    from crowdbench.check.kinds import KINDS

    return KINDS[kind].names()


def _describe_board(board: Board) -> str:
    """How much there is to drive for an entry of a board, and what it is about."""
    number, each = len(board.scenarios), board.spec.public_cases
    size = f"{each} public cases" if number == 1 else f"{each} public cases of each of {number} scenarios"
    return f"{size}. {board.spec.description}"


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
    from crowdbench.catalog import load_scenario, scenario_path, scenarios, simulated_scenarios

    recorded = {each for each, _ in scenarios()} - set(simulated_scenarios())
    if name not in recorded:  # which could be loaded only with their data
        load_scenario(name)
    return Page(read_text(scenario_path(name)))


def _plugin_page(kind: str, name: str) -> Page:
    """What the file of a plug-in says of it, or its function where a file may define several, and its options."""
    from crowdbench.check.kinds import KINDS

    plugins = KINDS[kind]
    if kind == "metrics":
        find_named("metric", name, plugins.functions)  # a file says nothing of its metrics
    found, factory = plugins.find(name)
    text = parse_docstring(factory.__doc__)[0] if plugins.functions else plugins.docstring(name)
    text = text or f"{name} has no docstring: its file says nothing about the {plugins.word}."
    if kind == "metrics":
        from crowdbench.metrics import info_of

        info = info_of(name)
        better = f"; {info.better} is better" if info.better else ""
        return Page(f"{text}\n\nIn tables: {info.heading}{better}." + f" Source: {info.source}." * bool(info.source))
    if kind == "pedestrians":
        return Page(text, parameter_rows(found, factory), "Parameters: --set name=value")
    if kind == "layouts":
        rows = [row._replace(name=f"layout.{row.name}") for row in option_rows(factory, keyword_only=True)]
        return Page(text, rows, "Options: --set name=value")
    return Page(text, [*option_rows(factory), *([FILTER] if kind == "planners" else [])])


def option_rows(factory: Callable[..., object], keyword_only: bool = False) -> list[OptionRow]:
    """The options of a plug-in's function or class, each followed by the parameters of the table that it may be.

    Args:
        factory: Its docstring has an `Args:` section; a dataclass has `Attributes:`. Each entry ends with the unit in
            brackets. Of a partial, it is the function's docstring that counts.
        keyword_only: Whether parameters that are not keyword-only are left out.

    Returns:
        The options in the order of the signature.
    """
    entries = _read_entries(getattr(factory, "func", factory))
    rows = []
    for option in read_options(factory):
        if keyword_only and not option.keyword_only:
            continue
        rows.append(_row(option, entries))
        for part in option.parts:
            own = option.default if isinstance(option.default, part) else None
            for parameter in read_options(part):
                default = parameter.default if own is None else getattr(own, parameter.name)
                row = _row(dataclasses.replace(parameter, default=default), _read_entries(part))
                rows.append(row._replace(name=f"  {row.name}"))
    return rows


def parameter_rows(name: str, factory: Callable[..., object]) -> list[OptionRow]:
    """What a scenario may set of a pedestrian policy.

    Args:
        name: The policy's name.
        factory: Makes the policy. Its docstring has a section `Parameters:` with the policy's parameters.

    Returns:
        The parameters by their keys in a scenario.

    Raises:
        InputError: The factory does not make a pedestrian policy.
    """
    from crowdbench.catalog import PEDESTRIANS

    policy, entries = PEDESTRIANS.make(name, factory, {}), _read_entries(factory)
    options = [Option(key, float(default), (float,)) for key, default in policy.parameters.items()]
    return [_row(each, entries)._replace(name=f"pedestrians.{name}.{each.name}") for each in options]


def _read_entries(documented: Any) -> dict[str, tuple[str, str]]:
    """What the docstring of a function or class says of each parameter: meaning and unit."""
    entries = {}
    for name, text in parse_docstring(documented.__doc__)[1].items():
        match = re.fullmatch(r"(.*?)\s*\[([^\[\]]+)\]\.?", text)
        entries[name] = (f"{match[1].rstrip('.')}.", match[2]) if match else (text, "")
    return entries


def _row(option: Option, entries: dict[str, tuple[str, str]]) -> OptionRow:
    meaning, unit = entries.get(option.name, ("", ""))
    words = dict.fromkeys("table" if kind in option.parts else _name_type(kind) for kind in option.types)
    return OptionRow(option.name, _format_default(option), " or ".join(words), unit, meaning)


def _name_type(kind: Any) -> str:
    return WORDS.get(kind, getattr(kind, "__name__", str(kind)))


def _format_default(option: Option) -> str:
    """An option's default as one would write it."""
    if option.default is REQUIRED:
        return ""
    if option.default is None or isinstance(option.default, bool):
        return "true" if option.default else "false"
    if type(option.default) in option.parts:
        return "as below"
    if isinstance(option.default, float):
        return f"{option.default:g}"
    return json.dumps(option.default, ensure_ascii=False, default=str)
