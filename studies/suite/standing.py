"""The episodes of a planner in the ranked scenarios, and their scores under several prices of closeness."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from crowdbench import Episodes
from crowdbench.metrics import Estimate, fault_bound, is_competent, mean_over_networks
from crowdbench.runs import Run
from studies.folder import read_episodes

Values = Float[np.ndarray, "network scenario case"]


@dataclass(frozen=True)
class Standing:
    """A planner in scenarios with one track of sensing.

    Attributes:
        score: The score of each episode.
        success: 1 for each success, 0 elsewhere.
        at_fault: 1 for each collision at fault, 0 elsewhere.
        timeout: 1 for each time-out, 0 elsewhere.
        t_empty: The least time in seconds.
        time: The time to the goal in seconds; NaN for failures.
        close: Seconds close to pedestrians; NaN for failures.
        close_moving: Those while the vehicle moves.
    """

    score: Values
    success: Values
    at_fault: Values
    timeout: Values
    t_empty: Values
    time: Values
    close: Values
    close_moving: Values

    @classmethod
    def of(cls, episodes: Sequence[Sequence[Episodes]]) -> Standing:
        """Return the standing of a planner from its episodes, by scenario and network."""

        def values(name: str) -> Values:
            by_scenario = [[each.columns[name].astype(float) for each in networks] for networks in episodes]
            return np.array(by_scenario).swapaxes(0, 1)

        return cls(
            score=values("score"),
            success=values("success_rate"),
            at_fault=values("at_fault_rate"),
            timeout=values("timeout_rate"),
            t_empty=values("t_empty"),
            time=values("navigation_time"),
            close=values("t_close"),
            close_moving=values("t_close_moving"),
        )

    @classmethod
    def read(cls, runs: Sequence[Sequence[Run]], out: Path) -> Standing:
        """Read the standing of a planner from its runs, by scenario and network."""
        return cls.of([[read_episodes(run, out) for run in networks] for networks in runs])

    @property
    def weights(self) -> Float[np.ndarray, "scenario"]:
        """Equal weights of the scenarios."""
        number = self.score.shape[1]
        return np.full(number, 1.0 / number)

    @property
    def is_competent(self) -> bool:
        """True if the planner passes the gate on collisions at fault."""
        return is_competent(self.at_fault)

    @property
    def fault_bound(self) -> float:
        """The upper 95 % bound of the rate of collisions at fault over all scenarios, the largest of the networks."""
        return fault_bound(self.at_fault)

    def mean(self) -> Estimate:
        """Return the mean score over scenarios. Its interval includes the spread of networks."""
        # Scenarios are no random sample: their differences do not count in the interval.
        of_scenarios = self.score.mean(axis=(0, 2), keepdims=True)
        around = self.score - of_scenarios + of_scenarios.mean()
        return mean_over_networks(around.reshape(len(around), -1))

    def priced(self, factor: float = 1.0, moving: bool = False) -> Values:
        """Return scores with another price of closeness.

        Args:
            factor: Seconds that a second close to a pedestrian costs.
            moving: True if only seconds in which the vehicle moves count as close.
        """
        close = self.close_moving if moving else self.close
        score = self.t_empty / (np.maximum(self.time, self.t_empty) + factor * close)
        return np.where(self.success > 0.0, score, 0.0)
