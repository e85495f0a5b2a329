"""The kinds of plug-ins, with the loading and the check of each kind."""

from __future__ import annotations

import copy
import functools
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from crowdbench import catalog
from crowdbench.check import drives
from crowdbench.check.checks import Procedure, Subject
from crowdbench.envs.rewards import REWARDS
from crowdbench.metrics.user_metrics import METRIC
from crowdbench.plugins.kind import Kind, file_and_function, load_module, plugin_name
from crowdbench.predict.predictors import PREDICTORS
from crowdbench.utils.errors import InputError

KINDS: Mapping[str, Kind] = {
    "planners": catalog.PLANNERS,
    "pedestrians": catalog.PEDESTRIANS,
    "predictors": PREDICTORS,
    "metrics": METRIC,
    "layouts": catalog.LAYOUTS,
    "rewards": REWARDS,
}
"""The kinds by their names in `crowdbench check --kind` and `crowdbench list`."""


def limited_sight(dt: float) -> dict[str, Any]:
    """Return the changes of a scenario with steps of `dt` seconds that limit the vehicle's sensor."""
    noise = {"position": 0.05, "velocity": 0.1}
    return {"sensor": {"range": 3.0, "occlusion": True, "noise": noise, "missed": 0.1, "delay": dt, "remember": 1.0}}


PROCEDURES: Mapping[str, Procedure] = {
    "planners": drives.PLANNER,
    "pedestrians": drives.POLICY,
    "predictors": drives.PREDICTOR,
    "metrics": drives.METRIC,
    "layouts": drives.SCENARIO,
    "rewards": drives.REWARD,
    "scenarios": drives.SCENARIO,
}
"""Procedures of `crowdbench check` for plug-ins, and for scenarios, which are not functions."""


def load_subject(
    kind: str, plugin: str, options: Mapping[str, Any], scenario: str | None, limit: float, data: Path | None
) -> Subject:
    """Load a plug-in that is to be checked.

    Args:
        kind: A key of `PROCEDURES`.
        plugin: Its name, `file.py` or `file.py:function`.
        scenario: Name or file of the scenario; None for the default scenario of its kind.
        limit: Seconds that it may take for one answer.
        data: The folder with the recorded tracks that the scenario needs, if any.

    Raises:
        InputError: It cannot be loaded, or its kind has no options.
    """
    if kind in ("pedestrians", "metrics", "rewards") and options:
        raise InputError(f"--option does not go with a {KINDS[kind].word}, which has no options")
    if kind == "scenarios" and (options or scenario is not None):
        raise InputError("a scenario is checked as its file says: leave out --option and --scenario")

    spec = scenario
    changes: dict[str, Any] = {}
    if kind == "scenarios":
        spec = plugin
    elif spec is None and kind == "planners":
        spec = "circle_crossing_5"
    elif spec is None:
        spec, changes = "circle_crossing_mixed", {"vehicle.visible": True}
    if kind == "layouts":  # as a part of the scenario, so that its options are checked
        changes |= {"layout": dict(options), "layout.generator": plugin}
        if scenario is None:  # so that it also places pedestrians later
            changes["pedestrians.arrival"] = "respawn"
    policy = plugin if kind == "pedestrians" else None
    load_scenario = functools.partial(catalog.load_scenario, spec, pedestrians=policy, data=data)
    scenarios = {"": load_scenario(copy.deepcopy(changes))}  # a copy, because loading replaces a map by its obstacles
    scenarios[""].check_data(data)
    if kind in ("planners", "predictors"):
        scenarios["with limited sight: "] = load_scenario(changes | limited_sight(scenarios[""].rules.dt))
    if kind == "pedestrians":
        scenarios["invisible vehicle: "] = load_scenario(changes | {"vehicle.visible": False})
    name = scenarios[""].name if kind == "scenarios" else plugin_name(plugin)
    if kind in ("layouts", "scenarios"):
        return Subject(PROCEDURES[kind], lambda: load_scenario(copy.deepcopy(changes)), name, scenarios, limit)
    if kind == "planners":
        return Subject(PROCEDURES[kind], lambda: catalog.load_planner(plugin, options), name, scenarios, limit)
    return Subject(PROCEDURES[kind], lambda: KINDS[kind].load(plugin, options)[1], name, scenarios, limit)


def find_kind(plugin: str) -> str:
    """Return the kind of a plug-in, as in `PROCEDURES`; planners for a name, or for a function of another name."""
    if plugin.endswith(".toml"):
        return "scenarios"
    file, function = file_and_function(plugin)
    functions = {definition.function: kind for kind, definition in KINDS.items()}
    if file is None or function or file.suffix != ".py":
        return functions.get(function, "planners")
    module = load_module(file)
    defined = [name for name in functions if callable(getattr(module, name, None))]
    if not defined:
        *others, last = functions
        raise InputError(f"{file} defines no function {'(), '.join(others)}() or {last}()")
    kinds = [functions[name] for name in defined]
    if len(kinds) > 1:
        options = f"--kind {' or --kind '.join(kinds)}"
        raise InputError(f"{file} defines {'() and '.join(defined)}(): say which is meant, with {options}")
    return kinds[0]
