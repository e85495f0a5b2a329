"""Export a run to other programs: tracks as files of positions, and a table of steps.

tracks/test-13.txt   one case: a line `frame person x y` for each position in metres, separated by tabs, as in ETH/UCY;
                     or test-13.json, see `export.socnav`; or a folder test-13, see `export.rosbag`
steps.parquet        a row for each step, see `export.steps`
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np

from crowdbench.core.types import Trace
from crowdbench.export.rosbag import write_bag
from crowdbench.export.socnav import write_trajectory
from crowdbench.export.steps import STEPS, StepWriter
from crowdbench.results.run_result import RunResult
from crowdbench.runs.replay import Loader, stored_traces
from crowdbench.runs.rollout import Progress

FOLDER = "tracks"
"""The folder of the tracks."""

TrackFormat = Literal["txt", "socnav", "rosbag2"]

VEHICLE = 0
"""The vehicle's number in the tracks; pedestrians are numbered from 1."""


def export_tracks(
    run: RunResult, load: Loader, folder: Path, progress: Progress | None = None, format: TrackFormat = "txt"
) -> int:
    """Write the tracks and the steps of all cases of a run.

    Args:
        run: The stored run.
        load: Loads the scenario of a simulated run.
        folder: The folder to write to.
        progress: Called after each step with its progress, summed over the episodes, in fractions of an episode.
        format: Format of the tracks.

    Returns:
        The number of cases.

    Raises:
        InputError: The run has no commands, a pedestrian policy breaks its contract, or an extra is not installed.
    """
    (folder / FOLDER).mkdir()
    cases = 0
    with StepWriter(folder / STEPS) as steps:
        for trace in stored_traces(run, load, progress=progress, watch=steps.watch):
            cases += len(trace)
            for row, case in enumerate(trace.case.tolist()):
                path = folder / FOLDER / f"{trace.split}-{case}"
                if format == "rosbag2":
                    write_bag(trace, row, path)
                elif format == "socnav":
                    source = f"{run.label} on {run.result['scenario']['name']}, {trace.split}/{case}"
                    kind = "simulated" if run.is_simulated else "recorded"
                    about = f"crowdbench: {source}; {kind}, not rated by people"
                    write_trajectory(trace, row, path.with_suffix(".json"), about)
                else:
                    _write_positions(trace, row, path.with_suffix(".txt"))
            steps.write(trace)
    return cases


def _write_positions(trace: Trace, row: int, path: Path) -> None:
    """Write the positions of the vehicle and all pedestrians in a case, frame by frame."""
    position = trace.position[row, : trace.steps[row] + 1]
    person = np.concatenate([np.full((len(position), 1), VEHICLE), trace.person[row, : len(position)] + 1], axis=1)
    frame, agent = np.nonzero(np.isfinite(position).all(axis=2))
    lines = zip(frame.tolist(), person[frame, agent].tolist(), position[frame, agent].tolist(), strict=True)
    path.write_text("".join(f"{t}\t{number}\t{x:.6f}\t{y:.6f}\n" for t, number, (x, y) in lines), encoding="utf-8")
