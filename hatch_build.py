"""Adds `agents` to the wheel, with one network of each kind. Networks of other seeds are in the repository alone."""

from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class AgentsHook(BuildHookInterface[Any]):
    """A hook of hatchling."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Add the files to a build of a wheel that is no link to a checkout."""
        if version == "editable":
            return  # it uses the checkout
        root = Path(self.root)
        for path in sorted((root / "agents").rglob("*")):
            of_another_seed = path.parent.name == "weights" and "-seed" in path.name
            if path.is_file() and path.suffix != ".pyc" and not of_another_seed:
                build_data["force_include"][str(path)] = f"crowdbench/{path.relative_to(root).as_posix()}"
