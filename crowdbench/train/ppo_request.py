"""What a user asks for in the training of a policy, and what the card says of it."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from crowdbench.errors import InputError
from crowdbench.plugin_files import file_digests
from crowdbench.plugins import file_and_function
from crowdbench.train.method import Request, Training, option
from crowdbench.weights import card as cards

STEPS = 5_000_000
"""The steps of a training where their number is not given."""

MEASURED = ("success_rate", "collision_rate", "timeout_rate", "navigation_time", "jerk", "max_velocity_change")
"""The metrics on the card."""


@dataclass(frozen=True, kw_only=True)
class PPORequest(Request):
    """What is asked for of the training in `crowdbench.train.ppo`.

    Attributes:
        steps: The steps that the vehicles of all worlds drive together.
        reward: The name of a reward of the environments, or a file.
        nearest: How many pedestrians the policy is shown, at most; None for as many as the scenario has.
        validation: The scenarios that choose the checkpoint, by name or path, with commas between them; None for the
            one that is trained in.
    """

    steps: int = option(STEPS, "Train for this many steps, of all worlds together", least=1)
    reward: str = option("progress", "The reward: crowdnav, progress or ./mine.py")
    nearest: int | None = option(None, "How many pedestrians the policy is shown; else as many as there are", least=1)
    validation: str | None = option(None, "Scenarios that choose the checkpoint, as in a,b; else the one to train in")

    length: ClassVar[str] = "steps"

    @classmethod
    def check(cls, options: Mapping[str, Any]) -> None:
        """See `Request`. Any options go together."""

    @property
    def arguments(self) -> Sequence[str]:
        """See `Request`."""
        words = [*self.scenario_arguments]
        if self.reward != "progress":
            words.append(f"--reward {shlex.quote(self.reward)}")
        if self.nearest is not None:
            words.append(f"--nearest {self.nearest}")
        return words if self.validation is None else [*words, "--validation", shlex.quote(",".join(self._validated))]

    @property
    def _validated(self) -> list[str]:
        return [name.strip() for name in self.validation.split(",")] if self.validation else []

    @property
    def use(self) -> str:
        """See `Request`."""
        return "run --planner ppo"

    def training(self, device: str) -> Training:
        """See `Request`. Raises InputError where there is no such scenario, or stable-baselines3 is missing."""
        from crowdbench.train.places import places

        try:
            from crowdbench.train.ppo import Setup, Training
        except ModuleNotFoundError as error:
            if error.name != "stable_baselines3":
                raise
            raise InputError("crowdbench train ppo needs stable-baselines3: pip install 'crowdbench[ppo]'") from None
        scenario, validated = places(self, self._validated)
        return Training(
            Setup(
                scenario=scenario,
                validation=validated,
                nearest=self.nearest or max(scenario.max_agents - 1, 1),
                reward=self.reward,
                seed=self.seed,
                steps=self.steps,
                minutes=self.minutes,
                device=device,
            )
        )

    def card(self, training: Any, progress: Callable[[float], None]) -> dict[str, Any]:
        """See `Request`. The figures are those of the best policy in the scenario that it was trained in."""
        from crowdbench.planners.policy.planner import PolicyPlanner
        from crowdbench.train.ppo import VALIDATION_CASES
        from crowdbench.train.value_figures import measured

        setup = training.setup
        scenario = setup.scenario
        return {
            "training": {
                "scenario": {"name": scenario.name, "digest": scenario.digest, **scenario.table},
                "nearest": setup.nearest,
                "reward": self.reward,
                **({"reward_files": file_digests(file)} if (file := file_and_function(self.reward)[0]) else {}),
                "validation": {
                    "scenarios": [each.name for each in setup.validation],
                    "cases": str(VALIDATION_CASES),
                },
                "seed": self.seed,
                "steps": training.curve[-1].steps,
                "kept_after_steps": training.chosen().steps,
                "minutes": round(training.seconds / 60, 1),
            },
            "figures": measured(PolicyPlanner(training.best, setup.nearest), "ppo", scenario, MEASURED, progress),
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
        return f"in {cards.crowd(trained['scenario'])}: {cards.rate(success)} success on test cases"

    @staticmethod
    def card_rows(card: Mapping[str, Any]) -> Mapping[str, str]:
        """See `Request`."""
        trained = card["training"]
        return {
            "scenario": f"{cards.crowd(trained['scenario'])} (digest {trained['scenario']['digest']})",
            "reward": str(trained["reward"]),
            "pedestrians shown": f"{trained['nearest']} at most, the nearest",
            "checkpoint": f"chosen at step {trained['kept_after_steps']} of {trained['steps']}"
            + cards.chosen_on(trained),
        }

    @staticmethod
    def card_figures(card: Mapping[str, Any]) -> Sequence[str]:
        """See `Request`."""
        said = "Measured once, after training, in the same scenario (95 % intervals):"
        return [said, "", *cards.driving_table(card["figures"])]
