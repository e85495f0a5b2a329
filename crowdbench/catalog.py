"""Loads planners, pedestrian policies, layouts and scenarios by name: built in, installed, or in a user's files."""

from __future__ import annotations

import dataclasses
import functools
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

from crowdbench.planners.planner import Planner
from crowdbench.plugins.kind import ROOT, Kind, file_and_function
from crowdbench.plugins.plugin_files import read_files
from crowdbench.scenario import layouts, scenario_file
from crowdbench.scenario.scenario import Scenario
from crowdbench.scenario.schema import NamesSpec, SimulatedPedestriansSpec
from crowdbench.sim.pedestrians import PedestrianPolicy
from crowdbench.utils.assignments import read_overrides
from crowdbench.utils.errors import InputError, find_named, is_number, require, require_options
from crowdbench.utils.resources import plugin_in_time
from crowdbench.utils.toml import Location, parse_table, read_toml

SCENARIOS = ROOT / "scenarios"

SUITE = SCENARIOS / "suite" / "suite.toml"
"""The list of the scenarios of the suite."""


@dataclasses.dataclass(frozen=True)
class Suite:
    """The suite: its version, and the names of its scenarios.

    Attributes:
        version: The name of the version. Scores of different versions are never compared.
        ranked: Scenarios whose scores have a mean.
        stress: Scenarios whose pedestrians do not see the vehicle.
        held_out: Scenarios outside of the range of all trainings.
    """

    version: str
    ranked: Sequence[str]
    stress: Sequence[str]
    held_out: Sequence[str]


def _check_parameters(name: str, policy: PedestrianPolicy) -> None:
    """Raise InputError unless the parameters of a pedestrian policy are numbers by name."""
    with plugin_in_time(f"the parameters of {name} cannot be read:"):
        parameters = dict(policy.parameters)
    for key, value in parameters.items():
        if not isinstance(key, str) or not is_number(value):
            right = "parameters are numbers by name, such as {'pace': 0.5}"
            raise InputError(f"the pedestrian policy {name} has the parameter {key!r} with {value!r}: {right}")


PLANNERS = Kind(
    "planner",
    "planner",
    folder=ROOT / "agents" / "planners",
    entry_points="crowdbench.planners",
    makes=Planner,
    reader=EntryPoint("onnx", "crowdbench.planners.onnx_policy:load_onnx", "crowdbench.planners"),
)
PEDESTRIANS = Kind(
    "pedestrian policy",
    "policy",
    folder=ROOT / "agents" / "pedestrians",
    entry_points="crowdbench.pedestrians",
    makes=PedestrianPolicy,
    validate=_check_parameters,
)
LAYOUTS = Kind("layout", "layout", layouts.LAYOUTS, SCENARIOS, "crowdbench.layouts")

PluginWithDigest = tuple[str, Any, str | None]
"""Name, plug-in, and the digest of its file."""


def load_planner(spec: str, options: Mapping[str, Any] | None = None) -> Planner:
    """Find a planner and construct it.

    Args:
        spec: The name of a built-in or installed planner, `file.py`, `file.py:function` or `policy.onnx`.
        options: Arguments of the planner's function, as they are written in TOML.

    Raises:
        InputError: There is no such planner, it does not take the options, or its file is broken.
    """
    require("planner", spec, isinstance(spec, str), "a name, or a file such as './mine.py'")
    require_options(options)
    planner: Planner = PLANNERS.load(spec, dict(options or {}))[1]
    return planner


def planner_files(spec: str, options: Mapping[str, Any]) -> dict[str, dict[str, str]]:
    """Return the sha256 of every file outside of the package crowdbench that a planner depends on.

    Args:
        spec: Name or file of an existing planner, as for `load_planner`.
        options: The planner's options.

    Returns:
        Digests by path, for each source. `planner` has the planner's Python files. `option weights` and other options
        have the files that the option names, such as weights with their card, or a predictor's file with its imports.
    """
    files = {"planner": PLANNERS.files(spec)}
    for name, value in options.items():
        digests = [read_files(path) for path in _named_files(value)]
        if digests:
            files[f"option {name}"] = {path: digest for part in digests for path, digest in part.items()}
    return files


def _named_files(value: Any) -> Iterator[Path]:
    """Yield the files named in the value of an option: a text, or a table or list that contains texts."""
    if isinstance(value, Mapping | list):
        for item in value.values() if isinstance(value, Mapping) else value:
            yield from _named_files(item)
    elif isinstance(value, str):
        weights = ROOT / "agents" / "weights" / f"{value}.safetensors"
        paths = weights, file_and_function(value)[0] or Path(value)
        yield from [path for path in paths if os.path.isfile(path)][:1]  # also False for an invalid path


def load_scenario(
    spec: str,
    overrides: Mapping[str, Any] | Sequence[str] | None = None,
    pedestrians: str | None = None,
    data: Path | str | None = None,
) -> Scenario:
    """Find a scenario and read it.

    Args:
        spec: The name of a built-in scenario, or `file.toml`.
        overrides: Values for dotted keys of the file, such as `{"vehicle.visible": True}`, or texts such as
            `["vehicle.visible=true"]`.
        pedestrians: A policy for all pedestrians. It replaces the scenario's policy and the parameters of that policy.
        data: The folder with the recorded tracks that the scenario's `[tracks]` needs.

    Returns:
        The scenario.

    Raises:
        InputError: There is no such scenario, or something in it is wrong.
    """
    require("scenario", spec, isinstance(spec, str), "a name, or a file such as './mine.toml'")
    require("pedestrians", pedestrians, isinstance(pedestrians, str | None), "a name, or a file such as './mine.py'")
    require("data", data, isinstance(data, Path | str | None), "the folder with recorded tracks")
    changes = read_overrides(overrides)
    path = scenario_path(spec)
    table = read_toml(path, "scenario")
    table.pop("dial", None)  # variations of the scenario: see studies/dials
    crowd = table.get("pedestrians", {})
    if pedestrians is not None and isinstance(crowd, dict):
        table["pedestrians"] = {key: crowd[key] for key in crowd if key in SimulatedPedestriansSpec.model_fields}
        table["pedestrians"]["policy"] = _resolve_files(pedestrians)
    for key, value in changes.items():
        set_key(table, key, _resolve_files(value) if key in ("pedestrians.policy", "layout.generator") else value, path)
    _read_map(table.get("layout"), path.parent)
    return scenario_file.parse_scenario(
        table,
        path.stem,
        str(path) if spec.endswith(".toml") else path.name,
        functools.partial(LAYOUTS.load_with_digest, folder=path.parent),
        functools.partial(PEDESTRIANS.load_with_digest, folder=path.parent),
        None if data is None else Path(data),
    )


def _read_map(layout: Any, folder: Path) -> None:
    """Replace a map by its obstacles, so that a run's `result.json` contains them and needs no other file."""
    if isinstance(layout, dict) and layout.get("generator") == "floor_plan" and isinstance(layout.get("map"), str):
        from crowdbench.scenario.occupancy_grid import read_obstacles

        if "obstacles" in layout:
            raise InputError("layout.obstacles is given beside layout.map: leave out one of them")
        layout["obstacles"] = read_obstacles(folder / layout.pop("map"))


def scenario_path(spec: str) -> Path:
    """Return the file of a scenario, given by its name or as `file.toml`. Raises InputError if the name is unknown."""
    if spec.endswith(".toml"):
        return Path(spec)
    files = {path.stem: path for path in _scenario_files()}
    stem, _, number = spec.rpartition("_")
    numbers = [int(name.rpartition("_")[2]) for name in files if re.fullmatch(rf"{re.escape(stem)}_[0-9]+", name)]
    if spec not in files and numbers and re.fullmatch("[0-9]{1,4}", number):
        nearest = f"{stem}_{min(numbers, key=lambda other: abs(other - int(number)))}"
        raise InputError(f"no scenario is called {spec!r}: give {nearest} with --set pedestrians.number={number}")
    return find_named("scenario", spec, files, ".toml")


def load_recorded_scenario(
    table: Mapping[str, Any],
    source: str,
    pedestrians: Iterable[str] = (),
    layout: str | None = None,
    data: Path | None = None,
) -> Scenario:
    """Reconstruct the scenario of a run.

    Only files that the user names are loaded, never files that the run names: the run may come from another person.

    Args:
        table: The table `scenario` of the run's `result.json`.
        source: Name of that file, for errors.
        pedestrians: The files of the user's pedestrian policies in the run.
        layout: The file of the layout, if the run used a layout of the user.
        data: The folder with the recorded tracks, if the run used recorded tracks.

    Returns:
        The scenario.

    Raises:
        InputError: A value of the table is wrong, or the file of the layout or of a policy is missing or differs from
            the run.
    """
    keys = {key: value for key, value in table.items() if key not in ("name", "digest")}
    names = parse_table(NamesSpec, keys, Location(source))
    file = names.layout.generator_file
    layout_files = {} if file is None else {names.layout.generator: file}
    load_layout = _make_loader(LAYOUTS, "--layout", [layout] if layout else [], layout_files, source)
    load_policy = _make_loader(PEDESTRIANS, "--pedestrians", pedestrians, names.pedestrians.policy_files, source)
    return scenario_file.parse_scenario(keys, str(table.get("name", "")), source, load_layout, load_policy, data)


def _make_loader(
    kind: Kind, option: str, specs: Iterable[str], digests: Mapping[str, str], source: str
) -> Callable[[str], PluginWithDigest]:
    """Return a function that loads plug-ins of a run by name: built-in ones, and files that the user gives.

    Args:
        kind: The kind of plug-in.
        option: The command-line option for these files, for errors.
        specs: The files that the user gives.
        digests: The digests of the files in the run, by name.
        source: Name of the file of the run, for errors.

    Raises:
        InputError: The run used no such file.
    """
    plugins = {plugin[0]: plugin for plugin in map(kind.load_with_digest, specs)}
    for name in plugins.keys() - digests.keys():
        raise InputError(f"{source}: no {kind.word} of the run is a file called {name}")

    def load(name: str) -> PluginWithDigest:
        if name in plugins:
            return plugins[name]
        if name in digests or file_and_function(name)[0] is not None:
            raise InputError(
                f"the {kind.word} {name} of the run is a file of a user: give it with "
                f"{option} ./{name}.py, and it is loaded if its digest is {digests.get(name)}"
            )
        return kind.load_with_digest(name)

    return load


def simulated_scenarios() -> list[str]:
    """Return the names of the built-in scenarios that need no recorded tracks."""
    return [path.stem for path in _scenario_files() if "tracks" not in read_toml(path, "scenario")]


def scenarios() -> list[tuple[str, str]]:
    """Return the name and the description of each built-in scenario."""
    return [(path.stem, str(read_toml(path, "scenario").get("description", ""))) for path in _scenario_files()]


def _scenario_files() -> list[Path]:
    """Return the files of all built-in scenarios, sorted by path, without dials and the suite's list."""
    files = sorted(path for path in SCENARIOS.rglob("*.toml") if path.parent.name != "dials")
    return [path for path in files if path != SUITE]


def read_suite() -> Suite:
    """Return the suite that ships."""
    return Suite(**read_toml(SUITE, "suite"))


def _resolve_files(policy: Any) -> Any:
    """Return a policy, or a table of policies with their shares; files become paths in the current directory."""
    if isinstance(policy, dict):
        return {_resolve_files(name): share for name, share in policy.items()}
    is_file = isinstance(policy, str) and file_and_function(policy)[0] is not None
    return str(Path.cwd() / policy) if is_file else policy


def names_file(policy: Any) -> bool:
    """Return whether a policy or a layout, or any policy in a table of policies, is given as a file."""
    names = policy if isinstance(policy, dict) else [policy]
    return any(isinstance(name, str) and file_and_function(name)[0] is not None for name in names)


def set_key(table: dict[str, Any], key: str, value: Any, path: Path) -> None:
    """Set a dotted key of a scenario. Raises InputError with the name of `path` if a part of the key is not a table."""
    *sections, last = key.split(".")
    for section in sections:
        table = table.setdefault(section, {})
        if not isinstance(table, dict):
            raise InputError(f"{path.name}: {key} cannot be set, since {section} is not a table")
    table[last] = value
