"""Writes episodes as Rerun recordings: one recording per episode, all in one .rrd file.

Recordings are for viewing, in Rerun's float32: a run's exact store is its commands, or its tracks.
"""

from __future__ import annotations

import contextlib
import dataclasses
import importlib.metadata
import json
import math
import re
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
from jaxtyping import Float, Int, Shaped
from rerun.chunk import Chunk, LazyChunkStream

from crowdbench.core.types import Outcome, Trace
from crowdbench.metrics.registry import info_of
from crowdbench.record import rrd
from crowdbench.record.blueprint import blueprint, logged_curves
from crowdbench.record.entities import draw_episode, extent
from crowdbench.record.explanation import describe_failure
from crowdbench.record.recorded_cases import EXTENT, PROPERTIES, SPEED, VERDICT, read_recorded, recorded_outcomes
from crowdbench.record.rrd import still


@dataclass
class Recorder:
    """Recorder of episodes into one file, in a `with` statement.

    The file appears when the statement ends. After an exception there is no file.

    Attributes:
        path: The file.
        planner: The planner's name with its options.
        scenario: The scenario's name.
        scenario_digest: The scenario's digest.
        options: The planner's options.
        units: Units of the metrics that have one.
        identity: The digest of the run. Names of its recordings end with it, because Rerun treats recordings with the
            same name as one recording, even from different files.
    """

    path: Path
    _: dataclasses.KW_ONLY
    planner: str
    scenario: str
    scenario_digest: str
    options: Mapping[str, Any] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    identity: str = ""

    def __enter__(self) -> Recorder:
        # In the same folder, so that moving the finished file is a rename within one file system.
        self._folder = tempfile.TemporaryDirectory(prefix=f".{self.path.name}.", dir=self.path.parent)
        # The viewer lists the file under this name, and warns if it has other characters or more than 180.
        self._application = re.sub(r"[^A-Za-z0-9 _-]", "-", f"{self.planner[:100]} on {self.scenario}")[:180]
        self._version = importlib.metadata.version("crowdbench")
        self._extents: list[Float[np.ndarray, "2 2"]] = []
        self._plotted: dict[str, int] = {}
        self._fastest = 0.0
        return self

    def add(
        self, trace: Trace, rows: Int[np.ndarray, "episode"], values: Mapping[str, Shaped[np.ndarray, "world"]]
    ) -> None:
        """Record episodes.

        Args:
            trace: The trace with the episodes.
            rows: Their rows in the trace.
            values: Metrics of all episodes of the trace, by name.

        Raises:
            InputError: They cannot be written.
        """
        for row in rows.tolist():
            outcome = Outcome(int(trace.outcome[row]))
            title = f"planner {self.planner} · scenario {self.scenario}"
            measured = {name: column[row].item() for name, column in values.items()}
            chunks = [
                *self._properties(trace, row, measured),
                *draw_episode(trace, row, title, self._texts(measured)),
            ]
            name = f"{trace.split}-{trace.case[row]:04d}-{outcome.label}"
            name = f"{name}-{self.identity}" if self.identity else name
            self._keep(chunks, name, extent(trace, row), float(trace.preferred_speed[row, 0]))

    def _properties(self, trace: Trace, row: int, measured: Mapping[str, float | bool]) -> Iterator[Chunk]:
        """Yield the properties of one episode for tables of many recordings."""
        case, outcome = int(trace.case[row]), Outcome(int(trace.outcome[row])).label
        yield still("__properties", rr.archetypes.RecordingInfo(name=f"case {trace.split}/{case} · {outcome}"))
        # In one column, because each column needs one or two kilobytes in the file's index.
        metrics = pa.StructArray.from_arrays([pa.array([value]) for value in measured.values()], names=[*measured])
        about = {
            "planner": self.planner,
            "options": json.dumps(self.options),
            "scenario": self.scenario,
            "scenario_digest": self.scenario_digest,
            "split": trace.split,
            "case": case,
            "outcome": outcome,
            "metrics": metrics,
            "version": self._version,
            EXTENT: extent(trace, row).ravel(),
            SPEED: float(trace.preferred_speed[row, 0]),
        }
        if sentences := describe_failure(trace, row):
            about[VERDICT] = sentences
        yield Chunk.from_property(PROPERTIES, rr.AnyValues(**about))

    def _texts(self, measured: Mapping[str, float | bool]) -> dict[str, str]:
        """Return the defined metrics as texts, by their titles."""
        texts = {}
        for name, value in measured.items():
            info = dataclasses.replace(info_of(name), unit=self.units.get(name, ""))
            if isinstance(value, bool):
                texts[info.title] = "yes" if value else "no"
            elif math.isfinite(value):
                texts[info.title] = info.amount(value)
        return texts

    def copy(self, path: Path) -> int:
        """Record the episodes of another recording, which contains a part of the same run.

        Args:
            path: The recording.

        Returns:
            The number of its episodes.

        Raises:
            InputError: It cannot be read, or this one cannot be written.
        """
        number = 0
        for case in recorded_outcomes(path):
            episode = read_recorded(path, case)
            if episode is not None:
                corners, [speed] = np.reshape(episode.properties[EXTENT], (2, 2)), episode.properties[SPEED]
                self._keep(episode.chunks, episode.entry.recording_id, corners, speed)
                number += 1
        return number

    def _keep(self, chunks: Sequence[Chunk], name: str, extent: Float[np.ndarray, "2 2"], speed: float) -> None:
        """Write the file of one episode under a name, and store the numbers that the layout of the viewer needs."""
        part = Path(self._folder.name) / f"{len(self._extents)}.rrd"
        with self._writing():
            LazyChunkStream.from_iter(chunks).write_rrd(part, application_id=self._application, recording_id=name)
        self._extents.append(extent)
        self._fastest = max(self._fastest, speed)
        for curve, count in logged_curves(chunks).items():  # crowds differ in size, and so do their curves
            self._plotted[curve] = max(count, self._plotted.get(curve, 0))

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        with self._folder as folder:
            if kind is None and self._extents:
                parts = [f"{part}.rrd" for part in range(len(self._extents))]
                layout = blueprint(self._extents, self._plotted, self._fastest)
                with self._writing():
                    rrd.join(Path(folder), parts, self._application, layout).replace(self.path)

    def _writing(self) -> contextlib.AbstractContextManager[None]:
        return rrd.writing(f"the recording {self.path.name}", " (--record none makes no recording)")
