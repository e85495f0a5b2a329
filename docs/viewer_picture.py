"""Takes a picture of a recording in the Rerun viewer, without a display. It needs a Vulkan driver."""

import contextlib
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from rerun.experimental import ViewerClient

PATIENCE = 60.0
"""Time limit in seconds for the viewer to draw its picture."""

PAUSE = 0.2
"""Seconds between two queries to the viewer."""

ENLARGED = 10
"""Number of times that text and lines are enlarged by a tenth; the picture is shown at half its size."""


class NoViewer(Exception):
    """Raised if the Rerun viewer does not start."""


def take_picture(recording: Path, seconds: float, out: Path) -> None:
    """Write a picture of 2800 x 1600 pixels, once it no longer changes.

    Args:
        recording: The recording, of one episode.
        seconds: The time in the episode.
        out: The picture, a .png file.

    Raises:
        NoViewer: The viewer does not start, or does not draw the picture.
    """
    end = time.monotonic() + PATIENCE
    try:
        with connected(recording, end) as client:
            for _ in range(ENLARGED):
                client.run_command("ui.zoom_in_ui")
            client.set_time("time", duration=seconds, play_state="paused")
            before, now = None, b""
            while now != before and time.monotonic() < end:
                time.sleep(PAUSE)
                client.save_screenshot(str(out))
                before, now = now, out.read_bytes()
    except (RuntimeError, ConnectionError, FileNotFoundError) as error:
        raise NoViewer(f"the Rerun viewer failed: {error}") from error


@contextlib.contextmanager
def connected(recording: Path, end: float) -> Iterator[ViewerClient]:
    """Start a viewer that reads a recording, and yield a connection; it must start before `end` (monotonic clock)."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    options = ["--bind", "127.0.0.1", "--port", str(port), "--headless", "--window-size", "2800x1600", str(recording)]
    with subprocess.Popen(
        [sys.executable, "-m", "rerun_cli", *options],
        env={**os.environ, "RUST_LOG": "off"},  # logs would cover the picture
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    ) as viewer:
        try:
            while viewer.poll() is None and time.monotonic() < end:
                with contextlib.suppress(RuntimeError, ConnectionError):
                    client = ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
                    state = client.get_state()
                    if state.active_recording and state.views and not state.loading:
                        yield client
                        return
                time.sleep(PAUSE)
            raise NoViewer("the Rerun viewer does not start: it needs a Vulkan driver (Debian: mesa-vulkan-drivers)")
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(viewer.pid, signal.SIGTERM)
