"""What a user asks for in a training that drives: of a value network, or of a policy (PPO)."""

from __future__ import annotations

import abc
import dataclasses
import math
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from crowdbench.networks import card as cards
from crowdbench.plugins.files import file_digests
from crowdbench.plugins.load import file_and_function
from crowdbench.train.method import CardText, Request, Training, describe_scenario, option
from crowdbench.train.ppo_parameters import Parameters, read_parameters
from crowdbench.utils.errors import InputError

EPISODES = 4000
"""The episodes of the training of a value network where their number is not given."""

UNLIMITED = {"max_acceleration": math.inf, "max_turn": math.pi, "max_velocity_change": math.inf}
"""The limits of `Limits` that exclude nothing."""


def _names(listed: str | None) -> list[str]:
    """Names with commas between them, one by one."""
    return [name.strip() for name in listed.split(",")] if listed is not None else []


@dataclass(frozen=True, kw_only=True)
class DrivingRequest(Request):
    """A request for a training of `crowdbench.train.driving`.

    Attributes:
        validation: The scenarios that choose the checkpoint, by name or path, with commas between them; None for the
            one that is trained in.
        card: Which cases the figures on the card are of: `val`, or `test` for test cases too.
    """

    validation: str | None = option(None, "Scenarios that choose the checkpoint, as in a,b; else the one to train in")
    card: str = option("val", "Measure the network for its card on val, other cases than chose it, or on test too")

    measured: ClassVar[Sequence[str]] = ("success_rate", "collision_rate", "timeout_rate", "navigation_time")
    """The metrics on the card."""

    @classmethod
    def check(cls, options: Mapping[str, Any]) -> None:
        """See `Request`."""
        if options.get("card", "val") not in ("val", "test"):
            raise InputError(f"--card is {options['card']!r}, but must be val or test")

    @property
    def splits(self) -> list[str]:
        """The splits of the figures on the card."""
        return ["validation", *(["test"] if self.card == "test" else [])]

    @property
    def validation_names(self) -> list[str]:
        """The scenarios of `validation`, one by one."""
        return _names(self.validation)

    @property
    def arguments(self) -> Sequence[str]:
        """See `Request`: the options that do not have their defaults, and those that are always named."""
        words = [*self.scenario_arguments]
        values = {**vars(self), "validation": ",".join(self.validation_names) or None}
        for field in dataclasses.fields(self):
            value = values[field.name]
            if not field.metadata or field.name == self.length:
                continue
            flag = f"--{field.name.replace('_', '-')}"
            if field.metadata["pairs"]:
                words += [f"{flag} {shlex.quote(f'{name}={part}')}" for name, part in (value or {}).items()]
            elif value != field.default or field.metadata["always"]:
                words += [flag, shlex.quote(str(value))]
        return words

    @abc.abstractmethod
    def about(self, training: Any) -> dict[str, Any]:
        """What the card says of the training that only this method has."""

    def make_card(self, training: Any, progress: Callable[[float], None]) -> dict[str, Any]:
        """See `Request`. The figures are those of the best network in the scenario that it was trained in."""
        from crowdbench.train.driving import VALIDATION_CASES

        scenario, last = training.scenario, training.curve[-1]
        validation = {"scenarios": [each.name for each in training.validation], "cases": str(VALIDATION_CASES)}
        return {
            "training": {
                "scenario": describe_scenario(scenario),
                **self.about(training),
                "validation": validation,
                "seed": self.seed,
                self.length: getattr(last, self.length),
                f"kept_after_{self.length}": getattr(training.best_point(), self.length),
                "minutes": round(training.seconds / 60, 1),
            },
            "figures": training.measure(self.splits, self.measured, progress),
            "data": cards.episodes(scenario.table),
        }

    @property
    def card_cases(self) -> int:
        """See `Request`."""
        from crowdbench.train.driving import CASES

        return sum(len(CASES[split]) for split in self.splits)

    @classmethod
    def driving_text(cls, card: Mapping[str, Any], place: str, rows: Mapping[str, str], conditions: str) -> CardText:
        """What a card says, for people.

        Args:
            card: The card.
            place: Where the network was trained, for the headline.
            rows: The rows of the table between scenario and checkpoint.
            conditions: How the network was measured in the scenario that it was trained in.
        """
        trained, figures, unit = card["training"], card["figures"], cls.length
        chosen = f"chosen at {unit[:-1]} {trained[f'kept_after_{unit}']} of {trained[unit]}{cards.chosen_on(trained)}"
        scenario = f"{cards.crowd(trained['scenario'])} (digest {trained['scenario']['digest']})"
        split = "test" if "test" in figures else "validation"
        measured = f"Measured once, after training, in the same scenario{conditions} (95 % intervals):"
        return CardText(
            f"{place}: {cards.rate(figures[split]['metrics']['success_rate'])} success on {split} cases",
            {"scenario": scenario, **rows, "checkpoint": chosen},
            [measured, "", *cards.driving_table(figures)],
        )


@dataclass(frozen=True, kw_only=True)
class ValueRequest(DrivingRequest):
    """What is asked for of the training in `crowdbench.train.value`.

    Attributes:
        predictor: The predictor in the lookahead: a name, or the path of its file.
        episodes: The episodes that the network drives, demonstrations not counted.
        max_acceleration: As in `Limits`; None for no limit, and so are the next two.
        max_turn: As in `Limits`.
        max_velocity_change: As in `Limits`.
    """

    predictor: str = option("oracle", "The predictor in the lookahead: a name or ./mine.py", always=True)
    episodes: int = option(EPISODES, "Train for this many episodes", least=1)
    max_acceleration: float | None = option(None, "Limit the commands: largest change of speed, per second [m/s^2]")
    max_turn: float | None = option(None, "Limit the commands: largest change of heading in a step [rad]")
    max_velocity_change: float | None = option(None, "Limit the commands: largest change of velocity in a step [m/s]")

    length: ClassVar[str] = "episodes"

    @property
    def limits(self) -> dict[str, float]:
        """The limits to the commands that are given, by their names in `Limits`."""
        return {name: limit for name in UNLIMITED if (limit := getattr(self, name)) is not None}

    @property
    def all_limits(self) -> dict[str, float]:
        """The limits with those that are not given, which exclude nothing."""
        return {**UNLIMITED, **self.limits}

    @property
    def use(self) -> str:
        """See `Request`."""
        # The planner `sarl` is privileged, as published.
        run = f"run --planner {'sarl_cvm' if self.network == 'sarl' else self.network}"
        limits = ", ".join(f"{name}={limit}" for name, limit in self.all_limits.items())
        return f"{run} --option 'limits={{{limits}}}'" if self.limits else run

    def training(self, device: str) -> Training:
        """See `Request`. Raises InputError where there is no such scenario or predictor."""
        # Imported here, because torch and the simulator take seconds and the options are shown without them.
        from crowdbench.train.value import Training

        return Training(self, device)

    def about(self, training: Any) -> dict[str, Any]:
        """See `DrivingRequest`."""
        return {"predictor": self.predictor, "limits": self.limits}

    @classmethod
    def card_text(cls, card: Mapping[str, Any]) -> CardText:
        """See `Request`."""
        trained = card["training"]
        limits = ", ".join(f"{name} {limit:g}" for name, limit in trained["limits"].items())
        place = f"with the {trained['predictor']} predictor in {cards.crowd(trained['scenario'])}"
        rows = {"predictor in the lookahead": trained["predictor"]}
        conditions = ", with the constant-velocity predictor in the lookahead"
        if limits:
            place += f", {limits}"
            rows["limits"] = limits
            conditions = f" and within the same limits{conditions}"
        return cls.driving_text(card, place, rows, conditions)


@dataclass(frozen=True, kw_only=True)
class PPORequest(DrivingRequest):
    """What is asked for of the training in `crowdbench.train.ppo`.

    Attributes:
        steps: The steps that the vehicles of all worlds drive together.
        reward: The name of a reward of the environments, or a file.
        nearest: How many pedestrians the policy is shown, at most; None for as many as the scenario has.
        beside: The scenarios to train in beside the one of the card, by name or path, with commas between them.
        encoder: The file of an encoder to train with in place of the network's own; None for that.
        ppo: Parameters of `crowdbench.train.ppo_parameters`, by name; the others have their defaults.
    """

    steps: int = option(5_000_000, "Train for this many steps, of all worlds together", least=1)
    reward: str = option("progress", "The reward: crowdnav, progress, safe_progress, crowdnav_plus or ./mine.py")
    nearest: int | None = option(None, "How many pedestrians the policy is shown; else as many as there are", least=1)

    beside: str | None = option(None, "Scenarios to train in too, as in a,b, each with as many worlds as --scenario")
    encoder: str | None = option(None, "The file of an encoder (feature extractor) of your own, ./mine.py")
    ppo: Mapping[str, Any] | None = option(None, "A parameter of PPO, as in gamma=0.99; repeatable", pairs=True)

    length: ClassVar[str] = "steps"
    measured: ClassVar[Sequence[str]] = (*DrivingRequest.measured, "jerk", "max_velocity_change")

    @property
    def use(self) -> str:
        """See `Request`."""
        return f"run --planner {self.network}"

    def training(self, device: str) -> Training:
        """See `Request`. Raises InputError where there is no such scenario or reward."""
        from crowdbench.train.ppo import Training

        return Training(self, device)

    def about(self, training: Any) -> dict[str, Any]:
        """See `DrivingRequest`."""
        files: dict[str, dict[str, str]] = {}
        for name, spec in {"reward": self.reward, "encoder": self.encoder}.items():
            file, _ = file_and_function(spec or "")
            files |= {} if file is None else {f"{name}_files": file_digests(file)}
        return {
            "nearest": training.nearest,
            "reward": self.reward,
            "beside": [describe_scenario(each) for each in training.beside],
            "ppo": dataclasses.asdict(self.parameters),
            **files,
        }

    @property
    def beside_names(self) -> list[str]:
        """The scenarios of `beside`, one by one."""
        return _names(self.beside)

    @property
    def parameters(self) -> Parameters:
        """All parameters of PPO. Raises InputError where one of `ppo` does not exist or is impossible."""
        return read_parameters(self.ppo or {})

    @classmethod
    def card_text(cls, card: Mapping[str, Any]) -> CardText:
        """See `Request`."""
        trained = card["training"]
        beside = [cards.crowd(each) for each in trained["beside"]]
        rows = {"trained beside in": "; ".join(beside)} if beside else {}
        rows |= {"reward": str(trained["reward"]), "pedestrians shown": f"{trained['nearest']} at most, the nearest"}
        place = f"in {cards.crowd(trained['scenario'])}"
        if not beside:
            return cls.driving_text(card, place, rows, "")
        return cls.driving_text(card, f"{place}, and {len(beside)} more", rows, ", not in those beside it")
