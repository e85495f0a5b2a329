"""What a training method consists of: a request, which is what a user asks for, and a training, which carries it out.

A new method is a subclass of `Request`, a class with the members of `Training`, and a line in
`crowdbench.train.methods`. Nothing here imports torch, so that the command line can show all options at once.
"""

from __future__ import annotations

import abc
import dataclasses
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Protocol, TypeVar, runtime_checkable

if TYPE_CHECKING:
    from torch import nn

    from crowdbench.scenario.scenario import Scenario
    from crowdbench.train.checkpoint import State

SCENARIO = "circle_crossing_mixed"
"""The scenario to train in where none is given."""

MOST_SEED = 10**9
"""The largest seed: every seed has training cases of its own, whose numbers are 64-bit integers."""

Default = TypeVar("Default")


def option(
    default: Default, help: str, least: float | None = None, always: bool = False, pairs: bool = False
) -> Default:
    """A field of a request that is an option of `crowdbench train`.

    Args:
        default: Its value where it is not given.
        help: What it means, in one sentence without a full stop.
        least: The smallest number allowed, or None.
        always: Whether `Request.command` has it even with its default.
        pairs: Whether it is given as `name=value`, repeatedly, and is a mapping.

    Returns:
        The field, for the body of a dataclass; its metadata are the others.
    """
    metadata = {"help": help, "least": least, "always": always, "pairs": pairs}
    return dataclasses.field(default=default, metadata=metadata)


def describe_scenario(scenario: Scenario) -> dict[str, Any]:
    """What a card says of a scenario: its name, its digest and all its keys."""
    return {"name": scenario.name, "digest": scenario.digest, **scenario.table}


class CardText(NamedTuple):
    """What a card for people says that depends on the method.

    Attributes:
        headline: How the card goes on in one line after network, seed and training time: training and main figure.
        rows: The rows of its table that only this method has.
        figures: The figures, as lines of Markdown.
    """

    headline: str
    rows: Mapping[str, str]
    figures: Sequence[str]


@dataclass(frozen=True, kw_only=True)
class Request(abc.ABC):
    """What a user asks for in `crowdbench train`. Every method has a subclass, a dataclass.

    The fields below are common to all methods. A subclass declares the options of its own method with `option`.

    Attributes:
        network: The name of the network.
        scenario: A scenario by name, or the path of its TOML file.
        overrides: Keys of the scenario that are changed, dotted: `{"pedestrians.number": 5}`.
        data: The folder with recorded tracks, or None.
        seed: The seed of weights, batches and training cases.
        minutes: How long to train, in minutes; None to train as long as the option named `length` says.
    """

    network: str
    scenario: str = SCENARIO
    overrides: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    data: str | None = None
    seed: int = 0
    minutes: float | None = None

    length: ClassVar[str]
    """The option that says how long to train where `minutes` is not given."""

    @classmethod  # noqa: B027 (most methods have nothing to check)
    def check(cls, options: Mapping[str, Any]) -> None:
        """Raise InputError where options contradict each other; they are those that a user has given, by field name."""

    def progress(self, done: int, seconds: float) -> float:
        """The part of the training that is done, from 0 to 1.

        Args:
            done: How many of what `length` counts are done.
            seconds: The training time so far.
        """
        return min(1.0, seconds / (60.0 * self.minutes) if self.minutes else done / getattr(self, self.length))

    @property
    def command(self) -> str:
        """The command that asks for the same."""
        length = "minutes" if self.minutes is not None else self.length
        time = f"{self.minutes:g}" if self.minutes is not None else str(getattr(self, self.length))
        words = ["crowdbench train", self.network, *self.arguments]
        return " ".join([*words, f"--seed {self.seed}", f"--{length} {time}"])

    @property
    @abc.abstractmethod
    def arguments(self) -> Sequence[str]:
        """The arguments of `command`, without network, seed and length of training."""

    @property
    def scenario_arguments(self) -> Sequence[str]:
        """The arguments of `command` that name the scenario; a folder of recorded tracks is named without its path."""
        values = {key: value if isinstance(value, str) else json.dumps(value) for key, value in self.overrides.items()}
        words = ["--scenario", self.scenario, *(f"--set '{key}={value}'" for key, value in values.items())]
        return words if self.data is None else [*words, "--data", Path(self.data).name]

    @property
    @abc.abstractmethod
    def use(self) -> str:
        """The words after `crowdbench` that run the trained network; the weights are given as an option to them."""

    @abc.abstractmethod
    def training(self, device: str) -> Training:
        """A new training.

        Args:
            device: `cpu` or `cuda`.

        Returns:
            The training, not begun.

        Raises:
            InputError: Something that is asked for does not exist.
        """

    @abc.abstractmethod
    def make_card(self, training: Any, progress: Callable[[float], None]) -> dict[str, Any]:
        """The method's part of the card of trained weights, as JSON: `training`, `figures` and `data`.

        Args:
            training: What `training` made, at its end.
            progress: Called with what was added to the `card_cases`, in parts of a case.

        Returns:
            `training` says what was trained, `figures` what it was measured to do, `data` what it learned from.
        """

    @property
    def card_cases(self) -> int:
        """The number of cases that `make_card` runs."""
        return 0

    @classmethod
    @abc.abstractmethod
    def card_text(cls, card: Mapping[str, Any]) -> CardText:
        """What a card says, for people."""


@runtime_checkable  # for the check of types at every call
class Training(Protocol):
    """A training and all its state. It can be restored from a checkpoint, and then goes on bit for bit the same."""

    @property
    def curve(self) -> Sequence[Any]:
        """The validations so far, dataclasses: the first field is the x axis, `str` gives a line for the user."""

    def best_point(self) -> Any:
        """The point of the curve whose network is `best`."""

    @property
    def validated_on(self) -> int:
        """The number of cases, or of windows of tracks, of each validation."""

    @property
    def progress(self) -> float:
        """The part of the training that is done, from 0 to 1."""

    @property
    def best(self) -> nn.Module:
        """The network that was best on validation: what is saved in the end."""

    def run(self, after_validation: Callable[[], None]) -> None:
        """Train to the end, and call `after_validation` whenever `curve` has a new point."""

    def state(self) -> State:
        """The state of the training, for a checkpoint."""

    def restore(self, state: State) -> None:
        """Continue from a checkpoint. Raises RuntimeError where it is of another network."""
