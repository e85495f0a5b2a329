"""The cases of a recording, one by one."""

from __future__ import annotations

import functools
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from rerun.chunk import RrdReader, StoreEntry

from crowdbench.record import contents, rrd
from crowdbench.scenario.cases import parse_case
from crowdbench.utils.errors import InputError

NAME = re.compile(r"([a-z]+)-(\d+)-[a-z_]+(-[0-9a-f]+)?")
"""The name of an episode's recording in the viewer: split, case, outcome, and the digest of the run."""


PROPERTIES, VERDICT = "crowdbench", "verdict"
"""The name of the properties of a recording, and of the property with the sentences of `verdict.describe_failure`."""


def read_verdict(path: Path, case: int) -> list[str]:
    """Return the sentences on the failure in a case of a recording; none if the case succeeds or is not recorded."""
    reader, _, entries = _entries(path)
    found = rrd.chunks_of(reader, entries[case], f"/__properties/{PROPERTIES}") if case in entries else []
    batches = [chunk.to_record_batch() for chunk in found]
    return [line for batch in batches if VERDICT in batch.schema.names for line in batch[VERDICT][0].as_py()]


def recorded_cases(path: Path) -> list[int]:
    """Return the numbers of the cases in a recording. Raises InputError if it cannot be read, or was not written by
    crowdbench."""
    return sorted(_entries(path)[2])


def find_case(path: Path, case: str) -> int:
    """Return the number of a case, which is given by its name or its number. Raises InputError for another split."""
    recorded = _entries(path)[1]
    split, number = parse_case(case, recorded)
    if split != recorded:
        raise InputError(f"case {case} is not recorded in {path}, which has {recorded} cases")
    return number


def read_header(path: Path) -> tuple[dict[str, str], dict[int, str]]:
    """Read the facts about the run of a recording, without its states.

    Args:
        path: The recording.

    Returns:
        Split, planner, scenario and the scenario's digest; and by case the label of the outcome.

    Raises:
        InputError: It cannot be read, or was not written by crowdbench.
    """
    reader, split, entries = _entries(path)
    facts = contents.read_facts(path, reader, next(iter(entries.values())))
    return {"split": split, **facts}, {case: entry.recording_id.split("-")[2] for case, entry in entries.items()}


def _entries(path: Path) -> tuple[RrdReader, str, dict[int, StoreEntry]]:
    """Return the reader of a recording, its split, and the entry of each case."""
    return _read_entries(path, path.stat().st_mtime_ns if path.is_file() else 0)


@functools.lru_cache(maxsize=1)
def _read_entries(path: Path, changed: int) -> tuple[RrdReader, str, dict[int, StoreEntry]]:
    """Return `_entries` of a file; `changed` is the time of its last change, a key of the cache."""
    with rrd.opening(path):
        reader = RrdReader(path)
        named = [(NAME.fullmatch(entry.recording_id), entry) for entry in reader.recordings()]
    entries = {(match[1], int(match[2])): entry for match, entry in named if match}
    splits = {split for split, _ in entries}
    if len(splits) != 1 or len(entries) != len(named):
        raise rrd.foreign(path)
    (split,) = splits
    return reader, split, {case: entry for (_, case), entry in entries.items()}


def read_case(path: Path, case: int) -> contents.RecordedEpisode:
    """Return one case of a recording. Raises InputError if it cannot be read, or has no such case."""
    reader, split, entries = _entries(path)
    if case not in entries:
        near = sorted(sorted(entries, key=lambda other: abs(other - case))[:10])
        raise InputError(
            f"case {split}/{case} is not recorded in {path}: recorded near it are {_ranges(near)} "
            "(all are with --record all)"
        )
    return contents.read_episode(path, reader, entries[case])


def read_same_case(paths: Sequence[Path], case: int) -> list[contents.RecordedEpisode]:
    """Return one case of several recordings.

    Raises InputError as `read_case`, or if the starting states of the case differ.
    """
    episodes = [read_case(path, case) for path in paths]
    first, *others = (episode.trace for episode in episodes)
    for path, other in zip(paths[1:], others, strict=True):
        same_start = np.array_equal(other.position[:, 0], first.position[:, 0], equal_nan=True)
        if not same_start or (other.split, other.rules.dt) != (first.split, first.rules.dt):
            raise InputError(f"case {case} starts differently in {path} and {paths[0]}: give runs of one scenario")
    return episodes


def _ranges(numbers: Iterable[int]) -> str:
    """Return numbers as ranges, such as 0-9, 12, 17-18."""
    known = set(numbers)
    starts = sorted(n for n in known if n - 1 not in known)
    ends = sorted(n for n in known if n + 1 not in known)
    return ", ".join(f"{a}-{b}" if a < b else f"{a}" for a, b in zip(starts, ends, strict=True))
