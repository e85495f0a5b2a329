"""Writes episodes as Rerun recordings: one recording per episode, all in one .rrd file.

`drawing` makes what the viewer shows, in Rerun's float32; `exact` makes what is read back.
"""

from __future__ import annotations

import contextlib
import re
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType

import numpy as np
import rerun as rr
from jaxtyping import Float, Int, Shaped
from rerun.chunk import Chunk, LazyChunkStream, RrdReader

from crowdbench.record import drawing, exact, rrd
from crowdbench.record.blueprint import blueprint
from crowdbench.record.chunks import still
from crowdbench.record.plots import PLANNER_PLOTS, is_curve
from crowdbench.types import Outcome, Trace


class Recorder:
    """Writes episodes into one file, in a `with` statement.

    The file appears when the statement ends. After an exception there is no file.

    Args:
        path: The file.
        planner: The planner's name with its options.
        scenario: The scenario's name.
        scenario_digest: The scenario's digest.
        cases: How many cases the whole run has, recorded or not.
    """

    def __init__(self, path: Path, *, planner: str, scenario: str, scenario_digest: str, cases: int) -> None:
        self._path = path
        self._run = {"planner": planner, "scenario": scenario, "scenario_digest": scenario_digest, "cases": cases}
        # The viewer lists the file by this name, and warns of other characters.
        self._application = re.sub(r"[^A-Za-z0-9 _-]", "-", f"{planner} on {scenario}")
        self._extents: list[Float[np.ndarray, "2 2"]] = []
        self._plotted: dict[str, None] = {}
        self._fastest = 0.0

    def __enter__(self) -> Recorder:
        # In the same folder, so that moving the finished file is a rename within one file system.
        self._folder = tempfile.TemporaryDirectory(prefix=f".{self._path.name}.", dir=self._path.parent)
        return self

    def add(
        self, trace: Trace, rows: Int[np.ndarray, "episode"], values: Mapping[str, Shaped[np.ndarray, "world"]]
    ) -> None:
        """Record episodes.

        Args:
            trace: The trace with the episodes.
            rows: Their rows in the trace.
            values: Metrics of all episodes of the trace, by the names with units that are shown.

        Raises:
            InputError: They cannot be written.
        """
        for row in rows.tolist():
            label = Outcome(int(trace.outcome[row])).label
            title = f"planner {self._run['planner']} · scenario {self._run['scenario']}"
            shown = {name: column[row].item() for name, column in values.items()}
            chunks = [
                still("__properties", rr.archetypes.RecordingInfo(name=f"case {trace.case[row]} · {label}")),
                *exact.chunks(trace, row, self._run),
                *drawing.episode(trace, row, title, shown),
            ]
            name = f"{trace.split}-{trace.case[row]:04d}-{label}"
            self._keep(chunks, name, trace, row)
        self._plotted |= dict.fromkeys(name for name, logged in trace.logs.items() if is_curve(logged))

    def copy(self, path: Path) -> int:
        """Record the episodes of another recording, one of a part of the same run.

        Args:
            path: The recording.

        Returns:
            How many episodes it has.

        Raises:
            InputError: It cannot be read, or this one cannot be written.
        """
        with rrd.opening(path):
            reader = RrdReader(path)
            entries = reader.recordings()
        for entry in entries:
            with rrd.opening(path):
                chunks = rrd.chunks_of(reader, entry, "/**")
                episode = exact.episode(chunks)
                trace = exact.trace([episode], exact.facts_of(episode))
            self._keep(chunks, entry.recording_id, trace, 0)
            paths = {chunk.entity_path.removeprefix("/") for chunk in chunks}
            plotted = sorted(each for each in paths if each.startswith(f"{PLANNER_PLOTS}/"))
            self._plotted |= dict.fromkeys(each.removeprefix(f"{PLANNER_PLOTS}/") for each in plotted)
        return len(entries)

    def _keep(self, chunks: Sequence[Chunk], name: str, trace: Trace, row: int) -> None:
        """Write the file of one episode, which gets a name and is in a row of a trace."""
        part = Path(self._folder.name) / f"{len(self._extents)}.rrd"
        with self._writing():
            LazyChunkStream.from_iter(chunks).write_rrd(part, application_id=self._application, recording_id=name)
        self._extents.append(drawing.extent(trace, row))
        self._fastest = max(self._fastest, float(trace.preferred_speed[row, 0]))

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        with self._folder as folder:
            if kind is None and self._extents:
                parts = [f"{part}.rrd" for part in range(len(self._extents))]
                shown = blueprint(self._extents, list(self._plotted), self._fastest)
                with self._writing():
                    rrd.join(Path(folder), parts, self._application, shown).replace(self._path)

    def _writing(self) -> contextlib.AbstractContextManager[None]:
        return rrd.writing(f"the recording {self._path.name}", " (--record none does without)")
