"""What the trainings of networks that drive share: scenarios, validations, the choice of a network, its figures."""

from __future__ import annotations

import abc
import copy
import math
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar, cast, runtime_checkable

import numpy as np
from torch import Tensor, nn

from crowdbench.catalog import load_scenario
from crowdbench.metrics import METRICS, Metric
from crowdbench.planners.base import Planner
from crowdbench.planners.driver import Driver
from crowdbench.runs.results import Episodes, to_json
from crowdbench.runs.rollout import rollout
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario
from crowdbench.train.checkpoint import State, part_of, tensors_of
from crowdbench.train.method import Request
from crowdbench.utils.defaults import BATCH
from crowdbench.utils.errors import InputError

VALIDATION_CASES = Cases("val", 0, 200)
"""The cases of a validation, in each of its scenarios."""

CASES = {"validation": Cases("val", 1000, 1200), "test": Cases("test", 0, 500)}
"""The cases of the figures on a card, by the name of their split. None of them chooses a checkpoint."""


@runtime_checkable
class Validation(Protocol):
    """A point of the training curve of a network that drives."""

    @property
    def success(self) -> float:
        """The success rate on validation cases, from 0 to 1."""

    @property
    def navigation_time_or_limit(self) -> float:
        """The mean time to the goal in seconds, the time limit for failures."""


Point = TypeVar("Point", bound=Validation)
Network = TypeVar("Network", bound=nn.Module)


class DrivingTraining(abc.ABC, Generic[Network, Point]):
    """A training of a network that drives. A subclass has what is trained, `run`, `state` and `restore`.

    Raises:
        InputError: There is no such scenario, or it has too few cases: see `load_scenarios`.
    """

    def __init__(self, request: Any) -> None:
        self.request = request
        self.scenario, self.validation = load_scenarios(request, request.validation_names)
        self.seconds = 0.0
        self.curve: list[Point] = []
        self.validated = nn.ModuleList()

    @property
    @abc.abstractmethod
    def current(self) -> Network:
        """The network as it is, of which a copy is kept at each validation."""

    @abc.abstractmethod
    def planner(self, network: Network) -> Planner:
        """The planner that validations and cards measure a network with."""

    def drive_validation(self) -> Callable[[Metric], float]:
        """Drive the validation cases and keep the network as it is. Returns what gives the mean of a metric."""
        start, network = time.perf_counter(), copy.deepcopy(self.current)
        driver = Driver(self.planner(network), self.request.network)
        traces = [rollout(driver, scenario, VALIDATION_CASES, undisturbed=False) for scenario in self.validation]
        self.validated.append(network)
        self.seconds += time.perf_counter() - start
        return lambda metric: float(np.nanmean([metric(trace) for trace in traces]))

    def best_point(self) -> Point:
        """The point of the curve whose network is `best`."""
        return choose_point(self.curve, self.validated_on)

    @property
    def validated_on(self) -> int:
        """The number of cases of each validation."""
        return len(VALIDATION_CASES) * len(self.validation)

    @property
    def best(self) -> Network:
        """See `crowdbench.train.method.Training`. Before the first validation, the network as it is."""
        if not self.curve:
            return self.current
        return cast(Network, self.validated[self.curve.index(self.best_point())])

    def measure(
        self, splits: Sequence[str], metrics: Sequence[str], progress: Callable[[float], None]
    ) -> dict[str, Any]:
        """Run the best network through the cases of a card, in the scenario that it was trained in.

        Args:
            splits: Those of `CASES`.
            metrics: The names of the metrics.
            progress: Called as by `rollout`.

        Returns:
            For every split the cases and the mean of every metric with its 95 % interval, as JSON.
        """
        driver = Driver(self.planner(self.best), self.request.network)
        chosen = {metric: METRICS[metric] for metric in metrics}
        figures = {}
        for split in splits:
            cases = CASES[split]
            traces = (rollout(driver, self.scenario, part, progress=progress) for part in cases.batches(BATCH))
            parts = [Episodes.of(trace, chosen) for trace in traces]
            figures[split] = {"cases": str(cases), "metrics": to_json(Episodes.join(parts).summary())}
        return figures

    def validated_tensors(self) -> dict[str, Tensor]:
        """The networks of all validations, for a checkpoint."""
        return tensors_of("validated", self.validated)

    def restore_curve(self, state: State, point: Callable[..., Point]) -> None:
        """Restore the training time, the curve and the networks of its points."""
        self.validated = nn.ModuleList(copy.deepcopy(self.current) for _ in state.curve)
        self.validated.load_state_dict(part_of("validated", state.tensors))
        self.seconds = state.facts["seconds"]
        self.curve = [point(**each) for each in state.curve]


def load_scenarios(request: Request, validation: Sequence[str]) -> tuple[Scenario, list[Scenario]]:
    """Load the scenarios of a training.

    Args:
        request: What is asked for.
        validation: The scenarios that choose the checkpoint, by name or path; none for the one to train in.

    Returns:
        The scenario to train in, and those to validate in.

    Raises:
        InputError: There is no such scenario, the folder of recorded tracks does not go with them, or one of them has
            too few cases.
    """
    data = None if request.data is None else Path(request.data)
    scenario = load_scenario(request.scenario, request.overrides, data=data)
    validated = [load_scenario(name, data=data) for name in validation] or [scenario]
    tracked = [(place, place.tracks) for place in (scenario, *validated) if place.tracks]
    if not tracked:
        scenario.check_data(data)
    for place, tracks in tracked:
        if tracks.has_cars:
            raise InputError(
                f"{place.name} has a case for each window of time with a car in the scene {tracks.scene}, too few to "
                "train, validate and measure a network in: use another scenario, such as eth_reactive"
            )
    return scenario, validated


def choose_point(curve: Sequence[Point], cases: int) -> Point:
    """The point of a training curve whose network is kept: by success first, within noise, and by time second.

    Args:
        curve: The points.
        cases: The number of cases of each point.

    Returns:
        The quickest of the points whose success is at most one standard error below the largest (the rule of Breiman
        et al., *Classification and Regression Trees*, 1984); the latest one, if several are as quick. For the standard
        error two successes and two failures are added (Agresti and Coull 1998), or else it would be 0 where all
        cases succeed.
    """
    most = max(point.success for point in curve)
    share = (most * cases + 2) / (cases + 4)
    error = math.sqrt(share * (1 - share) / (cases + 4))
    return min(
        (point for point in reversed(curve) if point.success >= most - error),
        key=lambda point: point.navigation_time_or_limit,
    )
