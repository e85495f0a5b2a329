"""Stand-ins for layouts and pedestrian policies whose files are not at hand: the table of a scenario says all of them
that its digest depends on, so that it can be checked without them.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from typing import Any

from crowdbench.sim.pedestrians import PedestrianPolicy
from crowdbench.utils.errors import InputError


def unseen_layout(options: Mapping[str, Any]) -> Callable[..., Any]:
    """Return a layout with these options, which draws nothing. Raises InputError where an option can have no such name.

    Args:
        options: Their values, of which each is taken for the default.
    """

    def layout(**options: Any) -> Any:
        raise NotImplementedError

    if wrong := [name for name in options if not name.isidentifier()]:
        raise InputError(f"no option of a layout is called {wrong[0]!r}")
    parameters = [inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=options[name]) for name in options]
    layout.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    return layout


def unseen_policy(parameters: Mapping[str, Any]) -> PedestrianPolicy:
    """Return a pedestrian policy with parameters of these names, which moves nobody."""

    class Unseen(PedestrianPolicy):
        def velocities(self, world: Any, parameters: Any) -> Any:
            raise NotImplementedError

    Unseen.parameters = dict.fromkeys(parameters, 0.0)
    return Unseen()
