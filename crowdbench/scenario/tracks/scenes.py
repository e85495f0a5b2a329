"""Scenes: recordings of one location, read from a folder. Their files must have the expected digests."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from crowdbench.scenario.tracks.dut import CARS, PEDESTRIANS, RATIO, Car, read_clip
from crowdbench.scenario.tracks.eth_ucy import SCENES, RecordedTracks, read_tracks
from crowdbench.utils import files
from crowdbench.utils.errors import InputError

DUT_SCENES = {"dut": "", "intersection": "intersection", "roundabout": "roundabout"}
"""Prefixes of the file names of clips of DUT, by scene: each of its two locations, and both as one scene."""


@dataclass(frozen=True)
class SceneRecording:
    """One recording of a location: the tracks of its pedestrians, and its cars."""

    tracks: RecordedTracks
    cars: Sequence[Car] = ()


def load_scene(
    name: str, folder: Path | None, pinned: Mapping[str, str]
) -> tuple[list[SceneRecording], dict[str, str]]:
    """Read the recordings of a scene, and check the digests of their files.

    Args:
        name: A scene of ETH/UCY (`eth`, `hotel`, `univ`, `zara1`, `zara2`) or of DUT (`intersection`, `roundabout`, or
            `dut` for both), or the name of a user's file `<name>.txt` in the format of ETH/UCY.
        folder: Folder with the files; None if the user has given none.
        pinned: The sha256 that files must have, by name. The digests of ETH/UCY and DUT are built in.

    Returns:
        recordings: The recordings of the scene.
        digests: The sha256 of each of their files, by name.

    Raises:
        InputError: There is no folder, or a file is missing, has another digest, or has another format.
    """
    if folder is None:
        raise InputError(f"the scene {name} consists of recorded tracks: give the folder that holds them, --data DIR")
    if not folder.is_dir():
        raise InputError(f"there is no folder {folder} with the recorded tracks of the scene {name}")
    known = known_files(name)
    digests = {file: _digest(folder / file, name) for file in known or [f"{name}.txt"]}
    for file, digest in digests.items():
        wanted = pinned.get(file, known.get(file, digest))
        if digest != wanted:
            raise InputError(
                f"{folder / file} is damaged or another version: its sha256 is {digest[:16]}..., but that of the scene "
                f"{name} must be {wanted[:16]}..."
            )
    if name in DUT_SCENES:
        clips = [file.removesuffix(CARS) for file in known if file.endswith(CARS)]
        return [SceneRecording(*read_clip(folder, clip)) for clip in clips], digests
    return [SceneRecording(read_tracks(folder / file)) for file in digests], digests


def known_files(scene: str) -> dict[str, str]:
    """Return the sha256 of the files of a scene of ETH/UCY or DUT, by name; an empty table for other scenes."""
    lists = [(Path(__file__).parent / f"{name}.sha256").read_text(encoding="utf-8") for name in ("eth_ucy", "dut")]
    known = {file: digest for digest, file in map(str.split, "".join(lists).splitlines())}
    names = [f"{file}.txt" for file in SCENES.get(scene, ())]
    if scene in DUT_SCENES:
        clips = sorted(file.removesuffix(PEDESTRIANS) for file in known if file.endswith(PEDESTRIANS))
        clips = [clip for clip in clips if clip.startswith(DUT_SCENES[scene])]
        names = [f"{clip}{end}" for clip in clips for end in (PEDESTRIANS, CARS, RATIO)]
    return {name: known[name] for name in names}


def _digest(path: Path, scene: str) -> str:
    try:
        return files.sha256(path)
    except FileNotFoundError:
        raise InputError(f"{path.parent} has no file {path.name}, which the scene {scene} needs") from None
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror or error}") from None
