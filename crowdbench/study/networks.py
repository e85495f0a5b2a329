"""A planner with each of several networks: what a file says of it, its runs, and their values side by side."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from crowdbench.evaluate.results import Episodes
from crowdbench.scenario.cases import Cases
from crowdbench.study.planned import Run
from crowdbench.study.tables import Measure
from crowdbench.toml_section import Section


@dataclass(frozen=True)
class Variant:
    """The scenario a second time, under another rule; `title` heads its column."""

    title: str
    overrides: dict[str, Any]

    @classmethod
    def of(cls, section: Section) -> Variant | None:
        """What a table says of it under `variant`, if anything. Raises InputError where something in it is wrong."""
        if "variant" not in section.table:
            return None
        table = section.section("variant")
        variant = cls(table.needed("title"), table.values("overrides"))
        table.close()
        return variant


def own_options(section: Section) -> dict[str, Any]:
    """A row's options. Raises InputError where the weights are among them."""
    options = section.values("options")
    if "weights" in options:
        raise section.wrong("options", "without weights: they have a key of their own")
    return options


def runs_with(
    weights: Iterable[str],
    planner: str,
    options: dict[str, Any],
    scenario: str,
    cases: Cases,
    *,
    overrides: Mapping[str, Any] | None = None,
    replan_every: int = 1,
) -> list[Run]:
    """A run with each of the weights, or one where there are none to choose from. Raises InputError like `Run.of`."""
    each = [{**options, "weights": name} for name in weights] or [options]
    return [Run.of(planner, chosen, scenario, cases, overrides=overrides, replan_every=replan_every) for chosen in each]


def of_all(seeds: Iterable[Episodes], measure: Measure) -> Float[np.ndarray, "seed case"]:
    """What each of several runs of the same cases measured."""
    return np.stack([episodes.columns[measure.metric].astype(float) for episodes in seeds])
