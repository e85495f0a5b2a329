"""crowdbench: the benchmark for navigation in crowds.

The names below are the public ones. They are imported when first used, so that `import crowdbench` and
the command line start at once. `crowdbench/Vehicle-v0` is registered with Gymnasium right away.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

from crowdbench.envs import registration

if TYPE_CHECKING:
    from crowdbench.catalog import load_planner, load_scenario
    from crowdbench.envs.observations import flatten
    from crowdbench.envs.parallel import parallel_env
    from crowdbench.errors import InputError
    from crowdbench.evaluate.driver import Driver
    from crowdbench.evaluate.metrics import METRICS
    from crowdbench.evaluate.results import Episodes
    from crowdbench.evaluate.rollout import rollout
    from crowdbench.notebook import Result, run
    from crowdbench.planners.base import OneWorldPlanner, Planner
    from crowdbench.planners.lookahead import ValuePlanner
    from crowdbench.predict import Prediction, Predictor
    from crowdbench.predict.load import load_predictor
    from crowdbench.scenario.cases import Cases
    from crowdbench.scenario.scenario import Scenario
    from crowdbench.sim.pedestrians import PedestrianPolicy, PolicyWithMemory
    from crowdbench.types import Observation, Outcome, Rules, Trace, World
    from crowdbench.value.networks import load_network

registration.register()

_HOMES = {
    "Cases": "scenario.cases",
    "Driver": "evaluate.driver",
    "Episodes": "evaluate.results",
    "InputError": "errors",
    "METRICS": "evaluate.metrics",
    "Observation": "types",
    "OneWorldPlanner": "planners.base",
    "Outcome": "types",
    "PedestrianPolicy": "sim.pedestrians",
    "Planner": "planners.base",
    "PolicyWithMemory": "sim.pedestrians",
    "Prediction": "predict",
    "Predictor": "predict",
    "Result": "notebook",
    "Rules": "types",
    "Scenario": "scenario.scenario",
    "Trace": "types",
    "ValuePlanner": "planners.lookahead",
    "World": "types",
    "flatten": "envs.observations",
    "load_network": "value.networks",
    "load_planner": "catalog",
    "load_predictor": "predict.load",
    "load_scenario": "catalog",
    "parallel_env": "envs.parallel",
    "rollout": "evaluate.rollout",
    "run": "notebook",
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
