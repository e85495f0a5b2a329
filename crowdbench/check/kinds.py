"""The kinds of plug-ins: how one is found by its name or in a file, and how it is checked."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from crowdbench import catalog
from crowdbench.check.contract import Subject
from crowdbench.check.subjects import (
    MetricSubject,
    PlannerSubject,
    PolicySubject,
    PredictorSubject,
    RewardSubject,
    ScenarioSubject,
)
from crowdbench.envs.rewards import REWARDS
from crowdbench.metrics.load import METRIC
from crowdbench.plugins.load import Kind, file_and_function, load_module
from crowdbench.plugins.options import read_options
from crowdbench.predict.load import PREDICTORS
from crowdbench.scenario.scenario import Scenario
from crowdbench.utils.errors import InputError

KINDS: Mapping[str, Kind] = {
    "planners": catalog.PLANNERS,
    "pedestrians": catalog.PEDESTRIANS,
    "predictors": PREDICTORS,
    "metrics": METRIC,
    "layouts": catalog.LAYOUTS,
    "rewards": REWARDS,
}
"""The kinds by the names that `crowdbench check --kind` and `crowdbench list` know them by."""


def limited_sight(dt: float) -> dict[str, Any]:
    """Return what changes in a scenario with steps of `dt` seconds so that the vehicle does not see everybody."""
    noise = {"position": 0.05, "velocity": 0.1}
    return {"sensor": {"range": 3.0, "occlusion": True, "noise": noise, "missed": 0.1, "delay": dt, "remember": 1.0}}


SUBJECTS: Mapping[str, type[Subject[Any]]] = {
    "planners": PlannerSubject,
    "pedestrians": PolicySubject,
    "predictors": PredictorSubject,
    "metrics": MetricSubject,
    "layouts": ScenarioSubject,
    "rewards": RewardSubject,
    "scenarios": ScenarioSubject,
}
"""What `crowdbench check` can check: plug-ins, and scenarios, which are no functions."""


def load_subject(
    kind: str, plugin: str, options: Mapping[str, Any], scenario: str | None, limit: float, data: Path | None
) -> Subject[Any]:
    """Load a plug-in that is to be checked.

    Args:
        kind: A key of `SUBJECTS`.
        plugin: Its name, `file.py` or `file.py:function`.
        options: Its options.
        scenario: Name or file of the scenario; None for the one that its kind is checked in.
        limit: Seconds that it may take for one answer.
        data: The folder with the recorded tracks that the scenario needs, if any.

    Raises:
        InputError: It cannot be loaded, or its kind has no options.
    """
    if kind in ("pedestrians", "metrics", "rewards") and options:
        raise InputError(f"--option does not go with a {KINDS[kind].word}, which has no options")
    if kind == "scenarios" and (options or scenario is not None):
        raise InputError("a scenario is checked as its file says: leave out --option and --scenario")

    def load(**more: Any) -> tuple[str, Any]:
        find = catalog.load_planner if kind == "planners" else KINDS[kind].load
        return find(plugin, {**options, **more})

    def place(changes: Mapping[str, Any] = MappingProxyType({})) -> Scenario:
        default = "circle_crossing_5" if kind == "planners" else "circle_crossing_mixed"
        named = plugin if kind == "scenarios" else scenario
        if kind == "layouts":  # as a part of the scenario, so that its options are checked
            changes = {"layout": dict(options), "layout.generator": plugin}
        if named is None and kind != "planners":
            changes = {"vehicle.visible": True, **changes}
        pedestrians = plugin if kind == "pedestrians" else None
        loaded = catalog.load_scenario(named or default, changes, pedestrians, data)
        loaded.check_data(data)
        return loaded

    more: dict[str, Any] = {}
    if kind in ("planners", "predictors"):
        more["limited"] = place(limited_sight(place().rules.dt))
    if kind == "predictors":
        for option in read_options(PREDICTORS.find(plugin)[1]):
            if option.name == "modes":
                more["modes"] = options.get("modes", option.default), lambda modes: load(modes=modes)[1]
    if kind in ("layouts", "scenarios"):
        name = place().name if kind == "scenarios" else catalog.LAYOUTS.find(plugin)[0]
        return ScenarioSubject(place, name, place(), limit)
    return SUBJECTS[kind](lambda: load()[1], load()[0], place(), limit, **more)


def find_kind(plugin: str) -> str:
    """What a file defines, by its name in `SUBJECTS`; planners for a name, and for a function of another name."""
    if plugin.endswith(".toml"):
        return "scenarios"
    file, function = file_and_function(plugin)
    functions = {kind: each.function for kind, each in KINDS.items()}
    if file is None:
        return "planners"
    if function:
        return next((kind for kind, name in functions.items() if name == function), "planners")
    module = load_module(file)
    kinds = [kind for kind, name in functions.items() if callable(getattr(module, name, None))]
    if len(kinds) == 1:
        return kinds[0]
    if not kinds:
        *others, last = (f"{name}()" for name in functions.values())
        raise InputError(f"{file} defines no function {', '.join(others)} or {last}")
    found = " and ".join(f"{functions[kind]}()" for kind in kinds)
    raise InputError(f"{file} defines {found}: say which is meant, with --kind {' or --kind '.join(kinds)}")
