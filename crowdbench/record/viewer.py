"""Shows a recording in the Rerun viewer, in a window or in a browser.

`view` writes the file that is shown, such as one case of a recording; `show` starts the viewer as a process.
"""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import quote

import numpy as np
from rerun.chunk import LazyChunkStream

from crowdbench.record import rrd
from crowdbench.record.blueprint import blueprint, logged_curves
from crowdbench.record.recorded_cases import EXTENT, SPEED, read_recorded, recorded_outcomes
from crowdbench.utils.errors import InputError, Interrupted
from crowdbench.utils.terminal import say

PORT, WEB_PORT = 9876, 9090
"""Rerun's usual ports: of its server, and of the page in a browser."""


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
    port, options = _free_port(PORT), []
    if web:
        page = _free_port(WEB_PORT)
        options = ["--web-viewer", "--web-viewer-port", str(page)]
        source = quote(f"rerun+http://127.0.0.1:{port}/proxy", safe="")
        say(f"The viewer runs until Ctrl-C: http://127.0.0.1:{page}?url={source}")
    with contextlib.suppress(Interrupted):  # Ctrl-C closes the viewer
        # Its log is not for users, and errors are printed as one sentence.
        environment = {"RUST_LOG": "warn", **os.environ, "NO_COLOR": "1"}
        done = subprocess.run(_command(file, port, options), stderr=subprocess.PIPE, env=environment)
        if done.returncode:
            lines = done.stderr.decode(errors="replace").strip().splitlines() or [f"status {done.returncode}"]
            reason = next((line for line in lines if line.startswith("Error: ")), lines[-1]).rpartition(": ")[2]
            advice = "" if web else ": it needs a display with a graphics driver, or --web"
            raise InputError(f"the Rerun viewer failed on {file} ({reason}){advice}")


def _free_port(usual: int) -> int:
    """Return a free port of this machine, the usual one if possible."""
    for port in (usual, 0):
        with socket.socket() as free, contextlib.suppress(OSError):
            free.bind(("127.0.0.1", port))
            return int(free.getsockname()[1])
    raise InputError("there is no free port for the Rerun viewer")


def _command(file: Path, port: int, options: Sequence[str]) -> list[str]:
    return [*rrd.RERUN, "--bind", "127.0.0.1", "--port", str(port), *options, str(file)]
