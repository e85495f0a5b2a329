"""Converts the bags of a real robot to a run for `crowdbench score`, and the observed pedestrians to tracks.

python adapters/ros2/score_bags.py drive.toml --out runs/drive --tracks tracks
"""

from __future__ import annotations

import hashlib
import itertools
from pathlib import Path

import numpy as np
from drive import trace_of
from drive_file import read_drive_file

from crowdbench import Episodes, InputError, Trace, load_scenario
from crowdbench.cli import main, say
from crowdbench.metrics import load_metrics
from crowdbench.record import Recorder
from crowdbench.results import RECORDING, TRACKS, write_run, write_tracks
from crowdbench.runs import PlannerId, RunId, code, read_versions, source_of, units_of
from crowdbench.utils import command, new_directory

FRAME, STEP = 10, 0.4
"""Difference of the numbers of consecutive frames of tracks, and the seconds between them, as in ETH/UCY."""

TIME_LIMITS, DISTANCES = (25.0, 15.0, 10.0, 5.0, 3.0, 1.5), (8.0, 5.0, 3.0, 2.0, 1.0)
"""Seconds of an episode and metres of a trip that are tried for a command."""


def convert(file: Path, out: Path = Path("runs/drive"), tracks: Path | None = None) -> None:
    """Write the run of the bags in a drive file.

    Args:
        file: The drive file, see `drive_file.py`.
        out: Directory of the run, for `crowdbench score`, `table`, `view` and `render`.
        tracks: Folder for a file with the pedestrians of each bag, for scenarios with a table [tracks].
    """
    drive = read_drive_file(file)
    names = [Path(bag).stem for bag in drive.bags]
    if tracks is not None and len({*names}) < len(names):
        raise InputError(f"{file}: the bags have the names {', '.join(names)}, but for --tracks all must be different")
    trace, notes = trace_of(drive)
    for note in notes:
        say(note)
    contents = hashlib.sha256(file.read_bytes())
    for bag in map(Path, drive.bags):
        for part in sorted(bag.iterdir()) if bag.is_dir() else [bag]:
            contents.update(part.read_bytes())
    write(trace, drive.planner, file.stem, contents.hexdigest(), out, notes)
    say(f"wrote {out}\n  {command('score', out)}\n  {command('view', out)}")
    if tracks is not None:
        tracks.mkdir(parents=True, exist_ok=True)
        for row, name in enumerate(names):
            write_pedestrians(trace, row, tracks / f"{name}.txt")
        say(f"wrote {tracks}\n  {describe_next(tracks, names[0])}")


def describe_next(tracks: Path, scene: str) -> str:
    """Return a command that drives among the pedestrians of a bag, with the longest episodes and trips that fit.

    Args:
        tracks: The folder with the tracks.
        scene: The name of the file with the pedestrians, without suffix.
    """
    reason = ""
    for seconds, metres in itertools.product(TIME_LIMITS, DISTANCES):
        changes = {"tracks.scene": scene, "time_limit": seconds, "tracks.distance": metres}
        try:
            scenario = load_scenario("eth_recorded", changes, data=tracks)
            assert scenario.tracks is not None
            cases = len(scenario.tracks.windows["test"])
            scenario.draw("test", np.arange(cases))
        except InputError as error:
            reason = reason or f"no planner can be tried among these pedestrians: {error}"
            continue
        words = [word for key, value in changes.items() for word in ("--set", f"{key}={value}")]
        options = ("--planner", "orca", "--scenario", "eth_recorded", "--data", tracks, "--cases", cases)
        return command("run", *options, *words)
    return reason


def write(trace: Trace, planner: str, scenario: str, digest: str, out: Path, notes: list[str]) -> None:
    """Write a trace as a run.

    Args:
        trace: The trace.
        planner: Name of the planner.
        scenario: Name of the scenario in tables.
        digest: 64 hexadecimal digits that change with the bags.
        out: The directory, which is replaced.
        notes: Sentences on gaps and guesses, which the result states.
    """
    metrics, rules = load_metrics([]), trace.rules
    cases = f"test:{len(trace)}"
    sources = {name: source_of(metric) for name, metric in metrics.items()}
    run = RunId(PlannerId(planner, facts={"bags": digest}), digest, cases, {}, None, sources, 0.0, code())
    episodes = Episodes.of(trace, metrics)
    with new_directory(out, overwrite=True) as folder:
        write_tracks(trace, folder / TRACKS)
        recorder = Recorder(
            folder / RECORDING,
            planner=planner,
            scenario=scenario,
            scenario_digest=digest,
            units=units_of(metrics),
            identity=run.digest[:8],
        )
        with recorder:
            recorder.add(trace, np.arange(len(trace)), episodes.columns)
        write_run(
            folder,
            episodes,
            run=run.parts,
            scenario={
                "name": scenario,
                "layout": {},
                "pedestrians": {},
                "dt": rules.dt,
                "time_limit": rules.time_limit,
            },
            recorded=len(trace),
            stated={
                "privileged": False,
                "overrides": {},
                "record": "all",
                "notes": notes,
                "timing": {"seconds": float(rules.dt * trace.steps.sum())},
                "versions": read_versions(),
            },
        )


def write_pedestrians(trace: Trace, row: int, path: Path) -> None:
    """Write the pedestrians of a drive in the format of ETH/UCY: positions every 0.4 s, by linear interpolation."""
    position = trace.position[row, : trace.steps[row] + 1, 1:]
    time = trace.rules.dt * np.arange(len(position))
    frames = np.arange(0.0, time[-1] + 1e-9, STEP)
    lines = []
    for person in range(position.shape[1]):
        here = np.isfinite(position[:, person, 0])
        inside = (frames >= time[here].min(initial=np.inf)) & (frames <= time[here].max(initial=-np.inf))
        x, y = (np.interp(frames[inside], time[here], position[here, person, axis]) for axis in range(2))
        numbers = (FRAME * np.flatnonzero(inside)).tolist()
        lines += [(n, person + 1, *at) for n, *at in zip(numbers, x.tolist(), y.tolist(), strict=True)]
    path.write_text("".join(f"{n}\t{person}\t{x:.6f}\t{y:.6f}\n" for n, person, x, y in sorted(lines)))


if __name__ == "__main__":
    main(convert)
