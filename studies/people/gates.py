"""Print the rows of pedestrian policies for the table in models.md: their score, and whether they pass the gates."""

from __future__ import annotations

import math
import shlex
import sys
import time
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer

sys.path.append(str(Path(__file__).parents[2]))

from crowdbench import Cases, load_scenario
from crowdbench.cli import ThreadsOption, announce_compilation, help_from_docstring, main, use_threads
from crowdbench.plugins import plugin_name
from crowdbench.sim import crowd_decisions, init_memories, step_pedestrians
from crowdbench.utils import Format, Grid, markdown, printed_by
from studies.command import print_study
from studies.people.fitted import BASELINE, BLIND, Model, Models, fitted_models, with_populations
from studies.people.run import read_people
from studies.people.summary import Figure, compare, summarize
from studies.validity.motion import RECORDED_RADIUS, measure
from studies.validity.motion import simulate as walk

SCENARIO, CASES = "circle_20", 100
"""The scenario for speed and motion, and the number of its cases for motion."""

WORLDS, STEPS, REPEATS = 300, 40, 5
"""Worlds and steps of a measurement of speed, and how often it is repeated."""

RATIO, SPEED = (0.5, 2.0), 0.8
"""Bounds of the ratio of new contacts, and the smallest speed as a share of that of the baseline."""

MOST_ACCELERATION, MOST_REVERSALS, MOST_OVERLAP = 1.86, 0.23, 0.0123
"""The largest figures of motion of the folds' recordings in ../validity/motion.md: 99 % quantile of accelerations in
m/s², reversals per person and minute, and share of overlaps."""

HEADER = "model|gates|v3|minus `orca`|minus blind|v3, goal hidden|ratio|speed|acceleration|reversals|overlap"


class Row(NamedTuple):
    """A row of the table.

    Attributes:
        model: Its name.
        v3: Its score with the goal shown.
        minus_orca: Difference to shipped ORCA.
        minus_blind: Difference to a blind walker with the same population.
        hidden: Its score with the goal hidden.
        ratio: Ratio of new contacts to recorded ones.
        speed: As a share of the speed of shipped ORCA.
        acceleration: 99 % quantile in m/s².
        reversals: Per person and minute.
        overlap: Share of pedestrians and steps.
    """

    model: str
    v3: Figure
    minus_orca: Figure
    minus_blind: Figure
    hidden: Figure
    ratio: Figure
    speed: float
    acceleration: float
    reversals: float
    overlap: float

    @property
    def failed(self) -> list[str]:
        """The gates that it fails."""
        passes = {
            "contacts": RATIO[0] <= self.ratio.low and self.ratio.high <= RATIO[1],
            "speed": self.speed >= SPEED,
            "motion": self.acceleration <= MOST_ACCELERATION
            and self.reversals <= MOST_REVERSALS
            and self.overlap <= MOST_OVERLAP,
        }
        return [gate for gate, is_passed in passes.items() if not is_passed]

    @property
    def cells(self) -> list[str]:
        """The cells for readers."""
        return [
            f"`{self.model}`",
            f"fails {', '.join(self.failed)}" if self.failed else "passes",
            *(
                f"{value:{form}} ({low:{form}} to {high:{form}})"
                for (value, low, high), form in zip(self[1:6], (".3f", "+.3f", "+.3f", ".3f", ".2f"), strict=True)
            ),
            f"{self.speed:.2f}",
            f"{self.acceleration:.2f}",
            f"{self.reversals:.2f}",
            f"{self.overlap:.2%}".replace("%", " %"),
        ]

    @property
    def record(self) -> dict[str, Any]:
        """The content for programs."""
        return {
            name: value._asdict() if isinstance(value, Figure) else value for name, value in self._asdict().items()
        } | {"failed": self.failed}


@help_from_docstring
def gates(
    policies: list[str],
    data: Annotated[Path, typer.Option()],
    threads: ThreadsOption = None,
    format: Format = Format.MARKDOWN,
) -> None:
    """Print the row of each pedestrian policy for the table of models.

    Args:
        policies: Names, ./mine.py or ./mine.py:function, or folders with files of fit.py, which have the name of a
            policy: each location is scored with the parameters that were fitted without it.
        data: The folder with the tracks of ETH/UCY.
    """
    use_threads(threads)
    announce_compilation()
    recordings = read_people(data)
    shipped = {name: recordings.score_policy(name) for name in (BASELINE, BLIND)}
    rows = []
    for policy in policies:
        fits = Path(policy)
        models: Models = dict.fromkeys(recordings.windows, Model(policy))
        if fits.is_dir():
            models, policy = fitted_models(fits, recordings.windows), fits.name
        model, blind_models = recordings.score_models(models), with_populations(BLIND, models)
        blind = recordings.score_models(blind_models) if blind_models else shipped[BLIND]
        row = Row(
            plugin_name(policy) + ", held out" * fits.is_dir(),
            summarize(model["shown"])["v3"],
            compare(model["shown"], shipped[BASELINE]["shown"])["v3"],
            compare(model["shown"], blind["shown"])["v3"],
            summarize(model["hidden"])["v3"],
            summarize(model["shown"])["ratio"],
            speed_of(policy),
            *motion_of(policy),
        )
        rows.append(row)
    grid = Grid("Models", HEADER.split("|"), [row.cells for row in rows], [row.record for row in rows])
    command = shlex.join(["python", "studies/people/gates.py", *policies, "--data", "DIR"])
    print_study(grid.records, [grid], "\n\n".join([printed_by(command), markdown(grid.header, grid.rows)]), format)


def motion_of(policy: str, cases: int = CASES) -> tuple[float, float, float]:
    """Return acceleration, reversals and overlap of a policy without a vehicle, see `Row`.

    People have the radius that is assumed for recorded ones, so that overlaps can be compared.
    """
    scenario = load_scenario(SCENARIO, {"pedestrians.radius": RECORDED_RADIUS}, pedestrians=policy)
    walks, _ = walk(scenario, Cases("val", 0, cases))
    figures = measure(walks)
    return figures[2], figures[4], figures[6]


def speed_of(policy: str, worlds: int = WORLDS) -> float:
    """Return the speed of a policy in steps per second, divided by that of the baseline.

    Both are measured in turn, and the fastest of several measurements counts, because other programs slow some down.
    """
    durations = {policy: math.inf, BASELINE: math.inf}
    scenarios = {name: load_scenario(SCENARIO, pedestrians=name) for name in durations}
    starts = {name: scenario.worlds(Cases("val", 0, worlds)) for name, scenario in scenarios.items()}
    for _ in range(REPEATS):
        for name, scenario in scenarios.items():
            world = init_memories(starts[name], scenario.policies)
            began = time.perf_counter()
            for _ in range(STEPS):
                crowd, world = crowd_decisions(world, scenario.policies)
                world = step_pedestrians(world, crowd, scenario.post_step_rule)
            durations[name] = min(durations[name], time.perf_counter() - began)
    return durations[BASELINE] / durations[policy]


if __name__ == "__main__":
    main(gates)
