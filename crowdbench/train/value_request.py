"""What a user asks for in the training of a value network, and what the card says of it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from crowdbench.train.method import Request, Training, option
from crowdbench.weights import card as cards

EPISODES = 4000
"""The episodes of a training where their number is not given."""

UNLIMITED = {"max_acceleration": math.inf, "max_turn": math.pi, "max_velocity_change": math.inf}
"""The limits of `Limits` that exclude nothing."""


@dataclass(frozen=True, kw_only=True)
class ValueRequest(Request):
    """What is asked for of the training in `crowdbench.train.value`.

    Attributes:
        predictor: The predictor in the lookahead: a name, or the path of its file.
        episodes: The episodes that the network drives, demonstrations not counted.
        max_acceleration: As in `Limits`; None for no limit, and so are the next two.
        max_turn: As in `Limits`.
        max_velocity_change: As in `Limits`.
        validation: The scenarios that choose the checkpoint, by name or path, with commas between them; None for the
            one that is trained in.
    """

    predictor: str = option("oracle", "The predictor in the lookahead: a name or ./mine.py")
    episodes: int = option(EPISODES, "Train for this many episodes", least=1)
    max_acceleration: float | None = option(None, "Limit the commands: largest change of speed, per second [m/s^2]")
    max_turn: float | None = option(None, "Limit the commands: largest change of heading in a step [rad]")
    max_velocity_change: float | None = option(None, "Limit the commands: largest change of velocity in a step [m/s]")
    validation: str | None = option(None, "Scenarios that choose the checkpoint, as in a,b; else the one to train in")

    length: ClassVar[str] = "episodes"

    @classmethod
    def check(cls, options: Mapping[str, Any]) -> None:
        """See `Request`. The limits are checked when the training is made; any other options go together."""

    @property
    def arguments(self) -> Sequence[str]:
        """See `Request`."""
        words = [*self.scenario_arguments, "--predictor", self.predictor]
        words += [f"--{name.replace('_', '-')} {limit}" for name, limit in self.limits.items()]
        return words if self.validation is None else [*words, "--validation", self.validation.replace(" ", "")]

    @property
    def limits(self) -> dict[str, float]:
        """The limits to the commands, by their names in `Limits`."""
        asked = {name: getattr(self, name) for name in UNLIMITED}
        return {name: limit for name, limit in asked.items() if limit is not None}

    @property
    def use(self) -> str:
        """See `Request`."""
        # The planner `sarl` is privileged, as published.
        run = f"run --planner {'sarl_cvm' if self.network == 'sarl' else self.network}"
        if not self.limits:
            return run
        limits = ", ".join(f"{name}={limit}" for name, limit in {**UNLIMITED, **self.limits}.items())
        return f"{run} --option 'limits={{{limits}}}'"

    def training(self, device: str) -> Training:
        """See `Request`. Raises InputError where there is no such scenario or predictor."""
        # Imported here, because torch and the simulator take seconds and the options are shown without them.
        from crowdbench.planners.lookahead.kce import Limits
        from crowdbench.predict.load import load_predictor
        from crowdbench.train.places import places
        from crowdbench.train.value import Setup, Training

        _, predictor = load_predictor(self.predictor)
        validation = [] if self.validation is None else [name.strip() for name in self.validation.split(",")]
        scenario, validated = places(self, validation)
        setup = Setup(
            network=self.network,
            scenario=scenario,
            predictor=predictor,
            limits=Limits(**{**UNLIMITED, **self.limits}) if self.limits else None,
            validation=validated,
            seed=self.seed,
            episodes=self.episodes,
            minutes=self.minutes,
            device=device,
        )
        return Training(setup)

    def card(self, training: Any, progress: Callable[[float], None]) -> dict[str, Any]:
        """See `Request`. The figures are those of the best network in the scenario that it was trained in."""
        from crowdbench.train.value import VALIDATION_CASES
        from crowdbench.train.value_figures import figures

        scenario = training.setup.scenario
        return {
            "training": {
                "scenario": {"name": scenario.name, "digest": scenario.digest, **scenario.table},
                "predictor": self.predictor,
                "limits": self.limits,
                "validation": {
                    "scenarios": [each.name for each in training.setup.validation],
                    "cases": str(VALIDATION_CASES),
                },
                "seed": self.seed,
                "episodes": training.curve[-1].episodes,
                "kept_after_episodes": training.chosen().episodes,
                "minutes": round(training.seconds / 60, 1),
            },
            "figures": figures(training.best, scenario, training.setup.limits, progress),
            "data": cards.episodes(scenario.table),
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
        limits = f", {limits}" if (limits := _limits(trained)) else ""
        return f"{where}{limits}: {cards.rate(success)} success on test cases"

    @staticmethod
    def card_rows(card: Mapping[str, Any]) -> Mapping[str, str]:
        """See `Request`."""
        trained = card["training"]
        return {
            "scenario": f"{cards.crowd(trained['scenario'])} (digest {trained['scenario']['digest']})",
            "predictor in the lookahead": trained["predictor"],
            **({"limits": limits} if (limits := _limits(trained)) else {}),
            "checkpoint": f"chosen at episode {trained['kept_after_episodes']} of {trained['episodes']}"
            + cards.chosen_on(trained),
        }

    @staticmethod
    def card_figures(card: Mapping[str, Any]) -> Sequence[str]:
        """See `Request`."""
        within = " and within the same limits" if _limits(card["training"]) else ""
        said = (
            f"Measured once, after training, in the same scenario{within}, with the constant-velocity predictor in the "
            "lookahead (95 % intervals):"
        )
        return [said, "", *cards.driving_table(card["figures"])]


def _limits(trained: Mapping[str, Any]) -> str:
    """The limits that a card names; empty where there are none."""
    return ", ".join(f"{name} {limit:g}" for name, limit in trained.get("limits", {}).items())
