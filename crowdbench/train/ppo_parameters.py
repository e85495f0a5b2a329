"""The parameters of proximal policy optimization, which `crowdbench train ppo --ppo name=value` sets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from crowdbench.plugins.options import Option
from crowdbench.utils.errors import is_number, require, require_count, require_positive


@dataclass(frozen=True)
class Parameters:
    """How PPO learns (Schulman et al. 2017).

    Attributes:
        worlds: Worlds that are driven at once [1].
        steps: Steps of each world between two updates [1].
        segments: Worlds in a minibatch, each with all its steps in order of time, as recurrent policies need them [1].
        epochs: How often each update goes through its steps [1].
        learning_rate: Of Adam at the start; it falls linearly to 0 [1].
        gamma: Discount per step [1].
        trace: Lambda of the generalized advantage estimate (Schulman et al. 2016) [1].
        clip: By how much the ratio of two probabilities differs from 1 at most, where it counts (equation 7) [1].
        value_weight: Weight of the value's squared error in the loss [1].
        max_norm: The largest norm of a gradient: larger ones are scaled down [1].

    Raises:
        InputError: A number is impossible, or there are fewer worlds than in a minibatch.
    """

    worlds: int = 256
    steps: int = 32
    segments: int = 32
    epochs: int = 4
    learning_rate: float = 7e-4
    gamma: float = 0.97
    trace: float = 0.95
    clip: float = 0.2
    value_weight: float = 0.5
    max_norm: float = 0.5

    def __post_init__(self) -> None:
        for name in ("worlds", "steps", "segments", "epochs"):
            require_count(name, getattr(self, name))
        require(
            "segments", self.segments, self.segments <= self.worlds, f"{self.worlds}, the number of worlds, at most"
        )
        for name in ("learning_rate", "clip", "value_weight", "max_norm"):
            require_positive(name, getattr(self, name))
        for name in ("gamma", "trace"):
            value = getattr(self, name)
            require(name, value, is_number(value) and 0.0 <= value <= 1.0, "a number from 0 to 1")


def read_parameters(given: Mapping[str, Any]) -> Parameters:
    """The parameters with those that a user has given.

    Args:
        given: Values by name.

    Raises:
        InputError: There is no such parameter, or its value is impossible.
    """
    found: Parameters = Option("--ppo", Parameters(), (Parameters,)).argument(dict(given))
    return found
