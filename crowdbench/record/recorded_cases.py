"""The cases of a recording, one by one."""

from __future__ import annotations

import functools
import re
from pathlib import Path
from typing import Any, NamedTuple

from rerun.chunk import Chunk, RrdReader, StoreEntry

from crowdbench.record import rrd
from crowdbench.record.decisions import PlannedPaths, read_paths
from crowdbench.scenario.cases import parse_case
from crowdbench.utils.errors import InputError

NAME = re.compile(r"([a-z]+)-(\d+)-([a-z_]+)(-[0-9a-f]+)?")
"""The name of an episode's recording in the viewer: split, case, outcome, and the digest of the run."""

PROPERTIES = "crowdbench"
"""The name of the properties of a recording, see `Recorder`."""

VERDICT, EXTENT, SPEED = "verdict", "extent", "preferred_speed"
"""Properties: the sentences of `explanation.describe_failure`, and the values that the layout of the viewer needs."""


class RecordedEpisode(NamedTuple):
    """An episode in a recording.

    Attributes:
        entry: Its name in the file.
        chunks: All its chunks.
        properties: Its properties by name.
    """

    entry: StoreEntry
    chunks: list[Chunk]
    properties: dict[str, Any]

    @property
    def verdict(self) -> list[str]:
        """The sentences on its failure, which use the planner's predictions; none if it succeeds."""
        return self.properties.get(VERDICT, [])

    def paths(self, dt: float, *, commands: bool = False) -> dict[int, PlannedPaths]:
        """Return the paths that the planner predicted, considered and planned, by the number of the state.

        Args:
            dt: Length of a step in seconds.
            commands: True to add the commands that the planner compared, as paths of one second.
        """
        return read_paths(self.chunks, dt, commands=commands)


def recorded_outcomes(path: Path) -> dict[int, str]:
    """Return the label of the outcome of each case in a recording, sorted by case.

    Raises InputError if it cannot be read, or was not written by crowdbench.
    """
    return {case: outcome for case, (_, outcome) in sorted(_entries(path)[2].items())}


def find_case(path: Path, case: str) -> int:
    """Return the number of a case, which is given by its name or its number. Raises InputError if it has no such
    case."""
    recorded = _entries(path)[1]
    split, number = parse_case(case, recorded)
    if split != recorded or number not in recorded_outcomes(path):
        raise InputError(f"case {case} is not recorded in {path} (all cases are with --record all)")
    return number


def read_recorded(path: Path, case: int) -> RecordedEpisode | None:
    """Return one case of a recording; None if there is no such file, or the case is not recorded.

    Raises InputError if the file is damaged, or was not written by crowdbench.
    """
    if not path.exists():
        return None
    reader, _, entries = _entries(path)
    if case not in entries:
        return None
    entry, _ = entries[case]
    with rrd.reading(path):
        chunks = reader.store(store=entry).stream().to_chunks()
        properties: dict[str, Any] = {}
        for chunk in chunks:
            if chunk.entity_path == f"/__properties/{PROPERTIES}":
                batch = chunk.to_record_batch()
                properties |= {
                    name: batch[name][0].as_py() for name in batch.schema.names if not name.startswith("rerun.")
                }
        return RecordedEpisode(entry, chunks, properties)


def _entries(path: Path) -> tuple[RrdReader, str, dict[int, tuple[StoreEntry, str]]]:
    """Return the reader of a recording, its split, and the entry and the outcome of each case."""
    return _read_entries(path, path.stat().st_mtime_ns if path.is_file() else 0)


@functools.lru_cache(maxsize=1)
def _read_entries(path: Path, changed: int) -> tuple[RrdReader, str, dict[int, tuple[StoreEntry, str]]]:
    """Return `_entries` of a file; `changed` is the time of its last change, a key of the cache."""
    with rrd.reading(path):
        reader = RrdReader(path)
        named = [(NAME.fullmatch(entry.recording_id), entry) for entry in reader.recordings()]
    entries = {int(name[2]): (entry, name[3]) for name, entry in named if name}
    splits = {name[1] for name, _ in named if name}
    if len(splits) != 1 or len(entries) != len(named):
        raise InputError(f"{path} is a Rerun file but holds no episodes of crowdbench: give the run.rrd of a run")
    return reader, splits.pop(), entries
