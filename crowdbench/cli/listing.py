"""The command that lists named items, such as planners, and explains one of them with its options."""

from __future__ import annotations

import json
import re
import sys
import types
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer

from crowdbench.cli.console import print_table, write
from crowdbench.cli.options import parse_docstring
from crowdbench.plugins.options import REQUIRED, Option, read_options
from crowdbench.utils.errors import InputError, did_you_mean, find_named
from crowdbench.utils.files import read_text
from crowdbench.utils.tables import Grid

LISTED = {
    "planners": "algorithms that drive the vehicle: --planner",
    "pedestrians": "policies that move the pedestrians: --pedestrians",
    "predictors": "predictors of the pedestrians' motion, an option of planners",
    "weights": "trained networks, an option of planners",
    "scenarios": "crowds and places: --scenario",
    "layouts": "starts, goals and obstacles of scenarios: --set layout=NAME",
    "metrics": "measures of an episode: --metric",
}
"""The kinds of named items, with the option that takes a name."""

LINE_BREAK = r"\n(?!\s*(?:\n|$|\d+\. |- |\|)| {4}) *"
"""A break within a paragraph or an item of a list, with the indentation of the next line."""

WORDS: dict[Any, str] = {
    bool: "true or false",
    float: "number",
    int: "whole number",
    str: "text",
    types.NoneType: "false",
}
"""Names of types for users; a dataclass is a table."""


def list_(
    kind: Annotated[str | None, typer.Argument()] = None, name: Annotated[str | None, typer.Argument()] = None
) -> None:
    """List planners, scenarios and other named items, or explain one of them.

    Args:
        kind: planners, pedestrians, predictors, weights, scenarios, layouts or metrics. By default, the kinds are
            listed.
        name: Name of the item to explain, with its options.
    """
    if kind is None:
        print_table(Grid("crowdbench list KIND", ("kind", "meaning"), list(LISTED.items()), align="ll"))
        return
    if kind not in LISTED:
        *others, last = LISTED
        near = did_you_mean(kind, LISTED)
        raise InputError(f"nothing is listed as {kind!r}{near}: ask for {', '.join(others)} or {last}")
    if name is None:
        print_table(_names_grid(kind))
        return
    if kind in ("weights", "scenarios"):
        show = print if kind == "scenarios" else write  # a line of TOML must stay a line
        show(read_text(_find_text(kind, name)).strip())
        return
    text, title, options = _plugin_page(kind, name)
    # The lines of a paragraph are joined, which are then broken where the terminal ends.
    write(re.sub(LINE_BREAK, " ", text.strip()) if sys.stdout.isatty() else text.strip())
    if options:
        print_table(Grid(f"\n{title}", OptionRow._fields, options, align="l" * len(OptionRow._fields)))


class OptionRow(NamedTuple):
    """A row of a table of options.

    Attributes:
        name: Its name, indented if it is a parameter of the table above.
        default: Its default, as a user would write it; empty if the option is required.
        type: Type of its value.
        unit: The unit of a number, 1 for a number without one.
        meaning: Its meaning.
    """

    name: str
    default: str
    type: str
    unit: str
    meaning: str


def _names_grid(kind: str) -> Grid:
    """Return the table of all things of a kind, metrics with their titles in tables."""
    names = _names(kind)
    if kind != "metrics":
        return Grid(kind, ("name", "description"), names, align="ll")
    from crowdbench.metrics.registry import info_of

    rows = [(name, info_of(name).title, description) for name, description in names]
    return Grid(kind, ("name", "title", "description"), rows, align="lll")


def _names(kind: str) -> list[tuple[str, str]]:
    """Return the names of all things of a kind, with a description of each."""
    if kind == "weights":
        from crowdbench.networks.card import headline
        from crowdbench.networks.weights import built_in, read_card

        return [(path.stem, headline(read_card(path))) for path in built_in()]
    if kind == "scenarios":
        from crowdbench.catalog import scenarios

        return scenarios()
    from crowdbench.check.kinds import KINDS

    return KINDS[kind].names()


def _find_text(kind: str, name: str) -> Path:
    """Return the file that explains weights or a scenario."""
    if kind == "weights":
        from crowdbench.networks.weights import weights_file

        return weights_file(name).with_suffix(".md")
    from crowdbench.catalog import scenario_path

    return scenario_path(name)


def _plugin_page(kind: str, name: str) -> tuple[str, str, list[OptionRow]]:
    """Return the description of a plug-in, the title of its options, and the options.

    The description is the docstring of its file, or of its function if a file may define several plug-ins.
    """
    from crowdbench.check.kinds import KINDS

    plugins = KINDS[kind]
    if kind == "metrics":
        find_named("metric", name, plugins.functions)  # metrics of a user's file are not described
    plugin, factory = plugins.find(name)
    text = parse_docstring(factory.__doc__)[0] if plugins.functions else plugins.docstring(name)
    text = text or f"{name} has no docstring: its file says nothing about the {plugins.word}."
    if kind == "metrics":
        from crowdbench.metrics.registry import info_of

        info = info_of(name)
        better = f"; {info.better} is better" if info.better else ""
        source = f" Source: {info.source}." if info.source else ""
        return f"{text}\n\nIn tables: {info.heading}{better}.{source}", "", []
    if kind == "pedestrians":
        return text, "Parameters: --set name=value", parameter_rows(plugin, factory)
    if kind == "layouts":
        return text, "Options: --set name=value", option_rows(factory, "layout.", keyword_only=True)
    title = "Options: --option name=value, and a table --option 'name={parameter=value}'"
    return text, title, option_rows(factory)


def option_rows(factory: Callable[..., object], prefix: str = "", keyword_only: bool = False) -> list[OptionRow]:
    """Return the options of a plug-in's function or class. The parameters of an option that is a table follow it.

    Args:
        factory: The function or class. Its docstring has `Args:`, or `Attributes:` for a dataclass. Each entry ends
            with the unit in brackets. For a partial, the docstring of its function is used.
        prefix: The beginning of each name.
        keyword_only: True if parameters that are not keyword-only are left out.

    Returns:
        The options in the order of the signature.
    """
    entries = _read_entries(getattr(factory, "func", factory))
    rows = []
    for option in read_options(factory):
        if option.keyword_only or not keyword_only:
            rows.append(_row(option, entries, prefix))
            for part in option.parts:
                part_entries = _read_entries(part)
                rows += [_row(parameter, part_entries, "  ") for parameter in option.part_options(part)]
    return rows


def parameter_rows(name: str, factory: Callable[..., object]) -> list[OptionRow]:
    """Return the parameters of a pedestrian policy that a scenario may set.

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
    return [_row(option, entries, f"pedestrians.{name}.") for option in options]


def _read_entries(documented: Any) -> dict[str, tuple[str, str]]:
    """Return the meaning and unit of each parameter from the docstring of a function or class."""
    entries = {}
    for name, text in parse_docstring(documented.__doc__)[1].items():
        match = re.fullmatch(r"(.*?)\s*\[([^\[\]]+)\]\.?", text)
        entries[name] = (f"{match[1].rstrip('.')}.", match[2]) if match else (text, "")
    return entries


def _row(option: Option, entries: dict[str, tuple[str, str]], prefix: str) -> OptionRow:
    meaning, unit = entries.get(option.name, ("", ""))
    words = []
    for kind in option.types:
        word = "table" if kind in option.parts else WORDS.get(kind, getattr(kind, "__name__", str(kind)))
        if word not in words:
            words.append(word)
    return OptionRow(prefix + option.name, _format_default(option), " or ".join(words), unit, meaning)


def _format_default(option: Option) -> str:
    """Return an option's default as a user would write it."""
    if option.default is REQUIRED:
        return ""
    if type(option.default) in option.parts:
        return "as below"
    if isinstance(option.default, float):
        return f"{option.default:g}"
    if option.default is None:
        return "false"
    return json.dumps(option.default, ensure_ascii=False, default=str)
