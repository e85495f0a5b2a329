"""Traces to Rerun recordings and back: one recording per episode, all in one .rrd file.

What is shown is `drawing`'s affair, in Rerun's float32. What a score is computed from lies beside it,
exact, on entities that no view shows: `/exact/states` has a row per state, `/exact/episode` holds what does
not change.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import re
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Float, Int, Shaped
from rerun.chunk import Chunk, LazyChunkStream, RrdReader, StoreEntry

from crowdbench.errors import InputError
from crowdbench.record import drawing
from crowdbench.types import Outcome, Rules, Trace

FORMAT = 1
"""Version of what lies under `/exact`."""

NAME = re.compile(r"[a-z]+-(\d+)-[a-z]+")
"""A recording's name: split, case, outcome; the viewer lists recordings by it."""

STILL = ("goal", "radius", "preferred_speed", "present")


@dataclass(frozen=True)
class Recording:
    """What a file holds: the recorded episodes, ordered by case, and of how many cases of which run they are."""

    trace: Trace
    planner: str
    scenario: str
    scenario_digest: str
    cases: int


class Recorder:
    """Writes episodes into a file that appears under its name only when it is complete.

    It is used in a `with` statement; an exception inside leaves nothing behind. `cases` is how many cases the
    whole run has, recorded or not.
    """

    def __init__(self, path: Path, *, planner: str, scenario: str, scenario_digest: str, cases: int) -> None:
        self._path = path
        about = {"planner": planner, "scenario": scenario, "scenario_digest": scenario_digest, "cases": cases}
        self._run = {"format": FORMAT, **about}
        # The viewer lists the file under this name, and warns of other characters.
        self._application = re.sub(r"[^A-Za-z0-9 _.-]", "-", f"{planner} on {scenario}")
        self._extents: list[Float[np.ndarray, "2 2"]] = []
        self._plotted: dict[str, None] = {}

    def __enter__(self) -> Recorder:
        # Beside the target, so that the last step is a rename within one file system.
        self._folder = tempfile.TemporaryDirectory(prefix=f".{self._path.name}.", dir=self._path.parent)
        return self

    def add(
        self, trace: Trace, rows: Int[np.ndarray, "episode"], values: Mapping[str, Shaped[np.ndarray, "world"]]
    ) -> None:
        """Record the episodes of the given rows; `values` are the trace's metrics, shown as text."""
        for row in rows.tolist():
            label = Outcome(int(trace.outcome[row])).label
            title = f"planner {self._run['planner']} · scenario {self._run['scenario']}"
            # Whether it succeeded, collided, ... is what the outcome says.
            shown = {name: float(column[row]) for name, column in values.items() if column.dtype != bool}
            chunks = [
                drawing.still("__properties", rr.archetypes.RecordingInfo(name=f"case {trace.case[row]} · {label}")),
                *_exact(trace, row, self._run),
                *drawing.episode(trace, row, title, shown),
            ]
            name = f"{trace.split}-{trace.case[row]:04d}-{label}"
            part = Path(self._folder.name) / f"{len(self._extents)}.rrd"
            with self._writing():
                LazyChunkStream.from_iter(chunks).write_rrd(part, application_id=self._application, recording_id=name)
            self._extents.append(drawing.extent(trace, row))
        self._plotted |= dict.fromkeys(name for name, logged in trace.logs.items() if drawing.is_curve(logged))

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        with self._folder as folder:
            if kind is None and self._extents:
                parts = [f"{part}.rrd" for part in range(len(self._extents))]
                layout = drawing.layout(self._extents, list(self._plotted))
                with self._writing():
                    _join(Path(folder), parts, self._application, layout).replace(self._path)

    def _writing(self) -> contextlib.AbstractContextManager[None]:
        return _trouble(f"{self._path} could not be written: is the disk full? (--record none does without)")


def read(path: Path) -> Recording:
    """The episodes of a file, bit-equal to what was recorded, without what planners logged.

    Raises InputError where the file is not there, incomplete, or not one of crowdbench's.
    """
    with _open(path):
        reader = RrdReader(path)
        episodes = [_episode(_chunks(reader, entry, "/exact/**")) for entry in reader.recordings()]
    if not episodes or not all(episodes):
        raise _foreign(path)
    facts = [json.loads(episode["facts"][0]) for episode in episodes]
    if any(fact != facts[0] for fact in facts) or facts[0]["format"] != FORMAT:
        raise InputError(
            f"{path} mixes several runs or was written by another version of crowdbench: give one run's own run.rrd"
        )
    episodes.sort(key=lambda episode: int(episode["case_outcome_steps"][0]))
    run = {name: facts[0][name] for name in ("planner", "scenario", "scenario_digest", "cases")}
    return Recording(_trace(episodes, facts[0]["split"], Rules(**facts[0]["rules"])), **run)


def view(path: Path, case: int | None = None, screenshot: Path | None = None) -> None:
    """Open the Rerun viewer on a file, or on one case of it, and wait until it is closed.

    With `screenshot`, no window is opened, and a picture of the last state is written there instead (on a
    busy machine the viewer may take it before it has drawn everything). Raises InputError where the file or
    the case is not there, or the viewer does not start.
    """
    if screenshot is not None and (case is None or screenshot.suffix != ".png" or not screenshot.parent.is_dir()):
        raise InputError(f"a picture shows one case (--case 37) and goes to a .png file in a folder, not {screenshot}")
    with tempfile.TemporaryDirectory() as folder:
        shown = _extract(path, case, Path(folder))
        if screenshot is None and sys.platform == "linux" and not {"DISPLAY", "WAYLAND_DISPLAY"} & set(os.environ):
            raise InputError("there is no display for a window: take a picture with --case 37 --screenshot case.png")
        command = [sys.executable, "-m", "rerun_cli", "--port", "auto", str(shown)]
        if screenshot is None:
            ended = subprocess.run(command)
        else:
            screenshot.unlink(missing_ok=True)
            command += ["--headless", "--window-size", "1400x800", "--screenshot-to", str(screenshot.resolve())]
            # Without logs, because the viewer's notices would lie across the picture.
            ended = subprocess.run(command, env={**os.environ, "RUST_LOG": "off"}, capture_output=True)
    if ended.returncode or (screenshot is not None and not screenshot.exists()):
        raise InputError(
            f"the Rerun viewer failed on {path}: it needs a display or, for a screenshot, a Vulkan driver "
            "(Debian: mesa-vulkan-drivers)"
        )


def _join(folder: Path, parts: Sequence[str], application: str, layout: rrb.Blueprint) -> Path:
    """One file of all the parts in a folder and the layout to open them in.

    Routing leaves the messages as they are, which is faster than `rrd merge` and needs less memory.
    """
    layout.save(application, folder / "layout.rbl")
    command = [sys.executable, "-m", "rerun_cli", "rrd", "route", "-o", "whole.rrd", "layout.rbl", *parts]
    # In a session of its own, because Ctrl-C on a terminal reaches every process of the group.
    subprocess.run(command, cwd=folder, capture_output=True, start_new_session=True)
    whole = folder / "whole.rrd"
    # On a full disk rerun leaves a stump and exits with 0.
    if len(RrdReader(whole).recordings()) < len(parts):
        raise OSError(f"{whole} is incomplete")
    return whole


def _exact(trace: Trace, row: int, run: Mapping[str, Any]) -> Iterator[Chunk]:
    """What `read` restores an episode from, in full precision."""
    states, dt = int(trace.steps[row]) + 1, trace.rules.dt
    moving = {"position": trace.position[row, :states], "velocity": trace.velocity[row, :states]}
    moving["gap"] = np.append(np.nan, trace.gap[row, : states - 1])  # beside the state that the step leads to
    if trace.undisturbed is not None:
        moving["undisturbed"] = trace.undisturbed[row, :states]
    columns = {moment.timeline_name(): moment.as_arrow_array() for moment in drawing.times(0, states, dt)}
    columns |= {name: _lists(array) for name, array in moving.items()}
    yield from Chunk.from_record_batch(pa.record_batch(columns), index=["time", "step"], entity_path="/exact/states")
    columns = {name: _lists(getattr(trace, name)[row : row + 1]) for name in STILL}
    # Together, because each column costs a kilobyte or two in the file's index.
    columns["case_outcome_steps"] = _lists(np.array([[trace.case[row], trace.outcome[row], trace.steps[row]]]))
    facts = {**run, "split": trace.split, "rules": dataclasses.asdict(trace.rules)}
    columns["facts"] = pa.array([[json.dumps(facts)]])
    yield from Chunk.from_record_batch(pa.record_batch(columns), index=None, entity_path="/exact/episode")


def _lists(array: Shaped[np.ndarray, "row *values"]) -> pa.ListArray:
    """An Arrow column with the values of each row as a list."""
    flat = array.reshape(len(array), -1)
    offsets = np.arange(len(flat) + 1, dtype=np.int32) * flat.shape[1]
    return pa.ListArray.from_arrays(offsets, pa.array(flat.ravel()))


@contextlib.contextmanager
def _trouble(sentence: str) -> Iterator[None]:
    """Says in a sentence what Rerun's errors mean here."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Rerun warns of a missing end that it then raises for
            yield
    except (RuntimeError, ValueError, OSError) as error:
        raise InputError(sentence) from error


def _open(path: Path) -> contextlib.AbstractContextManager[None]:
    if not path.is_file():
        raise InputError(f"there is no recording at {path}: give the run.rrd of a run with --record all or failures")
    return _trouble(f"{path} is cut short, damaged or no Rerun file at all: give the run.rrd of a finished run")


def _foreign(path: Path) -> InputError:
    return InputError(f"{path} is a Rerun file but holds no episodes of crowdbench: give the run.rrd of a run")


def _chunks(reader: RrdReader, entry: StoreEntry, content: str) -> list[Chunk]:
    return reader.store(store=entry).stream().filter(content=content).to_chunks()


def _episode(chunks: Sequence[Chunk]) -> dict[str, np.ndarray]:
    """The flat arrays of an episode, by name; only Rerun's own columns hold no lists."""
    columns = [
        (name, batch.column(name))
        for batch in (chunk.to_record_batch() for chunk in chunks if chunk.entity_path.startswith("/exact/"))
        for name in batch.schema.names
    ]
    return {name: column.flatten().to_numpy(False) for name, column in columns if pa.types.is_list(column.type)}


def _trace(episodes: Sequence[Mapping[str, np.ndarray]], split: str, rules: Rules) -> Trace:
    """The batch of all episodes, padded like a rollout's, in time and to the largest crowd."""
    worlds, agents = len(episodes), max(len(episode["radius"]) for episode in episodes)
    states = rules.max_steps + 1
    position, velocity = np.full((2, worlds, states, agents, 2), np.nan)
    undisturbed = np.full((worlds, states, agents - 1, 2), np.nan)
    gap = np.full((worlds, rules.max_steps), np.nan)
    goal, radius, speed = np.zeros((worlds, agents, 2)), np.ones((worlds, agents)), np.ones((worlds, agents))
    present = np.zeros((worlds, agents), bool)
    for w, episode in enumerate(episodes):
        n, end = len(episode["radius"]), int(episode["case_outcome_steps"][2]) + 1
        position[w, :end, :n] = episode["position"].reshape(end, n, 2)
        velocity[w, :end, :n] = episode["velocity"].reshape(end, n, 2)
        if "undisturbed" in episode:
            undisturbed[w, :end, : n - 1] = episode["undisturbed"].reshape(end, n - 1, 2)
        gap[w, : end - 1] = episode["gap"][1:]
        goal[w, :n], radius[w, :n] = episode["goal"].reshape(n, 2), episode["radius"]
        speed[w, :n], present[w, :n] = episode["preferred_speed"], episode["present"]
    case, outcome, steps = np.array([episode["case_outcome_steps"] for episode in episodes]).T.copy()
    return Trace(
        split=split,
        case=case,
        outcome=outcome,
        steps=steps,
        position=position,
        velocity=velocity,
        gap=gap,
        goal=goal,
        radius=radius,
        preferred_speed=speed,
        present=present,
        rules=rules,
        undisturbed=undisturbed if "undisturbed" in episodes[0] else None,
    )


def _extract(path: Path, case: int | None, folder: Path) -> Path:
    """A file of one case alone, with a layout of its own; the file itself where no case is asked for."""
    with _open(path):
        reader = RrdReader(path)
        named = [(NAME.fullmatch(entry.recording_id), entry) for entry in reader.recordings()]
    entries = {int(match[1]): entry for match, entry in named if match}
    if not entries:
        raise _foreign(path)
    if case is None:
        return path.resolve()
    if case not in entries:
        near = sorted(sorted(entries, key=lambda other: abs(other - case))[:10])
        raise InputError(
            f"case {case} is not recorded in {path}: recorded near it are {_ranges(near)} (all are with --record all)"
        )
    with _open(path):
        chunks = _chunks(reader, entries[case], "/**")
    episode, entry = _episode(chunks), entries[case]
    facts = json.loads(episode["facts"][0])
    extent = drawing.extent(_trace([episode], facts["split"], Rules(**facts["rules"])), 0)
    own = f"/{drawing.PLANNER_PLOTS}/"
    plotted = {chunk.entity_path.removeprefix(own) for chunk in chunks if chunk.entity_path.startswith(own)}
    layout = drawing.layout([extent], sorted(plotted))
    with _trouble(f"a copy of case {case} could not be written to {folder}: is the disk full?"):
        LazyChunkStream.from_iter(chunks).write_rrd(
            folder / "case.rrd", application_id=entry.application_id, recording_id=entry.recording_id
        )
        return _join(folder, ["case.rrd"], entry.application_id, layout)


def _ranges(numbers: Iterable[int]) -> str:
    """Numbers in short: 0-9, 12, 17-18."""
    known = set(numbers)
    starts = sorted(n for n in known if n - 1 not in known)
    ends = sorted(n for n in known if n + 1 not in known)
    return ", ".join(f"{a}-{b}" if a < b else f"{a}" for a, b in zip(starts, ends, strict=True))
