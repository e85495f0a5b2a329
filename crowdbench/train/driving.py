"""Validations of networks that drive: the choice of a checkpoint, and the figures of the card."""

from __future__ import annotations

import abc
import copy
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from torch import Tensor, nn

from crowdbench.catalog import load_scenario
from crowdbench.metrics.registry import METRICS
from crowdbench.networks import card as cards
from crowdbench.planners.driver import Driver
from crowdbench.planners.planner import Planner
from crowdbench.results.episodes import Episodes
from crowdbench.runs.rollout import rollout
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario
from crowdbench.train.config import split_names
from crowdbench.train.training import Point, Training
from crowdbench.utils.defaults import BATCH
from crowdbench.utils.errors import InputError
from crowdbench.utils.tables import plain

VALIDATION_CASES = Cases("val", 0, 200)
"""The cases of a validation, in each of its scenarios."""

CARD_CASES = {"validation": Cases("val", 1000, 1200), "test": Cases("test", 0, 500)}
"""The cases of the figures on a card, by the name of their split. None of them chooses a checkpoint."""


class DrivingTraining(Training):
    """A training of a network that drives.

    Attributes:
        scenario: The training scenario, in which the card's figures are measured too.
        validation: The scenarios of validations.
        validated: The networks of all validations.
        current: The network that is copied at each validation, set by the constructor of a method.

    Raises:
        InputError: There is no such scenario, or the folder of recorded tracks does not belong to it.
    """

    metrics: ClassVar[Sequence[str]] = ("success_rate", "collision_rate", "timeout_rate", "navigation_time")
    """The metrics on the card."""

    curve_metric: ClassVar[str]
    """The metric in the curve in addition to success and time."""

    several: ClassVar[bool] = False
    """True if the method trains in scenarios with several vehicles."""

    current: nn.Module

    def __init__(self, config: Any, device: str) -> None:
        super().__init__(config, device)
        data = None if config.data is None else Path(config.data)
        self.scenario = load_scenario(config.scenario, config.overrides, data=data)
        validation = [load_scenario(name, data=data) for name in split_names(config.validation)]
        self.validation = validation or [self.scenario]
        self.also_train_in = [load_scenario(name, data=data) for name in split_names(config.beside)]
        if not any(scenario.tracks for scenario in (self.scenario, *validation, *self.also_train_in)):
            self.scenario.check_data(data)
        for scenario in (self.scenario, *validation, *self.also_train_in):
            if scenario.rules.vehicles > 1 and not self.several:
                has = f"{scenario.name} has {scenario.rules.vehicles} vehicles"
                raise InputError(f"{has}, but a training of {config.network} drives one")
        self.validated = nn.ModuleList()
        splits = ["validation", "test"] if config.card == "test" else ["validation"]
        self.card_cases = {split: CARD_CASES[split] for split in splits}

    @abc.abstractmethod
    def planner(self, network: Any) -> Planner:
        """Make the planner of validations and cards."""

    @abc.abstractmethod
    def conditions(self) -> dict[str, Any]:
        """Return the conditions of the training on a card that are specific to the method."""

    def validate(self, **quantities: float) -> None:
        """Run the validation cases. Add the current network to `validated`, and a point to the curve.

        The point has means over the vehicles of the cases of all validation scenarios: `success` from 0 to 1;
        `navigation_time_or_limit` in seconds, the time limit for failures; and `curve_metric`.

        Args:
            quantities: Further quantities of the point, which precede these means.
        """
        with self.timed():
            network = copy.deepcopy(self.current)
            driver = Driver(self.planner(network), self.config.network)
            traces = [rollout(driver, scenario, VALIDATION_CASES, undisturbed=False) for scenario in self.validation]
            self.validated.append(network)
        for name in ("success_rate", "navigation_time_or_limit", self.curve_metric):
            column = "success" if name == "success_rate" else name
            quantities[column] = float(np.nanmean(np.concatenate([METRICS[name](trace) for trace in traces])))
        self.add_point(**quantities)

    def describe(self, point: Point) -> str:
        """See `Training`."""
        amount = f"{point[self.config.length]} {self.config.length}"
        jerk = f", jerk {point['jerk']:.1f}" if "jerk" in point else ""
        return (
            f"{amount:>15}, {point['seconds']:4.0f} s: on validation cases {100 * point['success']:.1f} % success in "
            f"{point['navigation_time_or_limit']:.2f} s (a failure counts as the time limit){jerk}"
        )

    def best(self) -> tuple[Point, nn.Module]:
        """See `Training`."""
        point = choose_point(self.curve, len(VALIDATION_CASES) * len(self.validation))
        return point, self.validated[self.curve.index(point)]

    def card(self, progress: Callable[[float], None]) -> dict[str, Any]:
        """See `Training`. The figures belong to the best network in the training scenario."""
        length = self.config.length
        point, network = self.best()
        driver = Driver(self.planner(network), self.config.network)
        metrics = {metric: METRICS[metric] for metric in self.metrics}
        figures = {}
        for split, cases in self.card_cases.items():
            traces = (rollout(driver, self.scenario, part, progress=progress) for part in cases.batches(BATCH))
            episodes = Episodes.join([Episodes.of(trace, metrics) for trace in traces])
            figures[split] = {"cases": str(cases), "metrics": plain(episodes.summary())}
        validation = {"scenarios": [scenario.name for scenario in self.validation], "cases": str(VALIDATION_CASES)}
        return {
            "training": {
                "scenario": describe_scenario(self.scenario),
                **self.conditions(),
                "validation": validation,
                "seed": self.config.seed,
                length: self.amount,
                f"kept_after_{length}": point[length],
                "minutes": round(self.seconds / 60, 1),
            },
            "figures": figures,
            "data": cards.episodes(scenario.table for scenario in (self.scenario, *self.also_train_in)),
        }

    def restore(self, tensors: Mapping[str, Tensor], facts: Mapping[str, Any]) -> None:
        """See `Training`."""
        self.validated.extend(copy.deepcopy(self.current) for _ in facts["curve"])
        super().restore(tensors, facts)


def choose_point(curve: Sequence[Point], cases: int) -> Point:
    """Choose a point of a training curve: by success first, within noise, and by time second.

    Args:
        curve: The points, with `success` from 0 to 1 and `navigation_time_or_limit` in seconds.
        cases: The number of cases of each point.

    Returns:
        The quickest of the points whose success is at most one standard error below the largest (the rule of Breiman et
        al., *Classification and Regression Trees*, 1984); the latest of equally quick ones. The standard error is
        computed with two more successes and two more failures (Agresti and Coull 1998), because otherwise it would be 0
        if all cases succeed.
    """
    best = max(point["success"] for point in curve)
    rate = (best * cases + 2) / (cases + 4)
    error = math.sqrt(rate * (1 - rate) / (cases + 4))
    within_noise = [point for point in reversed(curve) if point["success"] >= best - error]
    return min(within_noise, key=lambda point: point["navigation_time_or_limit"])


def describe_scenario(scenario: Scenario) -> dict[str, Any]:
    """Return the facts about a scenario on a card: name, digest and all keys."""
    return {"name": scenario.name, "digest": scenario.digest, **scenario.table}
