"""crowdbench: the benchmark for navigation in crowds.

The names below are the public ones. They are imported when first used, so that `import crowdbench` and
the command line start at once. `crowdbench/Vehicle-v0` is registered with Gymnasium right away.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

from crowdbench.envs import registration

if TYPE_CHECKING:
    from crowdbench.cases import Cases
    from crowdbench.catalog import load_network, load_planner, load_predictor, load_scenario
    from crowdbench.driver import Driver
    from crowdbench.envs.observations import flatten
    from crowdbench.envs.parallel import parallel_env
    from crowdbench.errors import InputError
    from crowdbench.lookahead import ValuePlanner
    from crowdbench.metrics import METRICS
    from crowdbench.planner import OneWorldPlanner, Planner
    from crowdbench.predict import Prediction, Predictor
    from crowdbench.rollouts import rollout
    from crowdbench.scenario import Scenario
    from crowdbench.sim.pedestrians import PedestrianPolicy
    from crowdbench.types import Observation, Outcome, Rules, Trace, World

registration.register()

_HOMES = {
    "Cases": "cases",
    "Driver": "driver",
    "InputError": "errors",
    "METRICS": "metrics",
    "Observation": "types",
    "OneWorldPlanner": "planner",
    "Outcome": "types",
    "PedestrianPolicy": "sim.pedestrians",
    "Planner": "planner",
    "Prediction": "predict",
    "Predictor": "predict",
    "Rules": "types",
    "Scenario": "scenario",
    "Trace": "types",
    "ValuePlanner": "lookahead",
    "World": "types",
    "flatten": "envs.observations",
    "load_network": "catalog",
    "load_planner": "catalog",
    "load_predictor": "catalog",
    "load_scenario": "catalog",
    "parallel_env": "envs.parallel",
    "rollout": "rollouts",
}

__all__ = [
    "METRICS",
    "Cases",
    "Driver",
    "InputError",
    "Observation",
    "OneWorldPlanner",
    "Outcome",
    "PedestrianPolicy",
    "Planner",
    "Prediction",
    "Predictor",
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
]


def __getattr__(name: str) -> object:
    if name in _HOMES:
        return getattr(importlib.import_module(f"crowdbench.{_HOMES[name]}"), name)
    raise AttributeError(f"module 'crowdbench' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
