"""Try random options of a planner on validation cases, and print what each reaches: `python studies/tuning.py dwa`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

sys.path.append(str(Path(__file__).parents[1]))

from crowdbench import InputError, Result, run
from crowdbench.cli import main
from crowdbench.cli.options import help_from_docstring

SCENARIOS = "noisy_10", "unicycle_10", "doorway_10"
"""Noise, wheels and walls: the scenarios in which planners that plan are tuned."""

COSTS = {"near": (3.0, 12.0), "fading": (0.7, 0.9), "growth": (0.15, 0.6), "sigma_factor": (0.2, 1.2)}
RANGES: dict[str, dict[str, dict[str, tuple[float, float]]]] = {
    "mppi": {"weights": COSTS},
    "mppi_interactive": {"weights": COSTS, "inference": {"concentration": (4.0, 16.0), "memory": (1.5, 6.0)}},
    "dwa": {
        "objective": {"clearance": (4.0, 12.0), "room": (1.0, 4.0), "margin": (0.05, 0.2), "sigma_factor": (0.2, 1.2)}
    },
}
"""Lowest and highest value of the options of each planner; the first trial has its defaults."""


@help_from_docstring
def tune(planner: str, trials: int = 30, cases: int = 20, out: Path = Path("runs/tuning")) -> None:
    """Print the mean success, share at fault and time of each trial. Runs that are kept are not repeated.

    Args:
        planner: One of `RANGES`.
        trials: Number of configurations.
        cases: Validation cases of each scenario.
        out: Folder that keeps the runs.
    """
    if planner not in RANGES:
        raise InputError(f"planner is {planner}, but must be one of {', '.join(RANGES)}")
    generator = np.random.default_rng(1)
    for trial in range(trials):
        options: dict[str, Any] = {
            part: {name: round(float(generator.uniform(*bounds)), 2) for name, bounds in table.items()}
            for part, table in RANGES[planner].items()
        }
        where, asked = out / f"{planner}-{trial}", {"filter": "kalman"} | (options if trial else {})
        results = [run(planner, name, f"val:{cases}", options=asked, out=where / name) for name in SCENARIOS]
        print(f"{trial:3}  {_means(results)}  {options if trial else 'defaults'}", flush=True)


def _means(results: list[Result]) -> str:
    names = {"success_rate": 100.0, "at_fault_rate": 100.0, "navigation_time": 1.0}
    return "  ".join(f"{k} {np.mean([r.metrics[k].mean * scale for r in results]):5.1f}" for k, scale in names.items())


if __name__ == "__main__":
    main(tune)
