"""crowdbench: the benchmark for navigation in crowds.

The names below are the public ones. They are imported when first used, so that `import crowdbench` and
the command line start at once. `crowdbench/Vehicle-v0` is registered with Gymnasium right away.
"""

from __future__ import annotations

import ast
import functools
import importlib
from pathlib import Path
from typing import TYPE_CHECKING

from crowdbench import envs

if TYPE_CHECKING:  # the aliases mark the names as public for type checkers and for `public_names`
    from crowdbench.catalog import load_planner as load_planner
    from crowdbench.catalog import load_scenario as load_scenario
    from crowdbench.core.types import Observation as Observation
    from crowdbench.core.types import Outcome as Outcome
    from crowdbench.core.types import Rules as Rules
    from crowdbench.core.types import Trace as Trace
    from crowdbench.core.types import World as World
    from crowdbench.envs.observations import flatten as flatten
    from crowdbench.envs.parallel import parallel_env as parallel_env
    from crowdbench.envs.policy_planner import PolicyPlanner as PolicyPlanner
    from crowdbench.metrics import METRICS as METRICS
    from crowdbench.networks.policy import Encoder as Encoder
    from crowdbench.networks.value import load_network as load_network
    from crowdbench.notebook import Result as Result
    from crowdbench.notebook import run as run
    from crowdbench.planners.base import OneWorldPlanner as OneWorldPlanner
    from crowdbench.planners.base import Planner as Planner
    from crowdbench.planners.driver import Driver as Driver
    from crowdbench.planners.geometry import along_route as along_route
    from crowdbench.planners.geometry import distance_to_walls as distance_to_walls
    from crowdbench.planners.lookahead import ValuePlanner as ValuePlanner
    from crowdbench.planners.mppi import MPPIPlanner as MPPIPlanner
    from crowdbench.planners.reactive import along_walls as along_walls
    from crowdbench.predict import Prediction as Prediction
    from crowdbench.predict import Predictor as Predictor
    from crowdbench.predict.load import load_predictor as load_predictor
    from crowdbench.predict.roll_out import roll_out as roll_out
    from crowdbench.runs.results import Episodes as Episodes
    from crowdbench.runs.rollout import rollout as rollout
    from crowdbench.scenario.cases import Cases as Cases
    from crowdbench.scenario.scenario import Scenario as Scenario
    from crowdbench.sim.pedestrians.base import PedestrianPolicy as PedestrianPolicy
    from crowdbench.sim.pedestrians.base import PolicyWithMemory as PolicyWithMemory
    from crowdbench.sim.pedestrians.orca_crowd import ORCA as ORCA
    from crowdbench.train.policy_export import export_policy as export_policy
    from crowdbench.utils.errors import InputError as InputError

envs.register()


@functools.cache
def public_names() -> dict[str, str]:
    """Return the module of each public name, from the imports above."""
    tree = ast.parse(Path(__file__).read_bytes())
    imports = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    return {str(alias.asname): str(node.module) for node in imports for alias in node.names if alias.asname}


__all__ = sorted(public_names())


def __getattr__(name: str) -> object:
    if name in __all__:
        return getattr(importlib.import_module(public_names()[name]), name)
    raise AttributeError(f"module 'crowdbench' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
