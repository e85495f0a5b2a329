"""Runs of one planner in several scenarios: a scenario that it cannot drive does not stop the others."""

from __future__ import annotations

from collections.abc import Callable, Collection, Hashable
from typing import TypeVar

from crowdbench.utils.errors import InputError, MachineFault

Place = TypeVar("Place", bound=Hashable)


def make_each(scenarios: Collection[Place], make: Callable[[Place], None]) -> dict[Place, str]:
    """Make the run of each scenario.

    Args:
        scenarios: Their names, or pairs of a name and a track of sensing.
        make: Makes the run of a scenario.

    Returns:
        The error of each scenario in which the planner breaks its contract or a limit.

    Raises:
        InputError: The planner fails in all scenarios.
        MachineFault: The machine fails.
    """
    failures: dict[Place, InputError] = {}
    for name in scenarios:
        try:
            make(name)
        except MachineFault:
            raise
        except InputError as error:
            failures[name] = error
    if len(failures) == len(scenarios):
        raise next(iter(failures.values()))
    return {name: str(error) for name, error in failures.items()}
