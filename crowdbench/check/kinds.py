"""The kinds of plug-ins: how one is found, by what name in a file, and what checks whether it keeps its contract."""

from __future__ import annotations

import dataclasses
import functools
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

from crowdbench import catalog
from crowdbench.check.examination import EXACT, NETWORKS, Tolerance
from crowdbench.check.layout import check_layout
from crowdbench.check.metric import check_metric
from crowdbench.check.planner import check_planner
from crowdbench.check.policy import check_policy
from crowdbench.check.predictor import check_predictor
from crowdbench.check.result import CheckResult
from crowdbench.check.reward import check_reward
from crowdbench.check.scenario import check_scenario
from crowdbench.envs.rewards import REWARDS, load_reward
from crowdbench.metrics.load import METRIC
from crowdbench.plugins.load import Kind, file_and_function, load_module
from crowdbench.plugins.options import read_options
from crowdbench.predict.load import PREDICTORS
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario
from crowdbench.utils.errors import InputError


def limited_sight(dt: float) -> dict[str, Any]:
    """Return what changes in a scenario with steps of `dt` seconds so that the vehicle does not see everybody."""
    noise = {"position": 0.05, "velocity": 0.1}
    return {"sensor": {"range": 3.0, "occlusion": True, "noise": noise, "missed": 0.1, "delay": dt, "remember": 1.0}}


@dataclass(frozen=True)
class CheckRequest:
    """Which plug-in is to be checked, and how.

    Attributes:
        plugin: Its name, `file.py` or `file.py:function`.
        options: Its options.
        scenario: Name or file of the scenario; None for the one that its kind is checked in.
        cases: The cases of the scenario.
        limit: Seconds that it may take for one answer.
        data: The folder with the recorded tracks that the scenario needs, if any.
    """

    plugin: str
    options: Mapping[str, Any]
    scenario: str | None
    cases: Cases
    limit: float
    data: Path | None

    def load_scenario(
        self, changes: Mapping[str, Any] = MappingProxyType({}), pedestrians: str | None = None
    ) -> Scenario:
        """The scenario with changed keys; where none is given, one with crowds of several sizes that see the vehicle.

        Args:
            changes: Other values for keys of the scenario.
            pedestrians: The policy that moves all pedestrians, if not the scenario's.
        """
        if self.scenario is None:
            changes = {"vehicle.visible": True, **changes}
        scenario = catalog.load_scenario(self.scenario or "circle_crossing_mixed", changes, pedestrians, self.data)
        scenario.check_data(self.data)
        return scenario

    def load_with_limited_sight(self) -> tuple[Scenario, Scenario]:
        """Return the scenario, and the same with limited sight."""
        scenario = self.load_scenario()
        return scenario, self.load_scenario(limited_sight(scenario.rules.dt))

    def load(self, kind: Kind, **more: Any) -> tuple[str, Callable[[], Any]]:
        """The plug-in's name, and what makes a new one, with more options if any."""
        load = functools.partial(kind.load, self.plugin, {**self.options, **more})
        return load()[0], lambda: load()[1]

    def refuse_options(self, kind: Kind) -> None:
        """Raises InputError where options are given."""
        if self.options:
            raise InputError(f"--option does not go with a {kind.word}, which has no options")


@dataclass(frozen=True)
class PluginKind:
    """A kind of plug-in.

    Attributes:
        plugins: Finds one by its name or in a file.
        check: Checks whether one keeps its contract: returns its name, and the results.
    """

    plugins: Kind
    check: Callable[[CheckRequest], tuple[str, list[CheckResult]]]


def _check_planner(request: CheckRequest) -> tuple[str, list[CheckResult]]:
    request = dataclasses.replace(request, scenario=request.scenario or "circle_crossing_5")
    scenario, limited = request.load_with_limited_sight()
    load = functools.partial(catalog.load_planner, request.plugin, request.options)
    name, _ = load()
    return name, check_planner(lambda: load()[1], name, scenario, request.cases, request.limit, limited)


def _check_policy(request: CheckRequest) -> tuple[str, list[CheckResult]]:
    request.refuse_options(catalog.PEDESTRIANS)
    name, make = request.load(catalog.PEDESTRIANS)
    scenario = request.load_scenario(pedestrians=request.plugin)
    return name, check_policy(make, name, scenario, request.cases, request.limit, _tolerance())


def _check_predictor(request: CheckRequest) -> tuple[str, list[CheckResult]]:
    name, make = request.load(PREDICTORS)
    has_modes = any(option.name == "modes" for option in read_options(PREDICTORS.find(request.plugin)[1]))
    with_modes = (lambda modes: request.load(PREDICTORS, modes=modes)[1]()) if has_modes else None
    scenario, limited = request.load_with_limited_sight()
    return name, check_predictor(make, name, scenario, request.cases, request.limit, with_modes, _tolerance(), limited)


def _check_metric(request: CheckRequest) -> tuple[str, list[CheckResult]]:
    request.refuse_options(METRIC)
    name, make = request.load(METRIC)
    return name, check_metric(make, name, request.load_scenario(), request.cases)


def _check_layout(request: CheckRequest) -> tuple[str, list[CheckResult]]:
    name, _ = request.load(catalog.LAYOUTS)
    # As a part of the scenario, so that its options are checked.
    scenario = request.load_scenario({"layout": dict(request.options), "layout.generator": request.plugin})
    assert scenario.layout is not None  # a scenario with recorded people would have refused the changes
    return name, check_layout(scenario.layout, name, scenario, request.cases)


def _check_reward(request: CheckRequest) -> tuple[str, list[CheckResult]]:
    request.refuse_options(REWARDS)
    reward = load_reward(request.plugin)
    return reward.name, check_reward(lambda: reward.reward, reward.name, request.load_scenario(), request.cases)


def _check_scenario(request: CheckRequest) -> tuple[str, list[CheckResult]]:
    if request.options or request.scenario is not None:
        raise InputError("a scenario is checked as its file says: leave out --option and --scenario")
    scenario = dataclasses.replace(request, scenario=request.plugin).load_scenario()
    return scenario.name, check_scenario(scenario, request.cases)


def _tolerance() -> Tolerance:
    """What may depend on the batch: something only in networks, which are there if the plug-in has imported torch."""
    return NETWORKS if "torch" in sys.modules else EXACT


KINDS: Mapping[str, PluginKind] = {
    "planners": PluginKind(catalog.PLANNERS, _check_planner),
    "pedestrians": PluginKind(catalog.PEDESTRIANS, _check_policy),
    "predictors": PluginKind(PREDICTORS, _check_predictor),
    "metrics": PluginKind(METRIC, _check_metric),
    "layouts": PluginKind(catalog.LAYOUTS, _check_layout),
    "rewards": PluginKind(REWARDS, _check_reward),
}
"""The kinds by the names that `crowdbench check --kind` and `crowdbench list` know them by."""

CHECKS = {name: kind.check for name, kind in KINDS.items()} | {"scenarios": _check_scenario}
"""What `crowdbench check` can check: plug-ins, and scenarios, which are no functions."""


def find_kind(plugin: str) -> str:
    """What a file defines, by its name in `CHECKS`; planners for a name, and for a function of another name."""
    if plugin.endswith(".toml"):
        return "scenarios"
    file, function = file_and_function(plugin)
    functions = {kind: each.plugins.function for kind, each in KINDS.items()}
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
