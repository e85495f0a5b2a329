"""The Rerun viewer as a process: in a window, in a browser, or without either for a picture."""

from __future__ import annotations

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

from crowdbench.utils.errors import InputError

PATIENCE = 60.0
"""Seconds after which a viewer that has not drawn its picture is given up."""

SIZE = "2800x1600"
"""Size of a picture in pixels."""

ENLARGED = 10
"""How often text and lines are enlarged by a tenth in a picture, so that they can be read in a paper or a talk."""

_PAUSE = 0.2
"""Seconds between two looks at the viewer."""


def show(file: Path, seconds: float | None = None, *, web: bool = False) -> None:
    """Open a recording, and wait until the viewer is closed.

    Args:
        file: The recording.
        seconds: The time in the episode that a window shows first; its end if None.
        web: Whether it opens in a browser instead of a window.

    Raises:
        InputError: The viewer does not start.
    """
    if not web and sys.platform == "linux" and not {"DISPLAY", "WAYLAND_DISPLAY"} & set(os.environ):
        raise InputError(
            "there is no display for a window: open it in a browser with --web, or take a picture with --case 37 "
            "--screenshot case.png"
        )
    if seconds is None or web:
        if subprocess.run(_command("auto", ["--web-viewer"] * web, file)).returncode:
            raise _failed(file)
        return
    with _connected([], file, time.monotonic() + PATIENCE) as (viewer, client):
        client.set_time("time", duration=seconds, play_state="paused")
        viewer.wait()


def picture(file: Path, screenshot: Path, seconds: float | None = None) -> None:
    """Take a picture of a recording as the viewer shows it, once nothing in it changes any more.

    Args:
        file: The recording, of one episode.
        screenshot: The picture, a .png file.
        seconds: The time in the episode that it shows; its end if None.

    Raises:
        InputError: The viewer does not start, or does not draw the picture.
    """
    end = time.monotonic() + PATIENCE
    partial = screenshot.resolve().with_name(f".{screenshot.name}")
    try:
        with _connected(["--headless", "--window-size", SIZE], file, end) as (_, client):
            for _ in range(ENLARGED):
                client.run_command("ui.zoom_in_ui")
            if seconds is not None:
                client.set_time("time", duration=seconds, play_state="paused")
            before, now = None, b""
            while now != before:
                if time.monotonic() > end:
                    raise InputError(f"the Rerun viewer still draws after {PATIENCE:g} s: give it a quieter machine")
                time.sleep(_PAUSE)
                client.save_screenshot(str(partial))
                before, now = now, partial.read_bytes()
        partial.replace(screenshot)
    except (RuntimeError, ConnectionError, FileNotFoundError) as error:
        raise _failed(file) from error
    finally:
        partial.unlink(missing_ok=True)


@contextlib.contextmanager
def _connected(options: list[str], file: Path, end: float) -> Iterator[tuple[subprocess.Popen[bytes], ViewerClient]]:
    """A viewer that has read a recording, and a connection to it. It is closed with the `with` statement.

    Args:
        options: Options of the viewer.
        file: The recording.
        end: When to give up, in seconds of the monotonic clock.

    Raises:
        InputError: The viewer does not start.
    """
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    # Without logs, because the viewer would show them across the picture; in a group of its own, because the command is
    # a script that starts the viewer.
    environment = {**os.environ, "RUST_LOG": "off"}
    with subprocess.Popen(
        _command(str(port), options, file),
        env=environment,
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
                        yield viewer, client
                        return
                time.sleep(_PAUSE)
            raise _failed(file)
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(viewer.pid, signal.SIGTERM)


def _command(port: str, options: list[str], file: Path) -> list[str]:
    return [sys.executable, "-m", "rerun_cli", "--port", port, *options, str(file)]


def _failed(file: Path) -> InputError:
    return InputError(
        f"the Rerun viewer failed on {file}: it needs a display or, for a picture, a Vulkan driver (Debian: "
        "mesa-vulkan-drivers)"
    )
