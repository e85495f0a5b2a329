"""Checks what a reward keeps of its contract, on the steps of real episodes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from crowdbench.check.examination import Examination
from crowdbench.check.result import CheckResult
from crowdbench.core.geometry import toward_goal
from crowdbench.envs.rewards import CheckedReward, Reward, Step
from crowdbench.envs.stepping import drive
from crowdbench.envs.views import NEAREST, View
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario
from crowdbench.sim.routes import goals_on_way
from crowdbench.utils.errors import plugin_errors


def check_reward(make: Callable[[], Reward], name: str, scenario: Scenario, cases: Cases) -> list[CheckResult]:
    """Let a reward judge the steps of some cases and examine each part of its contract by itself.

    Args:
        make: Loads the reward.
        name: What the reward is called in errors.
        scenario: The scenario of the cases.
        cases: The cases.

    Raises:
        InputError: Something other than the reward breaks its contract.
    """
    examination = _RewardExamination(make, name)
    for step in _drive(scenario, cases):
        examination.ask(step)
    findings = examination.findings
    return [
        findings.result("exceptions", "none"),
        findings.result("one number", "one finite number per world"),
        findings.result("step", "unchanged"),
        examination.check_deterministic(),
        examination.check_batch(),
    ]


def _drive(scenario: Scenario, cases: Cases) -> Iterator[Step]:
    """The steps of some cases, in which every third vehicle stands and the others go straight on."""
    view, world = View(scenario, "flat", "world", NEAREST), scenario.worlds(cases)
    stands = np.arange(len(world)) % 3 == 2
    while len(world):
        straight = toward_goal(world.position[:, 0], goals_on_way(world)[:, 0], world.preferred_speed[:, 0])
        step = drive(view, world, np.where(stands[:, None], 0.0, straight))
        yield step
        world, stands = step.after.take(~step.ended), stands[~step.ended]


class _RewardExamination(Examination[Reward, Step]):
    answers = "rewards"
    missing = "not examined: the reward gave no numbers"
    batch_names = "step", "step"

    def query(self, plugin: Reward, batch: Step) -> object:
        with plugin_errors(f"reward {self.name} raised"):
            return plugin(batch)

    def validators(self, batch: Step) -> dict[str, Callable[[Any], Any]]:
        return {"one number": lambda values: CheckedReward(self.name, lambda _: values)(batch)}

    def locate(self, batch: Step, row: int) -> str:
        return f"case {batch.before.case[row]}"
