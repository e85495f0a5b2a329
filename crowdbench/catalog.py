"""Names to things: planners, policies, predictors, metrics and scenarios, built in, installed, or in a user's files."""

from __future__ import annotations

import functools
import json
import tomllib
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from crowdbench import plugins
from crowdbench.errors import InputError
from crowdbench.evaluate.metrics import METRICS, Metric
from crowdbench.planners.base import Planner
from crowdbench.plugins import Kind
from crowdbench.predict import ConstantVelocity, ConstantVelocitySampled, Linear, Oracle, Predictor
from crowdbench.scenario import file as scenario_file
from crowdbench.scenario.scenario import Scenario
from crowdbench.sim.pedestrians import PedestrianPolicy

if TYPE_CHECKING:
    from crowdbench.value.networks import ValueNetwork

_PACKAGE = Path(__file__).parent
# In a wheel the plug-in folders lie inside the package, in a checkout beside it.
_ROOT = _PACKAGE if (_PACKAGE / "agents").is_dir() else _PACKAGE.parent

PLANNERS = Kind("planner", _ROOT / "agents" / "planners", "planner", "crowdbench.planners")
PEDESTRIANS = Kind("pedestrian policy", _ROOT / "agents" / "pedestrians", "policy", "crowdbench.pedestrians")
SCENARIOS = _ROOT / "scenarios"
WEIGHTS = _ROOT / "agents" / "weights"

SUFFIX = ".safetensors"
"""How files of weights end."""

RESERVED = ("case", "outcome", "steps")
"""Columns of every table of episodes, which no metric may be called."""


def load_planner(spec: str, options: Mapping[str, Any] | None = None) -> tuple[str, Planner]:
    """A planner's name and the planner, from a name, `file.py` or `file.py:factory`.

    Raises InputError where there is none, where it does not take the options, or where its file is broken.
    """
    name, factory = PLANNERS.find(spec)
    made = plugins.call(name, factory, options or {})
    if not isinstance(made, Planner):
        raise InputError(f"{spec}: the factory made a {type(made).__name__}, but must make a crowdbench.Planner")
    return name, made


def load_predictor(spec: str, options: Mapping[str, Any] | None = None) -> tuple[str, Predictor]:
    """A predictor's name and the predictor, from the name of a built-in one, `file.py` or `file.py:function`.

    Raises InputError like `load_planner`.
    """
    file, function = plugins.parts(spec)
    if file is not None:
        name, factory = function or file.stem, plugins.function_of(file, function or "predictor")
    elif spec in PREDICTORS:
        name, factory = spec, PREDICTORS[spec]
    else:
        known = ", ".join(PREDICTORS)
        raise InputError(f"no predictor is called {spec!r}; there are {known}, or give a file: ./mine.py")
    made = plugins.call(name, factory, options or {})
    if not isinstance(made, Predictor):
        raise InputError(f"{spec}: the factory made a {type(made).__name__}, but must make a Predictor")
    return name, made


def load_policy(spec: str, folder: Path = Path()) -> tuple[str, PedestrianPolicy, str | None]:
    """A pedestrian policy's name, the policy, and the digest of its file (None if it is built in or installed).

    It is found as planners are; the path of a file is relative to `folder`. Raises InputError like `load_planner`.
    """
    if plugins.parts(spec)[0] is not None:
        spec = str(folder / spec)
    name, factory = PEDESTRIANS.find(spec)
    made = plugins.call(name, factory, {})
    if not isinstance(made, PedestrianPolicy):
        raise InputError(
            f"{spec}: the factory made a {type(made).__name__}, but must make a crowdbench.PedestrianPolicy"
        )
    return name, made, plugins.source(spec)


def load_network(network: str, weights: str, device: str = "cpu") -> ValueNetwork:
    """A value network with weights: the name of built-in ones, or `file.safetensors`, with its card beside it.

    Raises InputError where they do not exist, are not this network's, or are not what their card says.
    """
    # Here, since torch takes a second and most planners do without.
    from crowdbench.value.networks import NETWORKS
    from crowdbench.weights.store import load_into

    return load_into(NETWORKS[network](), network, _weights_file(weights), device)


def _sgan(weights: str = "sgan", modes: int = 20, rescaled: bool = False, device: str = "cpu") -> Predictor:
    """Social GAN (Gupta et al. 2018): several futures of the crowd, from a generator trained on real pedestrians."""
    from crowdbench.predict.social_gan import NAME, SocialGAN
    from crowdbench.predict.social_gan_network import Generator
    from crowdbench.weights.store import load_into, read_card

    file = _weights_file(weights)
    about = read_card(file).get("training", {})
    generator = load_into(Generator(about.get("pooling", False)), NAME, file, device)
    if not {"dt", "scenes"} <= about.keys():
        raise InputError(
            f"the card of the weights {file} must say on which scenes, in steps of which dt, they were trained"
        )

    def trained_without(scene: str) -> Predictor:
        return _sgan(f"{weights}-{scene}", modes, rescaled, device)

    has_others = any(path.stem.startswith(f"{weights}-") for path in _weights())
    return SocialGAN(generator, about, modes, rescaled, trained_without if has_others else None)


def _sgan_simulated(modes: int = 20, device: str = "cpu") -> Predictor:
    """Social GAN trained on the crowds of the simulator instead of real pedestrians."""
    return _sgan("sgan_simulated", modes, device=device)


PREDICTORS: Mapping[str, Callable[..., Predictor]] = {
    "linear": Linear,
    "constant_velocity": ConstantVelocity,
    "constant_velocity_sampled": ConstantVelocitySampled,
    "oracle": Oracle,
    "sgan": _sgan,
    "sgan_simulated": _sgan_simulated,
}
"""What makes the built-in predictors: classes, or functions that import torch only when they are called."""


def _weights_file(weights: str) -> Path:
    if weights.endswith(SUFFIX):
        return Path(weights)
    if weights not in (names := [path.stem for path in _weights()]):
        raise InputError(
            f"no weights are called {weights!r}; there are {', '.join(names)}, or give a file: ./mine{SUFFIX}"
        )
    return WEIGHTS / f"{weights}{SUFFIX}"


def weights() -> list[tuple[str, str]]:
    """Name and headline of the built-in weights."""
    from crowdbench.weights.card import headline
    from crowdbench.weights.store import read_card

    return [(path.stem, headline(read_card(path))) for path in _weights()]


def _weights() -> list[Path]:
    return sorted(WEIGHTS.glob(f"*{SUFFIX}"))


def load_metrics(specs: Iterable[str]) -> dict[str, Metric]:
    """The built-in metrics and those of `file.py` (its function `metric`) or `file.py:function`.

    Raises InputError where there is no such function, or its name is taken.
    """
    metrics = dict(METRICS)
    for spec in specs:
        file, function = plugins.parts(spec)
        if file is None:
            raise InputError(f"{spec!r} is no metric of your own: give a file, ./mine.py or ./mine.py:function")
        name = function or file.stem
        if name in metrics or name in RESERVED:
            raise InputError(f"{spec}: a column {name} exists already: give the metric another name")
        metrics[name] = plugins.function_of(file, function or "metric")
    return metrics


def load_scenario(spec: str, overrides: Mapping[str, Any] | None = None, pedestrians: str | None = None) -> Scenario:
    """A scenario by name or path, with dotted keys overridden: `{"vehicle.visible": True}`.

    `pedestrians` puts one policy in the place of the scenario's own, and of what it sets for them. Raises
    InputError where there is no such scenario, or something in it is wrong.
    """
    own_file = spec.endswith(".toml")
    path = Path(spec) if own_file else SCENARIOS / f"{spec}.toml"
    if not own_file and spec not in (name for name, _ in scenarios()):
        known = ", ".join(name for name, _ in scenarios())
        raise InputError(f"no scenario is called {spec!r}; there are {known}, or give a file: ./mine.toml")
    table = scenario_file.read_table(path)
    crowd = table.get("pedestrians", {})
    if pedestrians is not None and isinstance(crowd, dict):
        others = [key for key, value in crowd.items() if isinstance(value, dict) and "mean" not in value]
        table["pedestrians"] = {key: crowd[key] for key in crowd if key not in others}
        table["pedestrians"]["policy"] = _from_here(pedestrians)
    for key, value in (overrides or {}).items():
        _set(table, key, _from_here(value) if key == "pedestrians.policy" else value, path)
    source = str(path) if own_file else path.name
    return scenario_file.parse(table, path.stem, source, functools.partial(load_policy, folder=path.parent))


def scenarios() -> list[tuple[str, str]]:
    """Name and description of the built-in scenarios."""
    files = sorted(SCENARIOS.glob("*.toml"))
    return [(path.stem, str(scenario_file.read_table(path).get("description", ""))) for path in files]


def assignments(texts: Iterable[str], flag: str) -> dict[str, Any]:
    """Read `key=value` texts; a value is TOML, or else a bare text. Raises InputError where there is no `=`."""
    pairs = {}
    for text in texts:
        key, equals, value = text.partition("=")
        if not equals or not key.strip():
            raise InputError(f"{flag} {text!r} sets nothing: write {flag} key=value")
        try:
            read = tomllib.loads(f"value = {value}")["value"]
            # Results are JSON, which knows neither dates nor infinity: such are meant as texts.
            json.dumps(read, allow_nan=False)
        except (tomllib.TOMLDecodeError, TypeError, ValueError):
            read = value
        pairs[key.strip()] = read
    return pairs


def _from_here(policy: Any) -> Any:
    """A policy or shares of several; what comes from the command line is relative to where one stands."""
    if isinstance(policy, dict):
        return {_from_here(name): share for name, share in policy.items()}
    is_file = isinstance(policy, str) and plugins.parts(policy)[0] is not None
    return str(Path.cwd() / policy) if is_file else policy


def _set(table: dict[str, Any], key: str, value: Any, path: Path) -> None:
    *sections, last = key.split(".")
    for section in sections:
        table = table.setdefault(section, {})
        if not isinstance(table, dict):
            raise InputError(f"{path.name}: {key} cannot be set, since {section} is not a table")
    table[last] = value
