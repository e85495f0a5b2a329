"""The runs of a study: load them, find the ones that its folder lacks, and read them."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from pathlib import Path

from crowdbench import Episodes, load_scenario
from crowdbench.results import EPISODES
from crowdbench.runs import WHOLE, Run, RunSpec, Shard, is_complete, load_run, run_directory
from studies.schema import PlannerSpec


def load_runs(planners: Sequence[PlannerSpec], base: RunSpec) -> list[Run]:
    """Load the runs of planners in one scenario, which is loaded once.

    Args:
        planners: The planners with their options.
        base: The common part of all runs.

    Raises:
        InputError: A planner or the scenario does not exist.
    """
    scenario = load_scenario(base.scenario, base.overrides, base.pedestrians, base.data)
    specs = [dataclasses.replace(base, planner=each.planner, options=its) for each in planners for its in each.choices]
    return [load_run(spec, scenario=scenario) for spec in specs]


def missing_runs(runs: Iterable[Run], out: Path, shard: Shard = WHOLE) -> list[Run]:
    """Return the runs that are not in the folder, each once.

    Args:
        runs: The runs that are needed, possibly with duplicates.
        out: The folder.
        shard: The share of the runs to check. It does not depend on the runs that exist.
    """
    distinct = list({run_directory(run, out): run for run in runs}.values())
    return [run for run in shard.select(distinct) if not is_complete(run, out)]


def read_episodes(run: Run, out: Path) -> Episodes:
    """Read the episodes of a run in the folder. Raises InputError if it is missing."""
    return Episodes.read(run_directory(run, out) / EPISODES)
