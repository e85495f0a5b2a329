"""What a user asks for in the training of a value network, and what the card says of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from crowdbench.train.method import Request, Training, option
from crowdbench.weights import card as cards

EPISODES = 4000
"""The episodes of a training where their number is not given."""


@dataclass(frozen=True, kw_only=True)
class ValueRequest(Request):
    """What is asked for of the training in `crowdbench.train.value`.

    Attributes:
        predictor: The predictor in the lookahead: a name, or the path of its file.
        episodes: The episodes that the network drives, demonstrations not counted.
    """

    predictor: str = option("oracle", "The predictor in the lookahead: a name or ./mine.py")
    episodes: int = option(EPISODES, "Train for this many episodes", least=1)

    length: ClassVar[str] = "episodes"

    @classmethod
    def check(cls, options: Mapping[str, Any]) -> None:
        """See `Request`. Any options go together."""

    @property
    def arguments(self) -> Sequence[str]:
        """See `Request`."""
        return [*self.scenario_arguments, "--predictor", self.predictor]

    @property
    def use(self) -> str:
        """See `Request`."""
        # The planner `sarl` is privileged, as published.
        return f"run --planner {'sarl_cvm' if self.network == 'sarl' else self.network}"

    def training(self, device: str) -> Training:
        """See `Request`. Raises InputError where there is no such scenario or predictor."""
        # Imported here, because torch and the simulator take seconds and the options are shown without them.
        from crowdbench.catalog import load_scenario
        from crowdbench.predict.load import load_predictor
        from crowdbench.train.value import Setup, Training

        _, predictor = load_predictor(self.predictor)
        scenario = load_scenario(self.scenario, self.overrides)
        return Training(Setup(self.network, scenario, predictor, self.seed, self.episodes, self.minutes, device))

    def card(self, training: Any, progress: Callable[[float], None]) -> dict[str, Any]:
        """See `Request`. The figures are those of the best network in the scenario that it was trained in."""
        from crowdbench.train.value_figures import figures

        scenario = training.setup.scenario
        return {
            "training": {
                "scenario": {"name": scenario.name, "digest": scenario.digest, **scenario.table},
                "predictor": self.predictor,
                "seed": self.seed,
                "episodes": training.curve[-1].episodes,
                "kept_after_episodes": training.chosen.episodes,
                "minutes": round(training.seconds / 60, 1),
            },
            "figures": figures(training.best, scenario, progress),
            "data": "simulated episodes only",
        }

    @property
    def card_cases(self) -> int:
        """See `Request`."""
        from crowdbench.train.value_figures import CASES

        return sum(map(len, CASES.values()))

    @staticmethod
    def card_headline(card: Mapping[str, Any]) -> str:
        """See `Request`."""
        trained, success = card["training"], card["figures"]["test"]["metrics"]["success_rate"]
        where = f"with the {trained['predictor']} predictor in {cards.crowd(trained['scenario'])}"
        return f"{where}: {cards.rate(success)} success on test cases"

    @staticmethod
    def card_rows(card: Mapping[str, Any]) -> Mapping[str, str]:
        """See `Request`."""
        trained = card["training"]
        return {
            "scenario": f"{cards.crowd(trained['scenario'])} (digest {trained['scenario']['digest']})",
            "predictor in the lookahead": trained["predictor"],
            "checkpoint": f"chosen at episode {trained['kept_after_episodes']} of {trained['episodes']}",
        }

    @staticmethod
    def card_figures(card: Mapping[str, Any]) -> Sequence[str]:
        """See `Request`."""
        lines = [
            "Measured once, after training, in the same scenario, with the constant-velocity predictor in the "
            "lookahead (95 % intervals):",
            "",
            "| cases | success | collisions | time-outs | navigation time |",
            "|---|---|---|---|---|",
        ]
        for split, figures in card["figures"].items():
            measured = figures["metrics"]
            rates = [cards.rate(measured[f"{outcome}_rate"]) for outcome in ("success", "collision", "timeout")]
            time = cards.seconds(measured["navigation_time"])
            lines.append(f"| {split} {figures['cases']} | {' | '.join(rates)} | {time} |")
        return lines
