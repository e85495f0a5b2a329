"""The common part of trainings of networks that drive: scenarios, validations, the choice of a network, its card."""

from __future__ import annotations

import abc
import copy
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar, cast

import numpy as np
from torch import Tensor, nn

from crowdbench.catalog import load_scenario
from crowdbench.metrics import METRICS, Metric
from crowdbench.metrics.summary import wilson
from crowdbench.networks import card as cards
from crowdbench.planners.base import Planner
from crowdbench.planners.driver import Driver
from crowdbench.runs.results import Episodes, to_json
from crowdbench.runs.rollout import rollout
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario
from crowdbench.train.config import Config, split_names
from crowdbench.train.training import Training, describe_scenario
from crowdbench.utils.defaults import BATCH
from crowdbench.utils.errors import InputError

VALIDATION_CASES = Cases("val", 0, 200)
"""The cases of a validation, in each of its scenarios."""

CASES = {"validation": Cases("val", 1000, 1200), "test": Cases("test", 0, 500)}
"""The cases of the figures on a card, by the name of their split. None of them chooses a checkpoint."""


Network = TypeVar("Network", bound=nn.Module)


class DrivingTraining(Training, Generic[Network]):
    """A training of a network that drives.

    Attributes:
        scenario: The training scenario, in which the card's figures are measured too.
        validation: The scenarios of validations.
        validated: The networks of all validations.

    Raises:
        InputError: There is no such scenario, or it has too few cases: see `load_scenarios`.
    """

    metrics: ClassVar[Sequence[str]] = ("success_rate", "collision_rate", "timeout_rate", "navigation_time")
    """The metrics on the card."""

    def __init__(self, config: Any, device: str) -> None:
        super().__init__(config, device)
        self.scenario, self.validation = load_scenarios(config, split_names(config.validation))
        self.validated = nn.ModuleList()

    @property
    @abc.abstractmethod
    def current(self) -> Network:
        """The present network, which is copied at each validation."""

    @abc.abstractmethod
    def planner(self, network: Network) -> Planner:
        """Make the planner of validations and cards."""

    @abc.abstractmethod
    def conditions(self) -> dict[str, Any]:
        """Return the conditions of the training on a card that are specific to the method."""

    def validate(self, *metrics: Metric) -> list[float]:
        """Drive the validation cases, and add the present network to `validated`. Returns the mean of each metric."""
        with self.timed():
            network = copy.deepcopy(self.current)
            driver = Driver(self.planner(network), self.config.network)
            traces = [rollout(driver, scenario, VALIDATION_CASES, undisturbed=False) for scenario in self.validation]
            self.validated.append(network)
        return [float(np.nanmean([metric(trace) for trace in traces])) for metric in metrics]

    def best_point(self) -> Any:
        """See `Training`."""
        return choose_point(self.curve, self.validated_on)

    @property
    def best(self) -> Network:
        """See `Training`."""
        return cast(Network, self.validated[self.curve.index(self.best_point())])

    @property
    def validated_on(self) -> int:
        """The number of cases of each validation."""
        return len(VALIDATION_CASES) * len(self.validation)

    def intervals(self) -> dict[str, list[tuple[float, float]]]:
        """See `Training`: Wilson's interval of the success rate."""
        solved = [round(point.success * self.validated_on) for point in self.curve]
        estimates = [wilson(np.arange(self.validated_on) < count) for count in solved]
        return {"success": [(estimate.low, estimate.high) for estimate in estimates]}

    @property
    def splits(self) -> dict[str, Cases]:
        """The cases of the card."""
        return {split: cases for split, cases in CASES.items() if split in ("validation", self.config.card)}

    @property
    def card_cases(self) -> int:
        """See `Training`."""
        return sum(map(len, self.splits.values()))

    def card(self, progress: Callable[[float], None]) -> dict[str, Any]:
        """See `Training`. The figures are those of the best network in the training scenario."""
        length = self.config.length
        validation = {"scenarios": [scenario.name for scenario in self.validation], "cases": str(VALIDATION_CASES)}
        driver = Driver(self.planner(self.best), self.config.network)
        metrics = {metric: METRICS[metric] for metric in self.metrics}
        figures = {}
        for split, cases in self.splits.items():
            traces = (rollout(driver, self.scenario, part, progress=progress) for part in cases.batches(BATCH))
            episodes = Episodes.join([Episodes.of(trace, metrics) for trace in traces])
            figures[split] = {"cases": str(cases), "metrics": to_json(episodes.summary())}
        return {
            "training": {
                "scenario": describe_scenario(self.scenario),
                **self.conditions(),
                "validation": validation,
                "seed": self.config.seed,
                length: getattr(self.curve[-1], length),
                f"kept_after_{length}": getattr(self.best_point(), length),
                "minutes": round(self.seconds / 60, 1),
            },
            "figures": figures,
            "data": cards.episodes(self.scenario.table),
        }

    def restore(self, tensors: Mapping[str, Tensor], facts: Mapping[str, Any]) -> None:
        """See `Training`."""
        self.validated = nn.ModuleList(copy.deepcopy(self.current) for _ in facts["curve"])
        super().restore(tensors, facts)


def load_scenarios(config: Config, validation: Sequence[str]) -> tuple[Scenario, list[Scenario]]:
    """Load the scenarios of a training.

    Args:
        config: The options of the training.
        validation: The scenarios of validations, by name or path; none for the training scenario.

    Returns:
        The training scenario, and the scenarios of validations.

    Raises:
        InputError: There is no such scenario, the folder of recorded tracks does not go with them, or one of them has
            too few cases.
    """
    data = None if config.data is None else Path(config.data)
    scenario = load_scenario(config.scenario, config.overrides, data=data)
    validated = [load_scenario(name, data=data) for name in validation] or [scenario]
    if not any(loaded.tracks for loaded in (scenario, *validated)):
        scenario.check_data(data)
    for loaded in (scenario, *validated):
        if loaded.tracks and loaded.tracks.has_cars:
            raise InputError(
                f"{loaded.name} has a case for each window of time with a car in the scene {loaded.tracks.scene}, too "
                "few to train, validate and measure a network in: use another scenario, such as eth_reactive"
            )
    return scenario, validated


def choose_point(curve: Sequence[Any], cases: int) -> Any:
    """Choose a point of a training curve: by success first, within noise, and by time second.

    Args:
        curve: The points, with `success` from 0 to 1 and `navigation_time_or_limit` in seconds.
        cases: The number of cases of each point.

    Returns:
        The quickest of the points whose success is at most one standard error below the largest (the rule of Breiman
        et al., *Classification and Regression Trees*, 1984); the latest of equally quick ones. The standard error is
        that of two successes and two failures more (Agresti and Coull 1998), because it would be 0 where all cases
        succeed.
    """
    most = max(point.success for point in curve)
    share = (most * cases + 2) / (cases + 4)
    error = math.sqrt(share * (1 - share) / (cases + 4))
    return min(
        (point for point in reversed(curve) if point.success >= most - error),
        key=lambda point: point.navigation_time_or_limit,
    )
