"""Run CrowdNav (Chen et al. 2019) and its forks on crowdbench: import this file first in `train.py` and `test.py`.

It replaces the modules `gym` and `rvo2`, which need not be installed. `gym.make` returns the `CrowdSim` of the fork
with a compiled step, and installs a batched lookahead in its policies: see `crowd_sim_step` and `batched_lookahead`.
"""

from __future__ import annotations

import importlib
import sys
from types import ModuleType
from typing import Any

import gymnasium
from batched_lookahead import batch_lookahead
from crowd_sim_step import faster
from rvo2_simulator import PyRVOSimulator

_entry_points: dict[str, str] = {}


def register(id: str, entry_point: str, **kwargs: Any) -> None:
    """Store the entry point of an environment, `package.module:Class`."""
    _entry_points[id] = entry_point


def make(id: str, **kwargs: Any) -> Any:
    """Make a registered environment without wrappers; Gymnasium makes all others."""
    if id not in _entry_points:
        return gymnasium.make(id, **kwargs)
    batch_lookahead()
    module, _, name = _entry_points[id].partition(":")
    return faster(getattr(importlib.import_module(module), name))(**kwargs)


def _module(name: str, **contents: Any) -> ModuleType:
    module = sys.modules[name] = ModuleType(name)
    vars(module).update(contents)
    return module


_registration = _module("gym.envs.registration", register=register, make=make)
_envs = _module("gym.envs", registration=_registration)
_module("gym", **{**vars(gymnasium), "__name__": "gym", "envs": _envs, "register": register, "make": make})
sys.modules |= {"gym.spaces": gymnasium.spaces, "gym.utils": gymnasium.utils}
_module("rvo2", PyRVOSimulator=PyRVOSimulator)
