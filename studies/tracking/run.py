"""Measure the tracks of the detector in three scenarios. Prints README.md beside this file."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

sys.path.append(str(Path(__file__).parents[2]))

from crowdbench.cli import ThreadsOption, help_from_docstring, main, use_threads
from crowdbench.utils import Format, Grid, markdown, printed_by
from studies.command import print_study

RADIUS = {"circle_20": 0.3, "door_10": 0.2, "street_8": 0.3}
"""The scenarios, and the radius of their pedestrians in metres."""

SENSOR = {"sensor.track": "realistic"}

DETECTORS: Mapping[str, Mapping[str, Any]] = {
    "default": {},
    "no false detections": {"false_detections": 0.0},
    "velocity, with an error of 0.5 m/s": {"velocity": 0.5},
    "no errors": {"position": 0.0, "missed": 0.0, "false_detections": 0.0},
}
"""Keys of `[sensor.detector]` by the title of a row."""

DESCRIPTION, NOTES = (
    " ".join(part.split())
    for part in Path(__file__).with_name("notes.txt").read_text("utf-8").split("\n\n", maxsplit=1)
)


@help_from_docstring
def tracking(
    cases: str = "test:100", planner: str = "orca", threads: ThreadsOption = None, format: Format = Format.MARKDOWN
) -> None:
    """Measure the tracks of the detector: errors, misses, false tracks and identity switches.

    Args:
        cases: The cases of each scenario: test:200 (the first 200 test cases), val:20.
        planner: The planner that drives by the tracks.
    """
    use_threads(threads)
    from crowdbench import load_scenario
    from studies.tracking.clear_mot import ESTIMATES, count, estimate

    grids = []
    for name, radius in RADIUS.items():
        rows = []
        for title, keys in DETECTORS.items():
            detector = {"sensor.detector": {"radius": radius, **keys}}
            counts = count(planner, load_scenario(name, {**SENSOR, **detector}), cases)
            rows.append([title, *(estimate(each, counts) for each in ESTIMATES)])
        grids.append(Grid(name, ["detector", *ESTIMATES], rows))
    changed = "" if (cases, planner) == ("test:100", "orca") else f" --cases {cases} --planner {planner}"
    head = [printed_by(f"python studies/tracking/run.py{changed}"), DESCRIPTION]
    tables = [f"## `{grid.title}`\n\n{markdown(grid.header, grid.rows)}" for grid in grids]
    notes = f"Cases {cases}, driven by `{planner}`, with 95 % intervals of a bootstrap over episodes. {NOTES}"
    print_study(grids, grids, "\n\n".join([*head, *tables, notes]), format)


if __name__ == "__main__":
    main(tracking)
