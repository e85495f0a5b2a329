"""The base class of the training methods."""

from __future__ import annotations

import abc
import contextlib
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, ClassVar

from torch import Tensor, nn

from crowdbench.scenario.scenario import Scenario
from crowdbench.train import checkpoint


class Training(abc.ABC):
    """A training and its state. After a restart from a checkpoint it continues bit for bit the same.

    Attributes:
        config: The options of the method.
        device: `cpu` or `cuda`.
        seconds: The training time so far.
        curve: The validations so far, dataclasses: the first field is the x axis, `str` gives a line for the user.

    Args:
        config: See above.
        device: See above.
    """

    point: ClassVar[Callable[..., Any]]
    """The class of the points of the curve."""

    parts: ClassVar[Sequence[str]]
    """The attributes whose tensors are in a checkpoint."""

    counters: ClassVar[Sequence[str]]
    """The attributes that are numbers in a checkpoint."""

    def __init__(self, config: Any, device: str) -> None:
        self.config, self.device = config, device
        self.seconds = 0.0
        self.curve: list[Any] = []

    @property
    def progress(self) -> float:
        """The finished part of the training, from 0 to 1."""
        return self.config.progress(getattr(self, self.config.length), self.seconds)

    @abc.abstractmethod
    def learn(self) -> Iterator[None]:
        """Train to the end, and yield whenever `curve` has a new point."""

    @property
    @abc.abstractmethod
    def best(self) -> nn.Module:
        """The network that was best on validation, which is saved in the end."""

    @abc.abstractmethod
    def best_point(self) -> Any:
        """Return the point of the curve of `best`."""

    @abc.abstractmethod
    def card(self, progress: Callable[[float], None]) -> dict[str, Any]:
        """Make the method's part of the card of the best network, as JSON.

        Args:
            progress: Called with the number of the `card_cases` that were run since its last call.

        Returns:
            `training`: conditions of the training; `figures`: measured results; `data`: the data, in words.
        """

    @property
    def card_cases(self) -> int:
        """The number of cases that `card` runs."""
        return 0

    def intervals(self) -> dict[str, list[tuple[float, float]]]:
        """Return the confidence intervals of the curve, by the name of the quantity."""
        return {}

    @contextlib.contextmanager
    def timed(self) -> Iterator[None]:
        """Add the time inside to `seconds`."""
        start = time.perf_counter()
        yield
        self.seconds += time.perf_counter() - start

    def tensors(self) -> dict[str, Tensor]:
        """Return the tensors of all parts, for a checkpoint."""
        parts = (checkpoint.tensors_of(name, getattr(self, name)) for name in self.parts)
        return {name: tensor for part in parts for name, tensor in part.items()}

    def restore(self, tensors: Mapping[str, Tensor], facts: Mapping[str, Any]) -> None:
        """Restore the tensors and facts of a checkpoint. Raises RuntimeError if it is of another network."""
        for name in self.counters:
            setattr(self, name, facts["counters"][name])
        self.curve = [type(self).point(**point) for point in facts["curve"]]
        for name in self.parts:
            checkpoint.restore(name, getattr(self, name), tensors)


def describe_scenario(scenario: Scenario) -> dict[str, Any]:
    """Return the facts about a scenario on a card: name, digest and all keys."""
    return {"name": scenario.name, "digest": scenario.digest, **scenario.table}
