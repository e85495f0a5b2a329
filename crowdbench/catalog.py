"""Names to things: planners, pedestrian policies and scenarios, built in, installed, or in the user's files."""

from __future__ import annotations

import ast
import importlib.metadata
import importlib.util
import inspect
import tomllib
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

from crowdbench import scenario_file
from crowdbench.errors import InputError
from crowdbench.metrics import METRICS, Metric
from crowdbench.planner import Planner
from crowdbench.scenario import Scenario
from crowdbench.sim.pedestrians import PedestrianPolicy

_PACKAGE = Path(__file__).parent
# In a wheel the plug-in folders lie inside the package, in a checkout beside it.
_ROOT = _PACKAGE if (_PACKAGE / "agents").is_dir() else _PACKAGE.parent

FOLDERS = {
    "planners": _ROOT / "agents" / "planners",
    "pedestrians": _ROOT / "agents" / "pedestrians",
    "scenarios": _ROOT / "scenarios",
}
"""Where the built-in things of each kind lie, one file each."""

WORDS = {"planners": "planner", "pedestrians": "pedestrian policy"}


def load_planner(spec: str, options: Mapping[str, Any] | None = None) -> tuple[str, Planner]:
    """A planner's name and the planner, from a name, `file.py` or `file.py:factory`.

    Raises InputError where there is none, where it does not take the options, or where its file is broken.
    """
    name, factory = _factory("planners", "planner", spec)
    made = _call(name, factory, dict(options or {}))
    if not isinstance(made, Planner):
        raise InputError(f"{spec}: the factory made a {type(made).__name__}, but must make a crowdbench.Planner")
    return name, made


def load_policy(spec: str) -> tuple[str, PedestrianPolicy]:
    """A pedestrian policy's name and the policy, found as planners are, by a factory `policy`."""
    name, factory = _factory("pedestrians", "policy", spec)
    made = _call(name, factory, {})
    if not isinstance(made, PedestrianPolicy):
        raise InputError(
            f"{spec}: the factory made a {type(made).__name__}, but must make a crowdbench.PedestrianPolicy"
        )
    return name, made


def load_metrics(specs: Iterable[str]) -> dict[str, Metric]:
    """The built-in metrics and those of `file.py` (its function `metric`) or `file.py:function`."""
    metrics = dict(METRICS)
    for spec in specs:
        file, _, function = spec.partition(":")
        metric = getattr(load_module(Path(file)), function or "metric", None)
        if not callable(metric):
            raise InputError(f"{file} defines no function {function or 'metric'}(trace)")
        name = function or Path(file).stem
        if name in metrics:
            raise InputError(f"{spec}: a metric called {name} exists already: give it another name")
        metrics[name] = metric
    return metrics


def load_scenario(spec: str, overrides: Mapping[str, Any] | None = None, pedestrians: str | None = None) -> Scenario:
    """A scenario by name or path, with dotted keys overridden: `{"vehicle.visible": True}`.

    `pedestrians` puts one policy in the place of the scenario's own, and of what it sets for them.
    """
    path = Path(spec) if spec.endswith(".toml") else FOLDERS["scenarios"] / f"{spec}.toml"
    if not spec.endswith(".toml") and not path.is_file():
        raise InputError(
            f"no scenario is called {spec!r}; there are {_known('scenarios')}, or give a file: ./mine.toml"
        )
    table = scenario_file.read_table(path)
    if pedestrians is not None:
        crowd = table.get("pedestrians", {})
        own = [key for key, value in crowd.items() if isinstance(value, dict) and "mean" not in value]
        table["pedestrians"] = {key: crowd[key] for key in crowd if key not in own} | {"policy": pedestrians}
    for key, value in (overrides or {}).items():
        _set(table, key, value, path)
    return scenario_file.parse(table, path.stem, str(path) if spec.endswith(".toml") else path.name, load_policy)


def listing(kind: str) -> list[tuple[str, str]]:
    """Name and one line of description of everything of a kind that is built in or installed."""
    if kind == "scenarios":
        files = sorted(FOLDERS[kind].glob("*.toml"))
        return [(path.stem, str(scenario_file.read_table(path).get("description", ""))) for path in files]
    built_in = [(path.stem, _first_line(path)) for path in sorted(FOLDERS[kind].glob("*.py"))]
    return built_in + [(entry.name, f"installed: {entry.value}") for entry in _entry_points(kind)]


def assignments(texts: Iterable[str], flag: str) -> dict[str, Any]:
    """Read `key=value` texts; a value is TOML, or else a bare text. Raises InputError where there is no `=`."""
    pairs = {}
    for text in texts:
        key, equals, value = text.partition("=")
        if not equals or not key.strip():
            raise InputError(f"{flag} {text!r} sets nothing: write {flag} key=value")
        try:
            pairs[key.strip()] = tomllib.loads(f"value = {value}")["value"]
        except tomllib.TOMLDecodeError:
            pairs[key.strip()] = value
    return pairs


def load_module(path: Path) -> ModuleType:
    """Run a user's Python file as a module. Raises InputError where it does not exist or fails."""
    if not path.is_file():
        raise InputError(f"there is no file {path}")
    spec = importlib.util.spec_from_file_location(f"crowdbench_plugin_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise InputError(f"{path} is not a Python file: its name must end in .py")
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        raise InputError(f"{path} cannot be loaded: {type(error).__name__}: {error}") from error
    return module


def _factory(kind: str, default: str, spec: str) -> tuple[str, Callable[..., object]]:
    """The name and the factory function that a spec stands for."""
    file, _, function = spec.partition(":")
    if file.endswith(".py"):
        path = Path(file)
    elif (FOLDERS[kind] / f"{spec}.py").is_file():
        path = FOLDERS[kind] / f"{spec}.py"
    else:
        for entry in _entry_points(kind):
            if entry.name == spec:
                return spec, entry.load()
        raise InputError(f"no {WORDS[kind]} is called {spec!r}; there are {_known(kind)}, or give a file: ./mine.py")
    factory = getattr(load_module(path), function or default, None)
    if not callable(factory):
        raise InputError(f"{path} defines no function {function or default}()")
    return function or path.stem, factory


def _call(name: str, factory: Callable[..., object], options: dict[str, Any]) -> object:
    parameters = inspect.signature(factory).parameters
    takes_any = any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters.values())
    for option in options:
        if option not in parameters and not takes_any:
            known = ", ".join(parameters) or "none"
            raise InputError(f"{name} has no option {option!r}; its options are: {known}")
    try:
        return factory(**options)
    except InputError:
        raise
    except Exception as error:
        raise InputError(f"{name} cannot be made with {options}: {type(error).__name__}: {error}") from error


def _set(table: dict[str, Any], key: str, value: Any, path: Path) -> None:
    *sections, last = key.split(".")
    for section in sections:
        table = table.setdefault(section, {})
        if not isinstance(table, dict):
            raise InputError(f"{path.name}: {key} cannot be set, since {section} is not a table")
    table[last] = value


def _entry_points(kind: str) -> list[importlib.metadata.EntryPoint]:
    return sorted(importlib.metadata.entry_points(group=f"crowdbench.{kind}"))


def _known(kind: str) -> str:
    return ", ".join(name for name, _ in listing(kind))


def _first_line(path: Path) -> str:
    # Read, not run: listing the planners must not import what they import.
    docstring = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8")))
    return (docstring or "").partition("\n")[0]
