"""The options of `crowdbench train`: a dataclass for each method, with a field for each option.

This module does not import torch, so that the command line starts without it. A new method is a dataclass here, a line
in `METHODS`, and a subclass of `crowdbench.train.training.Training` in a file of its own.
"""

from __future__ import annotations

import abc
import dataclasses
import json
import math
import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal, TypeVar

from crowdbench.utils.errors import InputError, find_named

if TYPE_CHECKING:
    from crowdbench.train.training import Training

SCENARIO = "circle_crossing_mixed"
"""The default scenario."""

MOST_SEED = 10**9
"""The largest seed: every seed has separate training cases, whose numbers are 64-bit integers."""

EPISODES = 4000
"""The default length of the training of a value network."""

UNLIMITED = {"max_acceleration": math.inf, "max_turn": math.pi, "max_velocity_change": math.inf}
"""The limits of `Limits` that exclude nothing."""

Default = TypeVar("Default")


def option(
    default: Default, help: str, least: float | None = None, always: bool = False, pairs: bool = False
) -> Default:
    """Declare a field that is an option of `crowdbench train`.

    Args:
        default: The default value.
        help: The meaning, in one sentence without a full stop.
        least: The smallest number allowed, or None.
        always: True if `Config.command` has it even with its default.
        pairs: True if it is given as `name=value`, repeatedly, and is a mapping.

    Returns:
        The field, for the body of a dataclass, with the other arguments as its metadata.
    """
    metadata = {"help": help, "least": least, "always": always, "pairs": pairs}
    return dataclasses.field(default=default, metadata=metadata)


def flag(name: str) -> str:
    """Return the option of the command line that sets a field."""
    return "--set" if name == "overrides" else f"--{name.replace('_', '-')}"


def split_names(listed: str | None) -> list[str]:
    """Split names with commas between them."""
    return [name.strip() for name in listed.split(",")] if listed is not None else []


@dataclass(frozen=True, kw_only=True)
class Config(abc.ABC):
    """The options of a training. Every method has a subclass, which declares its options with `option`.

    Attributes:
        network: The name of the network.
        scenario: A scenario by name, or the path of its TOML file.
        overrides: Keys of the scenario that are changed, dotted: `{"pedestrians.number": 5}`.
        data: The folder with recorded tracks, or None.
        seed: The seed of weights, batches and training cases.
        minutes: The length of the training in minutes; None for the length in the field named by `length`.
    """

    network: str
    scenario: str = SCENARIO
    overrides: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    data: str | None = None
    seed: int = 0
    minutes: float | None = None

    length: ClassVar[str]
    """The field with the length of the training, in the unit of the curve's first column."""

    @abc.abstractmethod
    def training(self, device: str) -> Training:
        """Make a new training.

        Args:
            device: `cpu` or `cuda`.

        Raises:
            InputError: A scenario, file or parameter does not exist or is impossible.
        """

    @property
    def program(self) -> str:
        """The words of the command line that trains this network, without options."""
        return f"crowdbench train {self.network}"

    @property
    def use(self) -> str:
        """The words after `crowdbench` that run the trained network; its weights are added as an option."""
        return f"run --planner {self.network}"

    @property
    def source(self) -> list[str]:
        """The words of `command` for the scenario, and the name of the folder of recorded tracks."""
        values = {key: value if isinstance(value, str) else json.dumps(value) for key, value in self.overrides.items()}
        words = ["--scenario", self.scenario, *(f"--set '{key}={value}'" for key, value in values.items())]
        return words if self.data is None else [*words, "--data", Path(self.data).name]

    @property
    def command(self) -> str:
        """The command that trains with these options: without defaults, except for options with `always`."""
        words = [self.program, *self.source]
        for field in dataclasses.fields(self):
            value, metadata = getattr(self, field.name), field.metadata
            if not metadata or field.name == self.length:
                continue
            if metadata["pairs"]:
                words += [f"{flag(field.name)} {shlex.quote(f'{key}={part}')}" for key, part in (value or {}).items()]
            elif value != field.default or metadata["always"]:
                words += [flag(field.name), *([] if value is True else [shlex.quote(str(value))])]
        length = f"{self.length} {getattr(self, self.length)}" if self.minutes is None else f"minutes {self.minutes:g}"
        return " ".join([*words, f"--seed {self.seed}", f"--{length}"])


@dataclass(frozen=True, kw_only=True)
class DrivingConfig(Config):
    """The options of a network that drives.

    Attributes:
        validation: The scenarios on which the checkpoint is chosen, by name or path, with commas between them; None for
            the training scenario.
        card: The cases of the figures on the card: `val`, or `test` for test cases too.
    """

    validation: str | None = option(None, "Scenarios that choose the checkpoint, as in a,b; else the one to train in")
    card: Literal["val", "test"] = option(
        "val", "Measure the network for its card on val, other cases than chose it, or on test too"
    )


@dataclass(frozen=True, kw_only=True)
class ValueConfig(DrivingConfig):
    """The options of `crowdbench.train.value`.

    Attributes:
        predictor: The predictor in the lookahead: a name, or the path of its file.
        episodes: The episodes that the network drives, without demonstrations.
        max_acceleration: As in `Limits`; None for no limit.
        max_turn: As in `Limits`; None for no limit.
        max_velocity_change: As in `Limits`; None for no limit.
    """

    predictor: str = option("oracle", "The predictor in the lookahead: a name or ./mine.py", always=True)
    episodes: int = option(EPISODES, "Train for this many episodes", least=1)
    max_acceleration: float | None = option(None, "Limit the commands: largest change of speed, per second [m/s^2]")
    max_turn: float | None = option(None, "Limit the commands: largest change of heading in a step [rad]")
    max_velocity_change: float | None = option(None, "Limit the commands: largest change of velocity in a step [m/s]")

    length: ClassVar[str] = "episodes"

    def training(self, device: str) -> Training:
        """See `Config`."""
        from crowdbench.train.value import ValueTraining

        return ValueTraining(self, device)

    @property
    def limits(self) -> dict[str, float]:
        """The limits that are given, by their names in `Limits`."""
        return {name: limit for name in UNLIMITED if (limit := getattr(self, name)) is not None}

    @property
    def use(self) -> str:
        """See `Config`."""
        # The planner `sarl` is privileged, as published.
        words = "run --planner sarl_cvm" if self.network == "sarl" else super().use
        limits = ", ".join(f"{name}={limit}" for name, limit in (UNLIMITED | self.limits).items())
        return f"{words} --option 'limits={{{limits}}}'" if self.limits else words


@dataclass(frozen=True, kw_only=True)
class PPOConfig(DrivingConfig):
    """The options of `crowdbench.train.ppo`.

    Attributes:
        steps: The total number of steps of the vehicles of all worlds.
        reward: The name of a reward of the environments, or a file.
        also_train_in: Further scenarios to train in, by name or path, with commas between them.
        encoder: The file of an encoder that replaces the network's; None for the network's.
        ppo: Parameters of `crowdbench.train.ppo.Parameters`, by name; the others have their defaults.
    """

    steps: int = option(5_000_000, "Train for this many steps, of all worlds together", least=1)
    reward: str = option("progress", "The reward: crowdnav, progress, safe_progress, crowdnav_plus or ./mine.py")
    also_train_in: str | None = option(
        None, "Further scenarios to train in, as in a,b, each with as many worlds as --scenario"
    )
    encoder: str | None = option(None, "The file of an encoder (feature extractor) of your own, ./mine.py")
    ppo: Mapping[str, Any] | None = option(None, "A parameter of PPO, as in gamma=0.99; repeatable", pairs=True)

    length: ClassVar[str] = "steps"

    def training(self, device: str) -> Training:
        """See `Config`."""
        from crowdbench.train.ppo import PPOTraining

        return PPOTraining(self, device)


METHODS: dict[str, type[Config]] = {
    "cadrl": ValueConfig,
    "lstm_rl": ValueConfig,
    "ppo": PPOConfig,
    "ppo_attention": PPOConfig,
    "sarl": ValueConfig,
}
"""The options by the name of the network, which is also the name of a planner."""


def method_options(
    methods: Mapping[str, type[Config]] = METHODS,
) -> dict[str, tuple[dataclasses.Field[Any], list[str]]]:
    """Return the fields declared with `option`, by name, with the networks that have them.

    An option with the same name has the same meaning in all methods: the field is that of the first method.
    """
    options: dict[str, tuple[dataclasses.Field[Any], list[str]]] = {}
    for network, method in methods.items():
        for field in dataclasses.fields(method):
            if field.metadata:
                options.setdefault(field.name, (field, []))[1].append(network)
    return options


def make_config(network: str, options: Mapping[str, Any], methods: Mapping[str, type[Config]] = METHODS) -> Config:
    """Check the options of a training, and make its configuration.

    Args:
        network: The name of the network.
        options: The options that a user has given, by field name.
        methods: The options of the methods, by the name of the network.

    Raises:
        InputError: There is no such network, an option is another network's or not finite, or two options conflict.
    """
    method = find_named("network", network, methods)
    for name, (_, networks) in method_options(methods).items():
        if name in options and network not in networks:
            raise InputError(f"{flag(name)} is not for {network}, only for {', '.join(networks)}")
    for name, value in options.items():
        if isinstance(value, float) and not math.isfinite(value):
            raise InputError(f"{flag(name)} is {value}, but must be a finite number")
    if "minutes" in options and method.length in options:
        raise InputError(f"--minutes and --{method.length} both set the length of a training: give one")
    return method(network=network, **options)
