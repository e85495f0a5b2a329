"""Scenes: recordings of one location, read from a folder. Their files must have the expected digests."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from crowdbench.scenario.schema import TracksSpec
from crowdbench.scenario.tracks.dut import CARS, PEDESTRIANS, RATIO, Car, read_clip
from crowdbench.scenario.tracks.eth_ucy import SCENES
from crowdbench.scenario.tracks.formats import DEFAULT, FORMATS
from crowdbench.scenario.tracks.recorded_tracks import RecordedTracks
from crowdbench.utils import files
from crowdbench.utils.errors import InputError, did_you_mean

DUT_SCENES = {"dut": "", "intersection": "intersection", "roundabout": "roundabout"}
"""Prefixes of the file names of clips of DUT, by scene: each of its two locations, and both as one scene."""


@dataclass(frozen=True)
class SceneRecording:
    """One recording of a location: the tracks of its pedestrians, and its cars."""

    tracks: RecordedTracks
    cars: Sequence[Car] = ()


def load_scene(tracks: TracksSpec, folder: Path | None) -> tuple[list[SceneRecording], dict[str, str]]:
    """Read the recordings of a scene, and check the digests of their files.

    Args:
        tracks: The table `[tracks]`. Its scene is one of ETH/UCY (`eth`, `hotel`, `univ`, `zara1`, `zara2`) or of DUT
            (`intersection`, `roundabout`, or `dut` for both), whose digests are built in, or a user's recording.
        folder: Folder with the files; None if the user has given none.

    Returns:
        recordings: The recordings of the scene.
        digests: The sha256 of each of their files, by name.

    Raises:
        InputError: There is no folder, or a file is missing, has another digest, or has another format.
    """
    name, form = tracks.scene, tracks.format or DEFAULT
    if folder is None:
        raise InputError(f"the scene {name} consists of recorded tracks: give the folder that holds them, --data DIR")
    if not folder.is_dir():
        raise InputError(f"there is no folder {folder} with the recorded tracks of the scene {name}")
    if form not in FORMATS:
        raise InputError(f"format is {form!r}, but must be one of {', '.join(FORMATS)}{did_you_mean(form, FORMATS)}")
    known = known_files(name) if form == DEFAULT else {}
    own = [file.format(name) for file in FORMATS[form].files]
    digests = {file: _digest(folder / file, name) for file in known or own}
    for file, digest in digests.items():
        wanted = tracks.files.get(file, known.get(file, digest))
        if digest != wanted:
            raise InputError(
                f"{folder / file} is damaged or another version: its sha256 is {digest[:16]}..., but that of the scene "
                f"{name} must be {wanted[:16]}..."
            )
    if known and name in DUT_SCENES:
        if tracks.scale is not None or tracks.frame_rate is not None:
            raise InputError(f"scale and frame_rate must be left out for the scene {name}, whose files state them")
        clips = [file.removesuffix(CARS) for file in known if file.endswith(CARS)]
        return [SceneRecording(*read_clip(folder, clip)) for clip in clips], digests
    read = FORMATS[form].read
    parts = [[file] for file in known] if known else [own]
    paths = [[folder / file for file in part] for part in parts]
    return [SceneRecording(read(part, tracks.scale, tracks.frame_rate)) for part in paths], digests


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
        fits = [form for form, it in FORMATS.items() if (path.parent / it.files[0].format(scene)).is_file()]
        hint = f"; its files are of tracks.format {' or '.join(fits)}" if fits else ""
        raise InputError(f"{path.parent} has no file {path.name}, which the scene {scene} needs{hint}") from None
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror or error}") from None
