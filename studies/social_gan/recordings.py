"""The recordings of a folder, and the scenes of ETH/UCY among them."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from crowdbench import InputError
from crowdbench.scenario import SCENES, RecordedTracks, read_tracks

TRAINING_ONLY = ("crowds_zara03", "uni_examples")
"""Files of ETH/UCY that belong to no test scene."""


def read_folder(folder: Path) -> list[RecordedTracks]:
    """Return the recordings in `*.txt` of a folder. Raises InputError if there are none, or one is wrong."""
    if not folder.is_dir():
        raise InputError(f"there is no folder {folder} with recorded tracks")
    tracks = [read_tracks(path) for path in sorted(folder.glob("*.txt"))]
    if not tracks:
        raise InputError(f"{folder} has no files *.txt with recorded tracks")
    return tracks


def scenes(recordings: Iterable[RecordedTracks]) -> dict[str, list[RecordedTracks]]:
    """Return the scenes to test on, by name: scenes of ETH/UCY with all of their files, and every other recording."""
    left = {tracks.name: tracks for tracks in recordings if tracks.name not in TRAINING_ONLY}
    whole = {scene: [left.pop(name) for name in names] for scene, names in SCENES.items() if left.keys() >= set(names)}
    return whole | {name: [tracks] for name, tracks in left.items()}
