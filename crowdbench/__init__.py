"""crowdbench: the benchmark for navigation in crowds.

The names below are the public ones. They are imported when first used, so that `import crowdbench` and
the command line start at once. `crowdbench/Vehicle-v0` is registered with Gymnasium right away.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

from crowdbench import envs

if TYPE_CHECKING:
    from crowdbench.catalog import load_planner, load_scenario
    from crowdbench.core.types import Observation, Outcome, Rules, Trace, World
    from crowdbench.envs.observations import flatten
    from crowdbench.envs.parallel import parallel_env
    from crowdbench.metrics import METRICS
    from crowdbench.networks.value import load_network
    from crowdbench.planners.base import OneWorldPlanner, Planner
    from crowdbench.planners.driver import Driver
    from crowdbench.planners.lookahead import ValuePlanner
    from crowdbench.predict import Prediction, Predictor
    from crowdbench.predict.load import load_predictor
    from crowdbench.runs.api import Result, run
    from crowdbench.runs.results import Episodes
    from crowdbench.runs.rollout import rollout
    from crowdbench.scenario.cases import Cases
    from crowdbench.scenario.scenario import Scenario
    from crowdbench.sim.pedestrians import PedestrianPolicy, PolicyWithMemory
    from crowdbench.utils.errors import InputError

envs.register()

_HOMES = {
    "Cases": "scenario.cases",
    "Driver": "planners.driver",
    "Episodes": "runs.results",
    "InputError": "utils.errors",
    "METRICS": "metrics",
    "Observation": "core.types",
    "OneWorldPlanner": "planners.base",
    "Outcome": "core.types",
    "PedestrianPolicy": "sim.pedestrians.base",
    "Planner": "planners.base",
    "PolicyWithMemory": "sim.pedestrians.base",
    "Prediction": "predict",
    "Predictor": "predict",
    "Result": "runs.api",
    "Rules": "core.types",
    "Scenario": "scenario.scenario",
    "Trace": "core.types",
    "ValuePlanner": "planners.lookahead",
    "World": "core.types",
    "flatten": "envs.observations",
    "load_network": "networks.value",
    "load_planner": "catalog",
    "load_predictor": "predict.load",
    "load_scenario": "catalog",
    "parallel_env": "envs.parallel",
    "rollout": "runs.rollout",
    "run": "runs.api",
}

__all__ = [
    "METRICS",
    "Cases",
    "Driver",
    "Episodes",
    "InputError",
    "Observation",
    "OneWorldPlanner",
    "Outcome",
    "PedestrianPolicy",
    "Planner",
    "PolicyWithMemory",
    "Prediction",
    "Predictor",
    "Result",
    "Rules",
    "Scenario",
    "Trace",
    "ValuePlanner",
    "World",
    "flatten",
    "load_network",
    "load_planner",
    "load_predictor",
    "load_scenario",
    "parallel_env",
    "rollout",
    "run",
]


def __getattr__(name: str) -> object:
    if name in _HOMES:
        return getattr(importlib.import_module(f"crowdbench.{_HOMES[name]}"), name)
    raise AttributeError(f"module 'crowdbench' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
