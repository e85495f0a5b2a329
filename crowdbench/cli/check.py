"""The command that checks whether a planner or another plug-in keeps the contract of its kind."""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any

import typer

from crowdbench.cli.options import DataOption, LimitOption, OptionOption, assignments, print_table
from crowdbench.errors import InputError
from crowdbench.settings import DECISION_LIMIT

if TYPE_CHECKING:
    from crowdbench.evaluate.check import Point
    from crowdbench.evaluate.check.again import Tolerance
    from crowdbench.scenario.cases import Cases
    from crowdbench.scenario.scenario import Scenario

FUNCTIONS = {
    "planners": "planner",
    "pedestrians": "policy",
    "predictors": "predictor",
    "metrics": "metric",
    "layouts": "layout",
}
"""The function that a file of each kind defines."""

LIMITED_SIGHT = {
    "sensor": {
        "range": 3.0,
        "occlusion": True,
        "noise": {"position": 0.05, "velocity": 0.1},
        "missed": 0.1,
        "delay": 1,
        "remember": 1.0,
    }
}
"""What changes in the scenario where a planner or a predictor is checked without seeing everybody."""


def check(
    plugin: Annotated[
        str, typer.Argument(help="A file, ./mine.py or ./mine.py:function, or a name: a planner's, without --kind.")
    ],
    kind: Annotated[
        str | None,
        typer.Option(
            help="planners, pedestrians, predictors, metrics or layouts.", show_default="as the file's function says"
        ),
    ] = None,
    option: OptionOption = None,
    scenario: Annotated[
        str | None,
        typer.Option(
            help="A name or ./mine.toml.",
            show_default="circle_crossing_5 for planners, else circle_crossing_mixed with a visible vehicle",
        ),
    ] = None,
    cases: Annotated[str, typer.Option(help="The cases of the scenario.")] = "val:20",
    data: DataOption = None,
    decision_limit: LimitOption = DECISION_LIMIT,
) -> None:
    """Check point by point whether a plug-in keeps the contract of its kind: valid answers, the same in any batch."""
    from crowdbench.cli.console import announce_compilation
    from crowdbench.cli.tables import check_table
    from crowdbench.scenario.cases import Cases

    kind = _kind_of(plugin) if kind is None else kind
    if kind not in _CHECKS:
        *others, last = _CHECKS
        raise InputError(f"nothing is checked as {kind!r}: --kind is {', '.join(others)} or {last}")
    announce_compilation()
    asked = _Asked(plugin, assignments(option or [], "--option"), scenario, Cases.parse(cases), decision_limit, data)
    name, points = _CHECKS[kind](asked)
    print_table(check_table(name, points))
    if not all(point.kept for point in points):
        raise typer.Exit(1)


def _kind_of(plugin: str) -> str:
    """The kind of plug-in that a file defines; planners for a name, and for a function of another name."""
    from crowdbench import plugins

    file, function = plugins.file_and_function(plugin)
    if file is None:
        return "planners"
    if function:
        return next((kind for kind, name in FUNCTIONS.items() if name == function), "planners")
    module = plugins.load_module(file)
    kinds = [kind for kind, name in FUNCTIONS.items() if callable(getattr(module, name, None))]
    if len(kinds) == 1:
        return kinds[0]
    if not kinds:
        *others, last = (f"{name}()" for name in FUNCTIONS.values())
        raise InputError(f"{file} defines no function {', '.join(others)} or {last}")
    found = " and ".join(f"{FUNCTIONS[kind]}()" for kind in kinds)
    raise InputError(f"{file} defines {found}: say which is meant, with --kind {' or --kind '.join(kinds)}")


@dataclass(frozen=True)
class _Asked:
    """What is asked for on the command line."""

    plugin: str
    options: Mapping[str, Any]
    scenario: str | None
    cases: Cases
    limit: float
    data: Path | None

    def place(self, pedestrians: str | None = None, changes: Mapping[str, Any] = MappingProxyType({})) -> Scenario:
        """The scenario; where none is given, one with crowds of several sizes that see the vehicle.

        Args:
            pedestrians: The policy that moves all pedestrians, if not the scenario's.
            changes: Other values for keys of the scenario.
        """
        from crowdbench.catalog import load_scenario

        if self.scenario is None:
            changes = {"vehicle.visible": True, **changes}
        found = load_scenario(self.scenario or "circle_crossing_mixed", changes, pedestrians, self.data)
        found.check_data(self.data)
        return found

    def without_options(self, what: str) -> None:
        """Raises InputError where options are given."""
        if self.options:
            raise InputError(f"--option does not go with a {what}, which has no options")


def _planner(asked: _Asked) -> tuple[str, list[Point]]:
    from crowdbench import catalog
    from crowdbench.evaluate.check import check_planner

    load = functools.partial(catalog.load_planner, asked.plugin, asked.options)
    place, limited = (
        catalog.load_scenario(asked.scenario or "circle_crossing_5", each, data=asked.data)
        for each in ({}, LIMITED_SIGHT)
    )
    place.check_data(asked.data)
    name, _ = load()
    return name, check_planner(lambda: load()[1], name, place, asked.cases, asked.limit, limited)


def _policy(asked: _Asked) -> tuple[str, list[Point]]:
    from crowdbench.catalog import load_policy
    from crowdbench.evaluate.check import check_policy

    asked.without_options("pedestrian policy")
    load = functools.partial(load_policy, asked.plugin)
    name, place = load()[0], asked.place(asked.plugin)
    return name, check_policy(lambda: load()[1], name, place, asked.cases, asked.limit, _tolerance())


def _predictor(asked: _Asked) -> tuple[str, list[Point]]:
    from crowdbench.evaluate.check import check_predictor
    from crowdbench.plugin_options import read_options
    from crowdbench.predict.load import find_predictor, load_predictor

    def load(**others: Any) -> tuple[str, Any]:
        return load_predictor(asked.plugin, {**asked.options, **others})

    name, _ = load()
    has_modes = any(option.name == "modes" for option in read_options(find_predictor(asked.plugin)[1]))
    with_modes = (lambda modes: load(modes=modes)[1]) if has_modes else None
    place, limited = (asked.place(changes=each) for each in ({}, LIMITED_SIGHT))
    points = check_predictor(
        lambda: load()[1], name, place, asked.cases, asked.limit, with_modes, _tolerance(), limited
    )
    return name, points


def _metric(asked: _Asked) -> tuple[str, list[Point]]:
    from crowdbench.catalog import load_metric
    from crowdbench.evaluate.check import check_metric

    asked.without_options("metric")
    name, _ = load_metric(asked.plugin)
    return name, check_metric(lambda: load_metric(asked.plugin)[1], name, asked.place(), asked.cases)


def _layout(asked: _Asked) -> tuple[str, list[Point]]:
    from crowdbench.catalog import load_layout
    from crowdbench.evaluate.check import check_layout
    from crowdbench.scenario.again import LayoutWithAgain

    name, _, digest = load_layout(asked.plugin)
    generator = str(Path.cwd() / asked.plugin) if digest else name
    # As a part of the scenario, so that its options are checked.
    place = asked.place(changes={"layout": {"generator": generator, **asked.options}})
    layout = functools.partial(place.layout, **place.layout_options)
    again = None
    if isinstance(place.layout, LayoutWithAgain):
        again = functools.partial(place.layout.again, **place.layout_options)
    return name, check_layout(layout, name, place, asked.cases, again)


_CHECKS: Mapping[str, Callable[[_Asked], tuple[str, list[Point]]]] = {
    "planners": _planner,
    "pedestrians": _policy,
    "predictors": _predictor,
    "metrics": _metric,
    "layouts": _layout,
}


def _tolerance() -> Tolerance:
    """What may depend on the batch: something only in networks, which are there if the plug-in has imported torch."""
    from crowdbench.evaluate.check.again import EXACT, NETWORKS

    return NETWORKS if "torch" in sys.modules else EXACT
