"""Export a run to other programs: tracks as files of positions, and a table of observations, actions and rewards.

tracks/test-13.txt   one case: a line `frame person x y` for each position in metres, separated by tabs, as in ETH/UCY;
                     or test-13.json, see `export.socnav`; or a folder test-13, see `export.rosbag`
steps.parquet        a row for each step: case, step, observation, action, reward, terminated, truncated

The cases are simulated again from the run's commands. Drives of a robot are exported from their recorded states: their
steps have no observation, and their action is the velocity in m/s.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from jaxtyping import Float

from crowdbench.core.reward import episode_rewards
from crowdbench.core.types import Outcome, Trace, World
from crowdbench.export.rosbag import write_bag
from crowdbench.export.socnav import write_trajectory
from crowdbench.results.run_result import RunResult
from crowdbench.runs.replay import Loader, traces_of
from crowdbench.runs.rollout import Progress
from crowdbench.views.ego import flatten_vehicle

TRACKS, STEPS = "tracks", "steps.parquet"
"""The folder of the tracks, and the file of the steps."""

TrackFormat = Literal["txt", "socnav", "rosbag2"]

VEHICLE = 0
"""The vehicle's number in the tracks; pedestrians are numbered from 1."""


def export(
    run: RunResult, load: Loader, folder: Path, progress: Progress | None = None, format: TrackFormat = "txt"
) -> int:
    """Write the tracks and the steps of all cases of a run.

    Args:
        run: The stored run.
        load: Reconstructs the scenario of a simulated run.
        folder: The folder to write to.
        progress: Called after each step with its progress, summed over the episodes, in fractions of an episode.
        format: Format of the tracks.

    Returns:
        The number of cases.

    Raises:
        InputError: The run has no commands, a pedestrian policy breaks its contract, or an extra is not installed.
    """
    (folder / TRACKS).mkdir()
    cases = 0
    seen: dict[tuple[int, int], Float[np.ndarray, "features"]] = {}

    def watch(world: World) -> None:
        """Store the observations before a step, in the format of the environments."""
        numbers = zip(world.case.tolist(), world.step.tolist(), strict=True)
        seen.update(zip(numbers, flatten_vehicle(world), strict=True))

    with contextlib.ExitStack() as stack:
        writer: pq.ParquetWriter | None = None
        for trace in traces_of(run, load, progress, watch):
            cases += len(trace)
            for row, case in enumerate(trace.case.tolist()):
                path = folder / TRACKS / f"{trace.split}-{case}"
                if format == "rosbag2":
                    write_bag(trace, row, path)
                elif format == "socnav":
                    source = f"{run.label} on {run.result['scenario']['name']}, {trace.split}/{case}"
                    about = f"crowdbench: {source}; {'recorded' if run.drives else 'simulated'}, not rated by people"
                    write_trajectory(trace, row, path.with_suffix(".json"), about)
                else:
                    _write_tracks(trace, row, path.with_suffix(".txt"))
            table = _tabulate(trace, seen)
            writer = writer or stack.enter_context(pq.ParquetWriter(folder / STEPS, table.schema, compression="zstd"))
            writer.write_table(table)
            seen.clear()
    return cases


def _write_tracks(trace: Trace, row: int, path: Path) -> None:
    """Write the positions of the vehicle and all pedestrians in a case, frame by frame."""
    position = trace.position[row, : trace.steps[row] + 1]
    person = np.concatenate([np.full((len(position), 1), VEHICLE), trace.person[row, : len(position)] + 1], axis=1)
    frame, agent = np.nonzero(np.isfinite(position).all(axis=2))
    lines = zip(frame.tolist(), person[frame, agent].tolist(), position[frame, agent].tolist(), strict=True)
    path.write_text("".join(f"{t}\t{number}\t{x:.6f}\t{y:.6f}\n" for t, number, (x, y) in lines), encoding="utf-8")


def _tabulate(trace: Trace, seen: Mapping[tuple[int, int], Float[np.ndarray, "features"]]) -> pa.Table:
    """Return a table with a row for each step of cases."""
    cases = list(zip(trace.case.tolist(), trace.steps.tolist(), strict=True))
    is_last = np.concatenate([np.arange(steps) == steps - 1 for _, steps in cases])
    outcome = np.repeat(trace.outcome, trace.steps)
    observations = [seen[case, step] for case, steps in cases for step in range(steps)] if seen else None
    inside = np.arange(trace.command.shape[1]) < trace.steps[:, None]
    columns = {
        "case": pa.array(np.repeat(trace.case, trace.steps)),
        "step": pa.array(np.concatenate([np.arange(steps) for _, steps in cases])),
        **({"observation": _rows(np.stack(observations))} if observations else {}),
        "action": _rows(trace.command[inside]),
        "reward": pa.array(episode_rewards(trace)[inside]),
        "terminated": pa.array(is_last & (outcome != Outcome.TIMEOUT)),
        "truncated": pa.array(is_last & (outcome == Outcome.TIMEOUT)),
    }
    return pa.table(columns)


def _rows(values: Float[np.ndarray, "row _"]) -> pa.FixedSizeListArray:
    return pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), values.shape[1])
