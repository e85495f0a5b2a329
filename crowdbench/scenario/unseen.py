"""Stand-ins for layouts and pedestrian policies whose files are not available. The digest of a scenario depends only
on its table, so that it can be checked without these files.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from typing import Any

from crowdbench.sim.pedestrians import PedestrianPolicy, Recorded
from crowdbench.utils.errors import InputError


def unseen_layout(options: Mapping[str, Any]) -> Callable[..., Any]:
    """Return a layout with these options that draws nothing. Raises InputError if the name of an option is invalid.

    Args:
        options: Their values by name, which become their defaults.
    """

    def layout() -> None:
        """Lay out starts; its options are read from its signature."""

    kind = inspect.Parameter.KEYWORD_ONLY
    try:
        parameters = [inspect.Parameter(name, kind, default=value) for name, value in options.items()]
    except ValueError as error:
        raise InputError(f"an option of a layout cannot be called so: {error}") from None
    layout.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    return layout


def unseen_policy(parameters: Mapping[str, Any]) -> PedestrianPolicy:
    """Return a pedestrian policy with parameters of these names."""
    return type("Unseen", (Recorded,), {"parameters": dict.fromkeys(parameters, 0.0)})()
