"""Shows a recording in the Rerun viewer, in a window or in a browser.

`view` writes the file that is shown, such as one case of a recording; `show` starts the viewer as a process.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from rerun.chunk import LazyChunkStream

from crowdbench.record import rrd
from crowdbench.record.blueprint import blueprint, logged_curves
from crowdbench.record.recorded_cases import EXTENT, SPEED, read_recorded, recorded_outcomes
from crowdbench.utils.errors import InputError, Interrupted


def view(path: Path, case: int | None = None, *, web: bool = False) -> None:
    """Open a recording in the Rerun viewer and wait until it is closed.

    Args:
        path: The recording.
        case: Number of the only case to show.
        web: True to open it in a browser instead of a window.

    Raises:
        InputError: The file or the case does not exist, or the viewer does not start.
    """
    with tempfile.TemporaryDirectory() as folder:
        file = path.resolve()
        if case is None:
            recorded_outcomes(path)  # raises an error for other files
        else:
            file = _write_case(path, case, Path(folder))
        show(file, web=web)


def _write_case(path: Path, case: int, folder: Path) -> Path:
    """Write one case of a recording to a file, with its blueprint."""
    episode = read_recorded(path, case)
    if episode is None:
        raise InputError(f"case {case} is not recorded in {path}")
    entry, chunks, properties = episode
    layout = blueprint([np.reshape(properties[EXTENT], (2, 2))], logged_curves(chunks), *properties[SPEED])
    with rrd.writing(f"a copy of the case in {folder}"):
        LazyChunkStream.from_iter(chunks).write_rrd(
            folder / "case.rrd", application_id=entry.application_id, recording_id=entry.recording_id
        )
        return rrd.join(folder, ["case.rrd"], entry.application_id, layout)


def show(file: Path, *, web: bool = False) -> None:
    """Open a recording, and wait until the viewer is closed.

    Args:
        file: The recording.
        web: True to open it in a browser instead of a window.

    Raises:
        InputError: The viewer does not start.
    """
    if not web and sys.platform == "linux" and not {"DISPLAY", "WAYLAND_DISPLAY"} & set(os.environ):
        raise InputError("there is no display for a window: use --web, or draw a case with `crowdbench render`")
    with contextlib.suppress(Interrupted):  # Ctrl-C closes the viewer
        if subprocess.run(_command(file, ["--web-viewer"] * web)).returncode == 0:
            return
        raise InputError(f"the Rerun viewer failed on {file}: it needs a display with a graphics driver, or --web")


def _command(file: Path, options: list[str]) -> list[str]:
    return [sys.executable, "-m", "rerun_cli", "--bind", "127.0.0.1", "--port", "auto", *options, str(file)]
