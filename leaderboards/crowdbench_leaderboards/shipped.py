"""The planners that the maintainers enter, from `shipped.toml`: those that ship, and a few of others."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from crowdbench import InputError
from crowdbench.utils import Flag, Location, Name, TomlTable, parse_table, read_toml
from crowdbench_leaderboards.planner_files import named_externals

SHIPPED_FILE = "shipped.toml"
CARDS = "cards"

MOST_OTHERS = 6
"""Largest number of planners of others."""

Boards = Annotated[list[Name], Field(description="a list of boards")]


class ShippedSpec(TomlTable):
    """An item of `shipped` in `shipped.toml`: the name of an entry and of its card, and its planner.

    `weights` are other networks of the same method, which are run on the boards `method_on`. `not_on` lists the boards
    that the planner cannot run on, and `only_on` the only ones that it is entered on. `others` marks a network that
    others have trained and published: its weights do not ship, and `options` names them by their sha256.
    """

    name: Name
    planner: Name
    options: Annotated[dict[str, Any], Field(description="a table of options")] = Field(default_factory=dict)
    weights: Annotated[list[Name], Field(description="a list of weights")] = Field(default_factory=list)
    method_on: Boards = Field(default_factory=list)
    not_on: Boards = Field(default_factory=list)
    only_on: Boards = Field(default_factory=list)
    others: Flag = False

    def is_on(self, board: str) -> bool:
        """Check if the planner is entered on a board."""
        return board in self.only_on if self.only_on else board not in self.not_on

    def networks(self, board: str) -> list[dict[str, Any]]:
        """Return the options of the other networks of its method on a board."""
        return [{"weights": name} for name in self.weights] if board in self.method_on else []

    def why_not(self, planner: str, options: Mapping[str, Any]) -> str:
        """Return why an entry without an account is not of this planner; empty if it is.

        Args:
            planner: The planner of the entry.
            options: Its options.
        """
        own = [self.planner, f"planner/{Path(self.planner).name}"] if "/" in self.planner else [self.planner]
        if planner not in own or options != self.options:
            return f"{SHIPPED_FILE} lists {self.name} with another planner or other options"
        return ""


class ShippedFile(TomlTable):
    """The contents of `shipped.toml`."""

    shipped: Annotated[list[ShippedSpec], Field(min_length=1, description="tables [[shipped]]")]


def read_shipped(root: Path) -> dict[str, ShippedSpec]:
    """Read the listed planners of a folder of boards by name; none without the file.

    Raises InputError if the file is wrong, or lists too many planners of others.
    """
    if not (root / SHIPPED_FILE).exists():
        return {}
    listed = parse_table(ShippedFile, read_toml(root / SHIPPED_FILE, "list"), Location(SHIPPED_FILE)).shipped
    others = [each for each in listed if each.others]
    if len(others) > MOST_OTHERS:
        raise InputError(f"{SHIPPED_FILE} lists {len(others)} planners of others, but may list {MOST_OTHERS}")
    for each in listed:
        if bool(named_externals(each.options)) != each.others:
            raise InputError(
                f'{SHIPPED_FILE}: {each.name} must have others = true and an option "sha256:...", or neither'
            )
    return {each.name: each for each in listed}
