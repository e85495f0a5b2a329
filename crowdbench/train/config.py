"""The options of `crowdbench train`: a dataclass for each method, a field for each option, a docstring for its help.

This module does not import torch: the command line reads the options before it sets the number of threads, which torch
and numba read when they are imported. A new method is a dataclass here, a line in `METHODS`, and a subclass of
`crowdbench.train.training.Training` in a file of its own.
"""

from __future__ import annotations

import dataclasses
import json
import math
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

from crowdbench.utils.errors import InputError, find_named, is_integer, require, require_count, require_positive

SCENARIO = "circle_crossing_mixed"
"""The default scenario."""

MOST_SEED = 10**9
"""The largest seed: every seed has separate training cases, whose numbers are 64-bit integers."""

EPISODES = 4000
"""The default length of the training of a value network."""

UNLIMITED = {"max_acceleration": math.inf, "max_turn": math.pi, "max_velocity_change": math.inf}
"""The limits of `Limits` that exclude nothing."""


def flag(name: str) -> str:
    """Return the option of the command line that sets a field."""
    return "--set" if name == "overrides" else f"--{name.replace('_', '-')}"


def split_names(listed: str | None) -> list[str]:
    """Split names with commas between them."""
    return [] if listed is None else [name.strip() for name in listed.split(",")]


@dataclass(frozen=True, kw_only=True)
class Config:
    """The options of a training. Every method has a subclass with its own options.

    Attributes:
        network: Name of the network.
        scenario: Name of the scenario to train in, or a file: ./mine.toml.
        overrides: Change a key of the scenario, such as vehicle.visible=true. Repeatable.
        data: Folder with recorded tracks, which scenarios with a table [tracks] need.
        seed: Seed of the weights, of minibatches and of training cases.
        minutes: Train for this many minutes, validations included, instead of a number of episodes or steps.

    Raises:
        InputError: A number is impossible.
    """

    network: str
    scenario: str = SCENARIO
    overrides: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    data: str | None = None
    seed: int = 0
    minutes: float | None = None

    length: ClassVar[str]
    """The field with the length of the training, in the unit of the curve's first column."""

    training: ClassVar[str]
    """The subclass of `Training` that runs it, as `module:class`."""

    always_written: ClassVar[Sequence[str]] = ("scenario",)
    """The fields that `command` has even with their defaults."""

    def __post_init__(self) -> None:
        require_count(flag(self.length), getattr(self, self.length))
        in_range = is_integer(self.seed) and 0 <= self.seed <= MOST_SEED
        require("--seed", self.seed, in_range, f"a whole number from 0 to {MOST_SEED}")
        if self.minutes is not None:
            require_positive("--minutes", self.minutes)

    @property
    def program(self) -> str:
        """The words of the command line that trains this network, without options."""
        return f"crowdbench train {self.network}"

    @property
    def usage(self) -> str:
        """The words after `crowdbench` that run the trained network; its weights are added as an option."""
        return f"run --planner {self.network}"

    @property
    def command(self) -> str:
        """The command that trains with these options, without those that have their defaults."""
        words = [self.program]
        for field in dataclasses.fields(self):
            name, value = field.name, getattr(self, field.name)
            if name in ("network", "seed", "minutes", self.length):
                continue
            if isinstance(value, Mapping):
                for key, part in value.items():
                    text = part if isinstance(part, str) else json.dumps(part)
                    words += [flag(name), shlex.quote(f"{key}={text}")]
            elif value is True:
                words.append(flag(name))
            elif value != field.default or name in self.always_written:
                # Of a folder of recorded tracks, only the name: it may be elsewhere on another machine.
                words += [flag(name), shlex.quote(Path(value).name if name == "data" else str(value))]
        words.append(f"--seed {self.seed}")
        if self.minutes is None:
            words.append(f"--{self.length} {getattr(self, self.length)}")
        else:
            words.append(f"--minutes {self.minutes:g}")
        return " ".join(words)


@dataclass(frozen=True, kw_only=True)
class DrivingConfig(Config):
    """The options of a network that drives.

    Attributes:
        validation: Scenarios that choose the checkpoint, as in a,b; else the one to train in.
        card: Measure the network for its card on val, other cases than chose it, or on test too.
    """

    validation: str | None = None
    card: Literal["val", "test"] = "val"

    @property
    def beside(self) -> str | None:
        """Further scenarios to train in, as in a,b; None without any."""
        return None


@dataclass(frozen=True, kw_only=True)
class ValueConfig(DrivingConfig):
    """The options of a value network, see `crowdbench.train.value`.

    Attributes:
        predictor: The predictor in the lookahead: a name or ./mine.py.
        episodes: Train for this many episodes, without the demonstrations.
        max_acceleration: Limit the commands: largest change of speed, per second [m/s^2].
        max_turn: Limit the commands: largest change of heading in a step [rad].
        max_velocity_change: Limit the commands: largest change of velocity in a step [m/s].
    """

    predictor: str = "oracle"
    episodes: int = EPISODES
    max_acceleration: float | None = None
    max_turn: float | None = None
    max_velocity_change: float | None = None

    length: ClassVar[str] = "episodes"
    training: ClassVar[str] = "crowdbench.train.value:ValueTraining"
    always_written: ClassVar[Sequence[str]] = ("scenario", "predictor")

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, limit in self.limits.items():
            require_positive(flag(name), limit)

    @property
    def limits(self) -> dict[str, float]:
        """The limits that are given, by their names in `Limits`."""
        limits = {name: getattr(self, name) for name in UNLIMITED}
        return {name: limit for name, limit in limits.items() if limit is not None}

    @property
    def usage(self) -> str:
        """See `Config`."""
        # The planner `sarl` is privileged, as published.
        words = "run --planner sarl_cvm" if self.network == "sarl" else super().usage
        if not self.limits:
            return words
        limits = ", ".join(f"{name}={limit}" for name, limit in (UNLIMITED | self.limits).items())
        return f"{words} --option 'limits={{{limits}}}'"


@dataclass(frozen=True, kw_only=True)
class PPOConfig(DrivingConfig):
    """The options of a policy, see `crowdbench.train.ppo`.

    Attributes:
        steps: Train for this many steps, of all worlds together.
        reward: The reward: crowdnav, progress, safe_progress, scored, crowdnav_plus or ./mine.py.
        also_train_in: Further scenarios to train in, as in a,b, each with as many worlds as --scenario; one that is
            listed twice has twice as many.
        encoder: The file of an encoder (feature extractor) of your own, ./mine.py.
        ppo: A parameter of PPO, as in gamma=0.99; repeatable.
    """

    steps: int = 5_000_000
    reward: str = "progress"
    also_train_in: str | None = None
    encoder: str | None = None
    ppo: Mapping[str, Any] = dataclasses.field(default_factory=dict)

    length: ClassVar[str] = "steps"
    training: ClassVar[str] = "crowdbench.train.ppo:PPOTraining"

    @property
    def beside(self) -> str | None:
        """Further scenarios to train in."""
        return self.also_train_in


METHODS: dict[str, type[Config]] = {
    "cadrl": ValueConfig,
    "lstm_rl": ValueConfig,
    "ppo": PPOConfig,
    "ppo_attention": PPOConfig,
    "ppo_lidar": PPOConfig,
    "sarl": ValueConfig,
}
"""The options by the name of the network, which is also the name of a planner."""


def networks_by_option(methods: Mapping[str, type[Config]] = METHODS) -> dict[str, list[str]]:
    """Return the networks that have an option, by the name of its field.

    An option with the same name has the same meaning in all methods.
    """
    networks: dict[str, list[str]] = {}
    for network, method in methods.items():
        for field in dataclasses.fields(method):
            if field.name != "network":
                networks.setdefault(field.name, []).append(network)
    return networks


def make_config(network: str, options: Mapping[str, Any], methods: Mapping[str, type[Config]] = METHODS) -> Config:
    """Check the options of a training, and make its configuration.

    Args:
        network: The name of the network.
        options: The options that a user has given, by field name.
        methods: The options of the methods, by the name of the network.

    Raises:
        InputError: There is no such network, an option is another network's or impossible, or two options conflict.
    """
    method = find_named("network", network, methods)
    for name, networks in networks_by_option(methods).items():
        if name in options and network not in networks:
            raise InputError(f"{flag(name)} is not for {network}, only for {', '.join(networks)}")
    if "minutes" in options and method.length in options:
        raise InputError(f"--minutes and --{method.length} both set the length of a training: give one")
    return method(network=network, **options)
