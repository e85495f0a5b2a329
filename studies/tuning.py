"""Try random options of a planner on validation cases, and print their results: `python studies/tuning.py dwa`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

sys.path.append(str(Path(__file__).parents[1]))

from crowdbench import InputError, Result, run
from crowdbench.cli import help_from_docstring, main

SCENARIOS = "noisy_10", "doorway_10", "blind_corner_5", "corridor_8", "blocks_12", "intersection_16"
"""Noise, walls, and pedestrians that do not see the vehicle."""

COSTS = {"near": (3.0, 12.0), "fading": (0.7, 0.9), "growth": (0.15, 0.6), "sigma_factor": (0.2, 1.2)}
GOALS = {"concentration": (4.0, 16.0), "memory": (1.5, 6.0)}
OBJECTIVE = {"clearance": (4.0, 12.0), "room": (1.0, 4.0), "margin": (0.05, 0.2), "sigma_factor": (0.2, 1.2)}
RISK = {"threshold": (0.01, 0.2), "soft": (10.0, 100.0), "hard": (100.0, 600.0)}
RANGES: dict[str, dict[str, Any]] = {
    "mppi": {"weights": COSTS},
    "mppi_interactive": {"weights": COSTS, "inference": GOALS, "ignoring": (0.05, 0.5), "worst": (0.3, 1.0)},
    "dwa": {"objective": OBJECTIVE},
    "brne": {"straightness": (0.02, 0.2), "width": (0.3, 2.0), "zone": (2.0, 12.0), "penalty": (100.0, 1000.0)},
    "dra_mppi": RISK | {"speed": (0.2, 1.5), "change": (0.2, 1.5), "spread": (0.2, 0.6)},
}
"""Lowest and highest value of the options of each planner; the first trial has its defaults."""


@help_from_docstring
def tune(planner: str, trials: int = 30, cases: int = 20, out: Path = Path("runs/tuning")) -> None:
    """Print the mean success, share at fault and time of each trial. Existing runs are not repeated.

    Args:
        planner: One of `RANGES`.
        trials: Number of configurations.
        cases: Validation cases of each scenario.
        out: Folder for the runs.
    """
    if planner not in RANGES:
        raise InputError(f"planner is {planner}, but must be one of {', '.join(RANGES)}")
    generator = np.random.default_rng(1)
    for trial in range(trials):
        options = _draw(RANGES[planner], generator)
        where, asked = out / f"{planner}-{trial}", {"filter": "kalman"} | (options if trial else {})
        results = [run(planner, s, f"val:{cases}", options=asked, out=where / s, record="none") for s in SCENARIOS]
        print(f"{trial:3}  {_means(results)}  {options if trial else 'defaults'}", flush=True)


def _draw(ranges: dict[str, Any], generator: np.random.Generator) -> dict[str, Any]:
    return {
        name: _draw(bounds, generator) if isinstance(bounds, dict) else round(float(generator.uniform(*bounds)), 2)
        for name, bounds in ranges.items()
    }


def _means(results: list[Result]) -> str:
    names = {"success_rate": 100.0, "at_fault_rate": 100.0, "navigation_time": 1.0}
    return "  ".join(f"{k} {np.mean([r.metrics[k].mean * scale for r in results]):5.1f}" for k, scale in names.items())


if __name__ == "__main__":
    main(tune)
