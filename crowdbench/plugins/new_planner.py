"""The folder of a new planner: a copy of the template, with a working planner, a test, and a card for leaderboards."""

from __future__ import annotations

import importlib.util
import keyword
import re
from pathlib import Path

from crowdbench.plugins.kind import ROOT
from crowdbench.utils.errors import InputError
from crowdbench.utils.files import new_directory

TEMPLATE = ROOT / "agents" / "template"
"""The folder of the planner `careful`, which is copied under another name."""

CARD = "card.toml"


def make_planner(name: str, out: Path) -> Path:
    """Make the folder of a new planner.

    Args:
        name: The planner's name, which is the name of the folder.
        out: The parent folder.

    Returns:
        Its folder.

    Raises:
        InputError: The planner cannot have this name, or the folder exists already or cannot be written.
    """
    is_keyword = keyword.iskeyword(name) or keyword.iskeyword(name.capitalize())
    if not re.fullmatch("[a-z][a-z0-9_]{1,49}", name) or is_keyword:
        raise InputError(
            f"{name!r} cannot be the name of a planner: take 2 to 50 lower-case letters, digits and underscores, a "
            "letter first, and no word of Python"
        )
    folder = out / name
    if folder.exists():
        raise InputError(f"{folder} exists already: choose another name, or another folder with --out")
    module = importlib.util.find_spec(name)
    if module is not None and module.origin is not None:  # a folder without `__init__.py` has none
        raise InputError(f"{name!r} is a module that is installed, which the planner would hide: take another name")
    title = "".join(part.capitalize() for part in name.split("_"))
    with new_directory(folder, overwrite=False) as partial:
        for path in TEMPLATE.glob("*.*"):
            text = path.read_text(encoding="utf-8").replace("Careful", title).replace("careful", name)
            (partial / path.name.replace("careful", name)).write_text(text, encoding="utf-8")
    return folder
