"""What is asked for of the training of a value network, and the card of what came out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from crowdbench import catalog
from crowdbench.errors import InputError
from crowdbench.evaluate.driver import Driver
from crowdbench.evaluate.metrics import METRICS
from crowdbench.evaluate.results import Episodes, to_json
from crowdbench.evaluate.rollout import rollout
from crowdbench.planners.lookahead import ValuePlanner
from crowdbench.predict import ConstantVelocity
from crowdbench.predict.load import load_predictor
from crowdbench.scenario.cases import Cases
from crowdbench.settings import BATCH
from crowdbench.train.value import Setup, Training
from crowdbench.value.networks import NETWORKS

FIGURES = {"validation": Cases("val", 0, 1000), "test": Cases("test", 0, 500)}
"""The cases that a finished network is measured on, for its card."""

MEASURED = ("success_rate", "collision_rate", "timeout_rate", "navigation_time")


@dataclass(frozen=True)
class ValueRequest:
    """What is asked for, as in the options of `crowdbench train`."""

    network: str
    scenario: str
    overrides: Mapping[str, Any]
    predictor: str
    seed: int
    episodes: int
    minutes: float | None

    @property
    def command(self) -> str:
        """The command that asks for it."""
        words = ["crowdbench train", self.network, "--scenario", self.scenario]
        words += [f"--set '{key}={value}'" for key, value in self.overrides.items()]
        words += ["--predictor", self.predictor, "--seed", str(self.seed)]
        words += ["--episodes", str(self.episodes)] if self.minutes is None else ["--minutes", f"{self.minutes:g}"]
        return " ".join(words)

    def training(self, device: str) -> Training:
        """A new training of it. Raises InputError where there is no such network, scenario or predictor."""
        if self.network not in NETWORKS:
            raise InputError(f"no network is called {self.network!r}; there are {', '.join(NETWORKS)}, sgan")
        _, predictor = load_predictor(self.predictor)
        scenario = catalog.load_scenario(self.scenario, self.overrides)
        return Training(Setup(self.network, scenario, predictor, self.seed, self.episodes, self.minutes, device))

    def card(self, training: Training, progress: Callable[[int], None]) -> dict[str, Any]:
        """What its card says of the training and of what the kept network does among the crowd it was trained in."""
        scenario = training.setup.scenario
        return {
            "training": {
                "scenario": {"name": scenario.name, "digest": scenario.digest, **scenario.table},
                "predictor": self.predictor,
                "seed": self.seed,
                "episodes": training.curve[-1].episodes,
                "kept_after_episodes": training.kept.episodes,
                "minutes": round(training.seconds / 60, 1),
            },
            "figures": {split: _figures(training, cases, progress) for split, cases in FIGURES.items()},
            "data": "simulated episodes only",
        }

    @property
    def measured(self) -> int:
        """How many cases the card takes."""
        return sum(map(len, FIGURES.values()))


def _figures(training: Training, cases: Cases, progress: Callable[[int], None]) -> dict[str, Any]:
    """How the kept network does at constant velocity."""
    driver = Driver(ValuePlanner(ConstantVelocity(), training.best), training.setup.network)
    metrics = {name: METRICS[name] for name in MEASURED}
    traces = (rollout(driver, training.setup.scenario, part, progress=progress) for part in cases.batches(BATCH))
    parts = [Episodes.of(trace, metrics) for trace in traces]
    return {"cases": str(cases), "metrics": to_json(Episodes.joined(parts).summary())}
