"""The base class of the training methods: what `crowdbench.train.runner` needs of them."""

from __future__ import annotations

import abc
import contextlib
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any, ClassVar

from torch import Tensor, nn

from crowdbench.scenario.cases import Cases
from crowdbench.train import checkpoint

Point = dict[str, float]
"""A validation, a point of the training curve: numbers by the name of their column."""


class Training(abc.ABC):
    """A training and its state. After a restart from a checkpoint it continues bit for bit the same.

    Attributes:
        config: The options of the method.
        device: `cpu` or `cuda`.
        amount: The amount of training so far, in the unit of `config.length`, such as episodes.
        seconds: The training time so far, with validations.
        curve: The validations so far. The first number of each is the amount of training, and so the x axis.

    Args:
        config: See above.
        device: See above.

    Raises:
        InputError: A scenario, file or parameter does not exist or is impossible.
    """

    saved: ClassVar[Sequence[str]]
    """The attributes whose tensors are in a checkpoint: networks, optimizers and replay buffers."""

    card_cases: Mapping[str, Cases] = MappingProxyType({})
    """The cases that `card` runs, by the name of their split."""

    def __init__(self, config: Any, device: str) -> None:
        self.config, self.device = config, device
        self.amount, self.seconds = 0, 0.0
        self.curve: list[Point] = []

    @property
    def progress(self) -> float:
        """The finished part of the training, from 0 to 1."""
        if self.config.minutes is None:
            return min(1.0, self.amount / getattr(self.config, self.config.length))
        return min(1.0, self.seconds / (60.0 * self.config.minutes))

    @abc.abstractmethod
    def learn(self) -> Iterator[None]:
        """Train to the end, and yield whenever `curve` has a new point."""

    @abc.abstractmethod
    def describe(self, point: Point) -> str:
        """Describe a point of the curve in one line."""

    @abc.abstractmethod
    def best(self) -> tuple[Point, nn.Module]:
        """Return the best point of the curve, and the network of that validation, which is saved in the end."""

    @abc.abstractmethod
    def card(self, progress: Callable[[float], None]) -> dict[str, Any]:
        """Make the method's part of the card of the best network, as JSON.

        Args:
            progress: Called with the number of the `card_cases` that were run since its last call.

        Returns:
            `training`: conditions of the training; `figures`: measured results; `data`: the data, in words.
        """

    @contextlib.contextmanager
    def timed(self) -> Iterator[None]:
        """Add the time inside to `seconds`."""
        start = time.perf_counter()
        yield
        self.seconds += time.perf_counter() - start

    def add_point(self, **quantities: float) -> None:
        """Add a point with these quantities to the curve."""
        self.curve.append({self.config.length: self.amount, "seconds": self.seconds, **quantities})

    def restore(self, tensors: Mapping[str, Tensor], facts: Mapping[str, Any]) -> None:
        """Restore the tensors and facts of a checkpoint. Raises RuntimeError if it is of another network."""
        self.amount, self.seconds = facts["amount"], facts["seconds"]
        self.curve = [dict(point) for point in facts["curve"]]
        for name in self.saved:
            checkpoint.restore(name, getattr(self, name), tensors)
