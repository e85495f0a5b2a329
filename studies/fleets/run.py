"""Measure networks that were trained with several vehicles in a world, and other planners, in self-play."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[2]))

from crowdbench.cli import ThreadsOption, help_from_docstring, main, use_threads
from crowdbench.utils import Format, markdown, printed_by

SCENARIOS = ("fleet_4", "fleet_door_3")
SEEDS = ("", "-seed0", "-seed1", "-seed2", "-seed3")
NETWORKS = (*(f"ippo{seed}" for seed in SEEDS), *(f"mappo{seed}" for seed in SEEDS), "ppo_attention")
PLANNERS = ("orca", "mppi")
METRICS = ("score", "success_rate", "at_fault_rate")
CASES = "test:100"

DESCRIPTION = """# Several vehicles that have learned together

One planner drives all vehicles of a world. `ippo` and `mappo` are networks of `ppo_attention`, trained with five seeds
each in both scenarios, for 2,500,000 steps of a vehicle: by IPPO (de Witt et al. 2020,
[arXiv:2011.09533](https://arxiv.org/abs/2011.09533)), and by MAPPO (Yu et al. 2022,
[arXiv:2103.01955](https://arxiv.org/abs/2103.01955)), whose value depends on the state of the world. Success on
validation cases of both scenarios chose the checkpoints, and the seed of the default network of each, which is seed 4.
`ppo_attention` was never trained with another vehicle.

All ten networks score more than `orca` in `fleet_4`. At the door, one seed of each five collides in most cases
(`ippo-seed2` and `mappo-seed0`), as on validation cases. Scores among vehicles of other planners are in
[Several vehicles](../../docs/fleet.md#results)."""


@help_from_docstring
def fleets(
    cases: str = CASES,
    out: Path = Path("runs/study-fleets"),
    threads: ThreadsOption = None,
    format: Format = Format.MARKDOWN,
) -> None:
    """Execute the missing runs, and print the page of the study.

    Args:
        cases: The cases of each run.
        out: Folder for the runs.
    """
    use_threads(threads)
    from crowdbench import Cases
    from crowdbench.results import RunResult, RunTable
    from crowdbench.runs import RunSpec, load_run, run_directory
    from studies.command import make_runs, print_study

    drawn = Cases.parse(cases)
    planners = {name: ("ppo_attention", {"weights": name}) for name in NETWORKS} | {
        name: (name, {}) for name in PLANNERS
    }
    runs = {
        (scenario, label): load_run(RunSpec(planner, scenario, drawn, options=options, record="none"))
        for scenario in SCENARIOS
        for label, (planner, options) in planners.items()
    }
    make_runs(list(runs.values()), out)
    found = {pair: RunResult.read(run_directory(run, out), tables_only=True) for pair, run in runs.items()}
    table = RunTable({scenario: {label: found[scenario, label] for label in planners} for scenario in SCENARIOS})
    grids = [table.cross(metric) for metric in METRICS]
    parts = [printed_by("python studies/fleets/run.py"), DESCRIPTION]
    for grid in grids:
        parts += [f"## {grid.title.capitalize()}", markdown(grid.header, grid.rows), grid.note]
    print_study({"tables": grids}, grids, "\n\n".join(filter(None, parts)), format)


if __name__ == "__main__":
    main(fleets)
