"""How often a planner observes: at every step, or several commands per observation after it has looked first."""

from __future__ import annotations

from dataclasses import dataclass

from crowdbench.errors import InputError

LOOK_FIRST = 8
"""Positions that a planner sees before it gives several commands at once, where nothing else is asked for.

It is the number of observed steps of the predictors (Gupta et al. 2018) and the length of `Pedestrians.history`.
"""


@dataclass(frozen=True)
class Replanning:
    """At which steps a planner observes, and for how many steps it then gives commands.

    Where `every` is above 1, it decides at every single step until it has seen the pedestrians at `look_first`
    positions. Before that nobody has moved for long, and no predictor can tell where anybody is going. Experiment 2 of
    Li et al. (2020) does not say how its episodes begin.

    Attributes:
        every: Commands per observation.
        look_first: Positions to see before several commands are given at once; 1 starts with several at once. Without
            effect where `every` is 1.

    Raises:
        InputError: One of them is below 1.
    """

    every: int = 1
    look_first: int = LOOK_FIRST

    def __post_init__(self) -> None:
        if self.every < 1:
            raise InputError(f"replan_every is {self.every}, but a planner observes again after 1 step or more")
        if self.look_first < 1:
            raise InputError(
                f"look_first is {self.look_first}, but a planner sees 1 position or more at its first step"
            )

    def executed(self, step: int) -> int:
        """How many of the commands of the last observation are executed before a step; the step is counted from 0."""
        return max(0, step - self.look_first + 1) % self.every

    def asked(self, step: int) -> int:
        """For how many steps the planner gives commands when it observes before a step."""
        return self.every if step >= self.look_first - 1 else 1

    @property
    def settings(self) -> dict[str, int]:
        """The settings as names and results show them; nothing where the planner observes every step."""
        return {} if self.every == 1 else {"replan_every": self.every, "look_first": self.look_first}


EVERY_STEP = Replanning()
"""The planner observes at every step."""
