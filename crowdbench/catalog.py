"""Names to objects: planners, policies, layouts and scenarios, built in, installed, or in a user's files."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar, cast

from crowdbench.planners.base import Planner
from crowdbench.plugins.files import file_digests
from crowdbench.plugins.load import ROOT, Kind, file_and_function, make_plugin, source_digest
from crowdbench.scenario import layouts
from crowdbench.scenario import load as scenario_file
from crowdbench.scenario.certified import FOLDER
from crowdbench.scenario.placement import Layout
from crowdbench.scenario.scenario import Scenario
from crowdbench.scenario.schema import PedestriansSpec
from crowdbench.sim.pedestrians import PedestrianPolicy
from crowdbench.utils.errors import InputError, plugin_errors
from crowdbench.utils.files import sha256
from crowdbench.utils.numbers import is_number
from crowdbench.utils.toml import read_toml

PLANNERS = Kind("planner", "planner", folder=ROOT / "agents" / "planners", entry_points="crowdbench.planners")
PEDESTRIANS = Kind(
    "pedestrian policy", "policy", folder=ROOT / "agents" / "pedestrians", entry_points="crowdbench.pedestrians"
)
SCENARIOS = ROOT / "scenarios"
LAYOUTS = Kind("layout", "layout", layouts.LAYOUTS, SCENARIOS, "crowdbench.layouts")

Loaded = TypeVar("Loaded", tuple[str, Layout, str | None], tuple[str, PedestrianPolicy, str | None])
"""Name, plug-in, and the digest of its file."""


def load_planner(spec: str, options: Mapping[str, Any] | None = None) -> tuple[str, Planner]:
    """Find a planner and construct it.

    Args:
        spec: The name of a built-in or installed planner, `file.py` or `file.py:function`.
        options: Arguments of the planner's function, as they are written in TOML.

    Returns:
        The planner's name, and the planner.

    Raises:
        InputError: There is no such planner, it does not take the options, or its file is broken.
    """
    name, factory = PLANNERS.find(spec)
    # mypy refuses abstract classes as arguments, though none is constructed.
    return name, make_plugin(Planner, name, factory, options or {})  # type: ignore[type-abstract]


def planner_files(spec: str, options: Mapping[str, Any]) -> dict[str, dict[str, str]]:
    """The sha256 of every file that a planner depends on beside crowdbench.

    Args:
        spec: As `load_planner` takes it, which has found the planner.
        options: The planner's options.

    Returns:
        By `planner`, its Python files; by `option weights` and the like, the files that an option names, such as
        trained weights with their card, or a predictor's file with what it imports. Files are named by their paths.
    """
    named = {f"option {name}": _files_named(value) for name, value in options.items()}
    return {"planner": PLANNERS.files(spec)} | {name: files for name, files in named.items() if files}


def _files_named(value: Any) -> dict[str, str]:
    """The sha256 of every file that the value of an option names, perhaps within a table or a list."""
    if isinstance(value, Mapping | list):
        values = value.values() if isinstance(value, Mapping) else value
        return {name: digest for each in values for name, digest in _files_named(each).items()}
    if not isinstance(value, str):
        return {}
    built_in = ROOT / "agents" / "weights" / f"{value}.safetensors"
    for path in (built_in, file_and_function(value)[0] or Path(value)):
        if _is_file(path):
            card = [path.with_suffix(".json")] if path.suffix == ".safetensors" else []
            others = {each.name: sha256(each) for each in (path, *card) if _is_file(each)}
            return file_digests(path) if path.suffix == ".py" else others
    return {}


def _is_file(path: Path) -> bool:
    with contextlib.suppress(OSError, ValueError):  # raised where a text can be no path
        return path.is_file()
    return False


def load_layout(spec: str, folder: Path = Path()) -> tuple[str, Layout, str | None]:
    """Find a layout.

    Args:
        spec: The name of a built-in or installed layout, `file.py` or `file.py:function`.
        folder: The folder that the path of a file is relative to.

    Returns:
        The layout's name, the layout, and the digest of its file; None where it is built in or installed.

    Raises:
        InputError: There is no such layout, or its file is broken.
    """
    name, layout, digest = _find(LAYOUTS, spec, folder)
    return name, cast(Layout, layout), digest


def load_policy(spec: str, folder: Path = Path()) -> tuple[str, PedestrianPolicy, str | None]:
    """Find a pedestrian policy and construct it.

    Args:
        spec: The name of a built-in or installed policy, `file.py` or `file.py:function`.
        folder: The folder that the path of a file is relative to.

    Returns:
        The policy's name, the policy, and the digest of its file; None where it is built in or installed.

    Raises:
        InputError: There is no such policy, or its file is broken.
    """
    name, factory, digest = _find(PEDESTRIANS, spec, folder)
    return name, make_policy(name, factory), digest


def _find(kind: Kind, spec: str, folder: Path) -> tuple[str, Callable[..., object], str | None]:
    """A plug-in's name and function, and the digest of its file, whose path is relative to a folder."""
    if file_and_function(spec)[0] is not None:
        spec = str(folder / spec)
    return *kind.find(spec), source_digest(spec)


def make_policy(name: str, factory: Callable[..., object]) -> PedestrianPolicy:
    """Construct a pedestrian policy.

    Args:
        name: The policy's name.
        factory: What constructs it.

    Returns:
        The policy.

    Raises:
        InputError: The factory fails or makes something else, or the policy's parameters are no numbers by name.
    """
    made = make_plugin(PedestrianPolicy, name, factory, {})  # type: ignore[type-abstract]
    with plugin_errors(f"the parameters of {name} cannot be read:"):
        parameters = dict(made.parameters)
    for key, value in parameters.items():
        if not isinstance(key, str) or not is_number(value):
            right = "parameters are numbers by name, such as {'pace': 0.5}"
            raise InputError(f"the pedestrian policy {name} has the parameter {key!r} with {value!r}: {right}")
    return made


def load_scenario(
    spec: str,
    overrides: Mapping[str, Any] | None = None,
    pedestrians: str | None = None,
    data: Path | None = None,
    *,
    all_cases: bool = False,
) -> Scenario:
    """Find a scenario and read it.

    Args:
        spec: The name of a built-in scenario, or `file.toml`.
        overrides: Values for dotted keys of the file, such as `{"vehicle.visible": True}`.
        pedestrians: A policy that moves all pedestrians instead of the scenario's own, without its parameters.
        data: The folder with the recorded tracks that the scenario's `[tracks]` needs.
        all_cases: Whether it has those cases too that are known to have no certificate.

    Returns:
        The scenario.

    Raises:
        InputError: There is no such scenario, or something in it is wrong.
    """
    own_file = spec.endswith(".toml")
    path = Path(spec) if own_file else SCENARIOS / f"{spec}.toml"
    if not own_file and spec not in (name for name, _ in scenarios()):
        known = ", ".join(name for name, _ in scenarios())
        raise InputError(f"no scenario is called {spec!r}; there are {known}, or give a file: ./mine.toml")
    table = read_toml(path, "scenario")
    crowd = table.get("pedestrians", {})
    if pedestrians is not None and isinstance(crowd, dict):
        table["pedestrians"] = {key: crowd[key] for key in crowd if key in PedestriansSpec.model_fields}
        table["pedestrians"]["policy"] = _from_here(pedestrians)
    for key, value in (overrides or {}).items():
        _set(table, key, _from_here(value) if key in ("pedestrians.policy", "layout.generator") else value, path)
    source = str(path) if own_file else path.name
    load = scenario_file.Loaders(
        functools.partial(load_layout, folder=path.parent),
        functools.partial(load_policy, folder=path.parent),
        data,
    )
    scenario = scenario_file.parse(table, path.stem, source, load)
    if all_cases:
        return scenario
    return scenario_file.leave_out_uncertified(scenario, spec, path.parent / FOLDER / path.name)


def load_recorded_scenario(
    table: Mapping[str, Any],
    source: str,
    pedestrians: Iterable[str] = (),
    layout: str | None = None,
    data: Path | None = None,
) -> Scenario:
    """Make the scenario of a run again.

    Only what the user names is loaded from files, never what the run names: it may come from somebody else.

    Args:
        table: The table `scenario` of the run's `result.json`.
        source: What that file is called, for errors.
        pedestrians: The files of the pedestrian policies that are the user's own.
        layout: The file of the layout, if it is the user's own.
        data: The folder with the recorded tracks, if the run had any.

    Returns:
        The scenario.

    Raises:
        InputError: Something in the table is wrong, or the file of the layout or of a policy is not given, or is
            another one than in the run.
    """
    digests = table["pedestrians"].get("policy_files")
    digests = digests if isinstance(digests, Mapping) else {}
    places = table.get("layout", {})
    layouts = {places.get("generator"): places["generator_file"]} if "generator_file" in places else {}
    load = scenario_file.Loaders(
        _only_given(load_layout, [layout] if layout else [], layouts, "layout", "--layout", source),
        _only_given(load_policy, pedestrians, digests, "pedestrian policy", "--pedestrians", source),
        data,
    )
    return scenario_file.restore(table, source, load)


def _only_given(
    load: Callable[[str], Loaded],
    specs: Iterable[str],
    digests: Mapping[str, str],
    word: str,
    option: str,
    source: str,
) -> Callable[[str], Loaded]:
    """What loads the plug-ins of a run by name: those that are built in, and the files that the user gives.

    Args:
        load: Loads a plug-in.
        specs: The files that the user gives.
        digests: By name, the digests of the files that the run had.
        word: What such a plug-in is called.
        option: The option by which files are given.
        source: What the file of the run is called, for errors.

    Raises:
        InputError: The run had no such file, or another one of the same name.
    """
    given = {plugin[0]: plugin for plugin in map(load, specs)}
    for name, _, digest in given.values():
        if name not in digests:
            raise InputError(f"{source}: no {word} of the run is a file called {name}")
        if digest != digests[name]:
            raise InputError(
                f"{source}: the {word} {name} of the run had the digest {digests[name]}, but the file that "
                f"is given has {digest}: give the file as it was"
            )

    def find(name: str) -> Loaded:
        if name in given:
            return given[name]
        if name in digests or file_and_function(name)[0] is not None:
            raise InputError(
                f"the {word} {name} of the run is a file of somebody's own: give it with "
                f"{option} ./{name}.py, and it is loaded if its digest is {digests.get(name)}"
            )
        return load(name)

    return find


def simulated_scenarios() -> list[str]:
    """The names of the built-in scenarios that need no recorded tracks."""
    return [name for name, _ in scenarios() if "tracks" not in read_toml(SCENARIOS / f"{name}.toml", "scenario")]


def scenarios() -> list[tuple[str, str]]:
    """Name and description of the built-in scenarios."""
    files = sorted(SCENARIOS.glob("*.toml"))
    return [(path.stem, str(read_toml(path, "scenario").get("description", ""))) for path in files]


def _from_here(policy: Any) -> Any:
    """A policy, or a table of several with their shares; files are relative to the current directory."""
    if isinstance(policy, dict):
        return {_from_here(name): share for name, share in policy.items()}
    is_file = isinstance(policy, str) and file_and_function(policy)[0] is not None
    return str(Path.cwd() / policy) if is_file else policy


def _set(table: dict[str, Any], key: str, value: Any, path: Path) -> None:
    *sections, last = key.split(".")
    for section in sections:
        table = table.setdefault(section, {})
        if not isinstance(table, dict):
            raise InputError(f"{path.name}: {key} cannot be set, since {section} is not a table")
    table[last] = value
