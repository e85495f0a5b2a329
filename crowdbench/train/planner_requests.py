"""What a user asks for in the training of a network that drives: a value network, or a policy (PPO)."""

from __future__ import annotations

import abc
import math
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from crowdbench.networks import card as cards
from crowdbench.plugins.files import file_digests
from crowdbench.plugins.load import file_and_function
from crowdbench.train.method import Request, Training, option
from crowdbench.utils.errors import InputError

EPISODES = 4000
"""The episodes of the training of a value network where their number is not given."""

STEPS = 5_000_000
"""The steps of the training of a policy where their number is not given."""

UNLIMITED = {"max_acceleration": math.inf, "max_turn": math.pi, "max_velocity_change": math.inf}
"""The limits of `Limits` that exclude nothing."""


class DrivingRequest(Request):
    """A request for a training of `crowdbench.train.driving`. Every subclass has the option `validation`.

    Attributes:
        validation: The scenarios that choose the checkpoint, by name or path, with commas between them; None for the
            one that is trained in.
    """

    validation: str | None

    measured: ClassVar[Sequence[str]]
    """The metrics on the card."""

    @classmethod
    def check(cls, options: Mapping[str, Any]) -> None:
        """See `Request`. Any options go together; the limits are checked when the training is made."""

    @property
    def validation_names(self) -> list[str]:
        """The scenarios of `validation`, one by one."""
        return [name.strip() for name in self.validation.split(",")] if self.validation is not None else []

    @abc.abstractmethod
    def about(self, training: Any) -> dict[str, Any]:
        """What the card says of the training that only this method has."""

    def card(self, training: Any, progress: Callable[[float], None]) -> dict[str, Any]:
        """See `Request`. The figures are those of the best network in the scenario that it was trained in."""
        from crowdbench.train.driving import VALIDATION_CASES, measure

        scenario, last = training.scenario, training.curve[-1]
        return {
            "training": {
                "scenario": {"name": scenario.name, "digest": scenario.digest, **scenario.table},
                **self.about(training),
                "validation": {
                    "scenarios": [each.name for each in training.validation],
                    "cases": str(VALIDATION_CASES),
                },
                "seed": self.seed,
                self.length: getattr(last, self.length),
                f"kept_after_{self.length}": getattr(training.best_point(), self.length),
                "minutes": round(training.seconds / 60, 1),
            },
            "figures": measure(training.planner(training.best), self.network, scenario, self.measured, progress),
            "data": cards.episodes(scenario.table),
        }

    @property
    def card_cases(self) -> int:
        """See `Request`."""
        from crowdbench.train.driving import CASES

        return sum(map(len, CASES.values()))

    @classmethod
    def card_rows(cls, card: Mapping[str, Any]) -> dict[str, str]:
        """See `Request`."""
        trained, unit = card["training"], cls.length
        chosen = f"chosen at {unit[:-1]} {trained[f'kept_after_{unit}']} of {trained[unit]}"
        return {
            "scenario": f"{cards.crowd(trained['scenario'])} (digest {trained['scenario']['digest']})",
            **cls.own_rows(trained),
            "checkpoint": chosen + cards.chosen_on(trained),
        }

    @staticmethod
    @abc.abstractmethod
    def own_rows(trained: Mapping[str, Any]) -> dict[str, str]:
        """The rows between scenario and checkpoint."""


@dataclass(frozen=True, kw_only=True)
class ValueRequest(DrivingRequest):
    """What is asked for of the training in `crowdbench.train.value`.

    Attributes:
        predictor: The predictor in the lookahead: a name, or the path of its file.
        episodes: The episodes that the network drives, demonstrations not counted.
        max_acceleration: As in `Limits`; None for no limit, and so are the next two.
        max_turn: As in `Limits`.
        max_velocity_change: As in `Limits`.
        validation: See `DrivingRequest`.
    """

    predictor: str = option("oracle", "The predictor in the lookahead: a name or ./mine.py")
    episodes: int = option(EPISODES, "Train for this many episodes", least=1)
    max_acceleration: float | None = option(None, "Limit the commands: largest change of speed, per second [m/s^2]")
    max_turn: float | None = option(None, "Limit the commands: largest change of heading in a step [rad]")
    max_velocity_change: float | None = option(None, "Limit the commands: largest change of velocity in a step [m/s]")
    validation: str | None = option(None, "Scenarios that choose the checkpoint, as in a,b; else the one to train in")

    length: ClassVar[str] = "episodes"
    measured: ClassVar[Sequence[str]] = ("success_rate", "collision_rate", "timeout_rate", "navigation_time")

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
    def all_limits(self) -> dict[str, float]:
        """The limits with those that were not asked for, which exclude nothing."""
        return {**UNLIMITED, **self.limits}

    @property
    def use(self) -> str:
        """See `Request`."""
        # The planner `sarl` is privileged, as published.
        run = f"run --planner {'sarl_cvm' if self.network == 'sarl' else self.network}"
        if not self.limits:
            return run
        limits = ", ".join(f"{name}={limit}" for name, limit in self.all_limits.items())
        return f"{run} --option 'limits={{{limits}}}'"

    def training(self, device: str) -> Training:
        """See `Request`. Raises InputError where there is no such scenario or predictor."""
        # Imported here, because torch and the simulator take seconds and the options are shown without them.
        from crowdbench.train.value import Training

        return Training(self, device)

    def about(self, training: Any) -> dict[str, Any]:
        """See `DrivingRequest`."""
        return {"predictor": self.predictor, "limits": self.limits}

    @staticmethod
    def card_headline(card: Mapping[str, Any]) -> str:
        """See `Request`."""
        trained, success = card["training"], card["figures"]["test"]["metrics"]["success_rate"]
        where = f"with the {trained['predictor']} predictor in {cards.crowd(trained['scenario'])}"
        limits = f", {limits}" if (limits := _limits(trained)) else ""
        return f"{where}{limits}: {cards.rate(success)} success on test cases"

    @staticmethod
    def own_rows(trained: Mapping[str, Any]) -> dict[str, str]:
        """See `DrivingRequest`."""
        limits = _limits(trained)
        return {"predictor in the lookahead": trained["predictor"], **({"limits": limits} if limits else {})}

    @staticmethod
    def card_figures(card: Mapping[str, Any]) -> Sequence[str]:
        """See `Request`."""
        within = " and within the same limits" if _limits(card["training"]) else ""
        said = (
            f"Measured once, after training, in the same scenario{within}, with the constant-velocity predictor in the "
            "lookahead (95 % intervals):"
        )
        return [said, "", *cards.driving_table(card["figures"])]


@dataclass(frozen=True, kw_only=True)
class PPORequest(DrivingRequest):
    """What is asked for of the training in `crowdbench.train.ppo`.

    Attributes:
        steps: The steps that the vehicles of all worlds drive together.
        reward: The name of a reward of the environments, or a file.
        nearest: How many pedestrians the policy is shown, at most; None for as many as the scenario has.
        validation: See `DrivingRequest`.
    """

    steps: int = option(STEPS, "Train for this many steps, of all worlds together", least=1)
    reward: str = option("progress", "The reward: crowdnav, progress or ./mine.py")
    nearest: int | None = option(None, "How many pedestrians the policy is shown; else as many as there are", least=1)
    validation: str | None = option(None, "Scenarios that choose the checkpoint, as in a,b; else the one to train in")

    length: ClassVar[str] = "steps"
    measured: ClassVar[Sequence[str]] = (*ValueRequest.measured, "jerk", "max_velocity_change")

    @property
    def arguments(self) -> Sequence[str]:
        """See `Request`."""
        words = [*self.scenario_arguments]
        if self.reward != "progress":
            words.append(f"--reward {shlex.quote(self.reward)}")
        if self.nearest is not None:
            words.append(f"--nearest {self.nearest}")
        if self.validation is not None:
            words += ["--validation", shlex.quote(",".join(self.validation_names))]
        return words

    @property
    def use(self) -> str:
        """See `Request`."""
        return "run --planner ppo"

    def training(self, device: str) -> Training:
        """See `Request`. Raises InputError where there is no such scenario, or stable-baselines3 is missing."""
        try:
            from crowdbench.train.ppo import Training
        except ModuleNotFoundError as error:
            if error.name != "stable_baselines3":
                raise
            raise InputError("crowdbench train ppo needs stable-baselines3: pip install 'crowdbench[ppo]'") from None
        return Training(self, device)

    def about(self, training: Any) -> dict[str, Any]:
        """See `DrivingRequest`."""
        file, _ = file_and_function(self.reward)
        files = {} if file is None else {"reward_files": file_digests(file)}
        return {"nearest": training.nearest, "reward": self.reward, **files}

    @staticmethod
    def card_headline(card: Mapping[str, Any]) -> str:
        """See `Request`."""
        trained, success = card["training"], card["figures"]["test"]["metrics"]["success_rate"]
        return f"in {cards.crowd(trained['scenario'])}: {cards.rate(success)} success on test cases"

    @staticmethod
    def own_rows(trained: Mapping[str, Any]) -> dict[str, str]:
        """See `DrivingRequest`."""
        return {"reward": str(trained["reward"]), "pedestrians shown": f"{trained['nearest']} at most, the nearest"}

    @staticmethod
    def card_figures(card: Mapping[str, Any]) -> Sequence[str]:
        """See `Request`."""
        said = "Measured once, after training, in the same scenario (95 % intervals):"
        return [said, "", *cards.driving_table(card["figures"])]


def _limits(trained: Mapping[str, Any]) -> str:
    """The limits that a card names; empty where there are none."""
    return ", ".join(f"{name} {limit:g}" for name, limit in trained.get("limits", {}).items())
