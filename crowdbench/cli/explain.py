"""What a docstring says of something that can be listed, and the table of its options."""

from __future__ import annotations

import dataclasses
import json
import re
import types
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from docstring_parser import Docstring, DocstringStyle, parse

from crowdbench.catalog import PEDESTRIANS
from crowdbench.plugins.options import REQUIRED, Option, read_options

WORDS: dict[Any, str] = {
    bool: "true or false",
    float: "number",
    int: "whole number",
    str: "text",
    types.NoneType: "false",
}
"""How types are called; a dataclass is a table."""

NUMBERS = {WORDS[float], WORDS[int]}


@dataclass(frozen=True)
class OptionRow:
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

    @property
    def lacks(self) -> str:
        """What its docstring should say and does not, empty where nothing is missing."""
        if not self.meaning:
            return "a meaning"
        return "a unit" if not self.unit and NUMBERS & set(self.type.split(" or ")) else ""


def description(docstring: str | None) -> str:
    """A docstring without its sections."""
    return _parse_docstring(docstring).description or ""


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
                rows.append(dataclasses.replace(row, name=f"  {row.name}"))
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
    policy, entries = PEDESTRIANS.make(name, factory, {}), _read_entries(factory)
    options = [Option(key, float(default), (float,)) for key, default in policy.parameters.items()]
    return [dataclasses.replace(_row(each, entries), name=f"pedestrians.{name}.{each.name}") for each in options]


def _read_entries(documented: Any) -> dict[str, tuple[str, str]]:
    """What the docstring of a function or class says of each parameter: meaning and unit."""
    entries = {}
    for entry in _parse_docstring(documented.__doc__).params:
        text = " ".join((entry.description or "").split())
        match = re.fullmatch(r"(.*?)\s*\[([^\[\]]+)\]\.?", text)
        entries[entry.arg_name] = (f"{match[1].rstrip('.')}.", match[2]) if match else (text, "")
    return entries


def _parse_docstring(docstring: object) -> Docstring:
    """A docstring; whatever else somebody has put in its place says nothing."""
    return parse(docstring if isinstance(docstring, str) else "", DocstringStyle.GOOGLE)


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
