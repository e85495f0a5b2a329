"""Try random options of a planner on validation cases, and print their results: `python studies/tuning.py dwa`."""

from __future__ import annotations

import itertools
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

sys.path.append(str(Path(__file__).parents[1]))

from crowdbench import InputError
from crowdbench.cli import ThreadsOption, WorkersOption, help_from_docstring, main, use_threads
from studies.command import EngineOption, Sharing, make_runs

if TYPE_CHECKING:
    from crowdbench.metrics import Estimate

SCENARIOS = "circle_20", "door_10", "corner_5", "street_8", "blocks_12", "streets_16"
"""Density, walls and crossing flows."""

COSTS = {"near": (3.0, 12.0), "fading": (0.7, 0.9), "growth": (0.15, 0.6), "sigma_factor": (0.2, 1.2)}
PLAIN = {"near": (0.0, 0.0), "contact": (20.0, 120.0), "fading": (0.7, 0.95), "change": (0.05, 0.3)}
GOALS = {"concentration": (4.0, 16.0), "memory": (1.5, 6.0)}
OBJECTIVE = {"clearance": (4.0, 12.0), "room": (1.0, 4.0), "margin": (0.05, 0.2), "sigma_factor": (0.2, 1.2)}
RISK = {"threshold": (0.01, 0.2), "soft": (10.0, 100.0), "hard": (100.0, 600.0)}
RANGES: dict[str, dict[str, Any]] = {
    "mppi": {"weights": COSTS},
    "mppi_plain": {"weights": PLAIN},
    "mppi_interactive": {"weights": COSTS, "inference": GOALS, "ignoring": (0.05, 0.5), "worst": (0.3, 1.0)},
    "dwa": {"objective": OBJECTIVE},
    "brne": {"straightness": (0.02, 0.2), "width": (0.3, 2.0), "zone": (2.0, 12.0), "penalty": (100.0, 1000.0)},
    "dra_mppi": RISK | {"speed": (0.2, 1.5), "change": (0.2, 1.5), "spread": (0.2, 0.6)},
}
"""Lowest and highest value of the options of each planner; the first trial has its defaults. `mppi_plain` is MPPI
without a margin, which is tuned for plain time (the metric `sct`)."""

METRICS = {"score": 1.0, "sct": 1.0, "success_rate": 100.0, "at_fault_rate": 100.0, "navigation_time": 1.0}
"""The printed metrics with the factors of their units."""


@help_from_docstring
def tune(
    planner: str,
    trials: int = 30,
    cases: int = 20,
    track: str = "perfect",
    out: Path = Path("runs/tuning"),
    workers: WorkersOption = None,
    engine: EngineOption = None,
    threads: ThreadsOption = None,
) -> None:
    """Print the mean score, success, share at fault and time of each trial. Existing runs are not repeated.

    Args:
        planner: One of `RANGES`.
        trials: Number of configurations.
        cases: Validation cases of each scenario.
        track: The track of sensing, perfect or realistic.
        out: Folder for the runs.
    """
    use_threads(threads)
    from crowdbench import Cases
    from crowdbench.runs import RunSpec, load_run
    from studies.folder import read_episodes

    if planner not in RANGES:
        raise InputError(f"planner is {planner}, but must be one of {', '.join(RANGES)}")
    generator = np.random.default_rng(1)
    drawn = [_draw(RANGES[planner], generator) if trial else {} for trial in range(trials)]
    base = RunSpec(
        planner.removesuffix("_plain"), "", Cases("val", 0, cases), overrides={"sensor.track": track}, record="none"
    )
    runs = [
        [load_run(replace(base, scenario=scenario, options=options)) for scenario in SCENARIOS] for options in drawn
    ]
    make_runs(list(itertools.chain(*runs)), out, Sharing(None, workers, engine, threads))
    for trial, (options, of_trial) in enumerate(zip(drawn, runs, strict=True)):
        means = _means([read_episodes(run, out).summary(METRICS) for run in of_trial])
        print(f"{trial:3}  {means}  {options or 'defaults'}", flush=True)


def _draw(ranges: dict[str, Any], generator: np.random.Generator) -> dict[str, Any]:
    return {
        name: _draw(bounds, generator) if isinstance(bounds, dict) else round(float(generator.uniform(*bounds)), 2)
        for name, bounds in ranges.items()
    }


def _means(estimates: Sequence[Mapping[str, Estimate]]) -> str:
    """Return the mean of each metric over scenarios."""
    means = {name: np.mean([each[name].mean for each in estimates]) * scale for name, scale in METRICS.items()}
    return "  ".join(f"{name} {mean:6.3g}" for name, mean in means.items())


if __name__ == "__main__":
    main(tune)
