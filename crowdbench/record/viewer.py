"""Shows a recording in the Rerun viewer: in a window, in a browser, or as a picture.

`view` writes the file that is shown, one case or the same case of several recordings; `show` and `picture` start the
viewer as a process.
"""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import rerun.blueprint as rrb
from rerun.chunk import Chunk, LazyChunkStream
from rerun.experimental import ViewerClient

from crowdbench.core.types import Outcome
from crowdbench.record import rrd
from crowdbench.record.blueprint import blueprint, logged_curves, side_by_side
from crowdbench.record.cases import read_case, read_same_case, recorded_cases
from crowdbench.record.drawing import extent
from crowdbench.utils.errors import InputError

PATIENCE = 60.0
"""Seconds after which a viewer that has not drawn its picture is given up."""

SIZE = "2800x1600"
"""Size of a picture in pixels."""

ENLARGED = 10
"""How often text and lines are enlarged by a tenth in a picture, so that they can be read in a paper or a talk."""

_PAUSE = 0.2
"""Seconds between two looks at the viewer."""


class NoViewer(InputError):
    """The Rerun viewer does not start here."""


def view(
    paths: Sequence[Path],
    case: int | None = None,
    screenshot: Path | None = None,
    *,
    seconds: float | None = None,
    web: bool = False,
) -> None:
    """Open a recording, or the same case of several side by side, in the Rerun viewer and wait until it is closed.

    Args:
        paths: The recordings.
        case: Number of the only case to show.
        screenshot: Path of a .png file: write a picture of the case instead of opening a window.
        seconds: The time in the case that is shown; None to play it, or for the end of a picture.
        web: True to open it in a browser instead of a window.

    Raises:
        InputError: A file or the case does not exist, the case does not start alike in all recordings, or the arguments
            do not fit each other.
        NoViewer: The viewer does not start.
    """
    if screenshot is not None and (case is None or screenshot.suffix != ".png" or not screenshot.parent.is_dir()):
        raise InputError(f"a picture shows one case (--case 37) and goes to a .png file in a folder, not {screenshot}")
    if seconds is not None and (case is None or web):
        raise InputError("--time shows a moment of one case (--case 37), in a window or a picture, not with --web")
    if case is None and len(paths) > 1:
        raise InputError("several recordings are shown side by side in one case: give --case 37")
    with tempfile.TemporaryDirectory() as folder:
        file = paths[0].resolve()
        if case is None:
            recorded_cases(paths[0])
        else:
            write = _write_case if len(paths) == 1 else _write_beside
            file, end = write(paths, case, Path(folder), has_menu=screenshot is None)
            if seconds is not None and seconds > end:
                raise InputError(f"case {case} ends after {end:g} s: give --time {end:g} or less, not {seconds:g}")
        if screenshot is None:
            show(file, seconds, web=web)
        else:
            picture(file, screenshot, seconds)


def _write_case(paths: Sequence[Path], case: int, folder: Path, *, has_menu: bool) -> tuple[Path, float]:
    """Write a file of a case of one recording, with its own blueprint; a picture of it needs no menu.

    Returns:
        The file, and the end of the case in seconds.
    """
    entry, chunks, trace, _ = read_case(paths[0], case)
    layout = blueprint([extent(trace, 0)], logged_curves(chunks), float(trace.preferred_speed[0, 0]), has_menu=has_menu)
    end = trace.rules.dt * int(trace.steps[0])
    return _write(chunks, folder, entry.application_id, entry.recording_id, layout), end


def _write_beside(paths: Sequence[Path], case: int, folder: Path, *, has_menu: bool) -> tuple[Path, float]:
    """As `_write_case`, with the same case of several recordings. Raises InputError where it does not start alike."""
    episodes = read_same_case(paths, case)
    first = episodes[0].trace
    chunks = [
        chunk.with_entity_path(f"/{n}{chunk.entity_path}")
        for n, episode in enumerate(episodes)
        for chunk in episode.chunks
        if chunk.entity_path.startswith(("/world", "/plots"))
    ]
    names = [f"{episode.planner}: {Outcome(int(episode.trace.outcome[0])).label}" for episode in episodes]
    fastest = max(float(episode.trace.preferred_speed[0, 0]) for episode in episodes)
    longest = first.rules.dt * max(int(episode.trace.steps[0]) for episode in episodes)
    extents = [extent(episode.trace, 0) for episode in episodes]
    layout = side_by_side(names, extents, fastest, longest, has_menu=has_menu)
    title = f"case {case} of {len(paths)} planners"
    return _write(chunks, folder, title, f"{first.split}-{case:04d}", layout), longest


def _write(chunks: Sequence[Chunk], folder: Path, application: str, recording: str, layout: rrb.Blueprint) -> Path:
    """Write a file of one recording: its chunks, the names of file and recording in the viewer, and its layout."""
    with rrd.writing(f"a copy of the case in {folder}"):
        LazyChunkStream.from_iter(chunks).write_rrd(
            folder / "case.rrd", application_id=application, recording_id=recording
        )
        return rrd.join(folder, ["case.rrd"], application, layout)


def show(file: Path, seconds: float | None = None, *, web: bool = False) -> None:
    """Open a recording, and wait until the viewer is closed.

    Args:
        file: The recording.
        seconds: The time in the episode that a window shows; None to play it.
        web: True if it opens in a browser instead of a window.

    Raises:
        InputError: The viewer does not start.
    """
    if not web and sys.platform == "linux" and not {"DISPLAY", "WAYLAND_DISPLAY"} & set(os.environ):
        raise InputError("there is no display for a window: use --web, or --case 37 --screenshot case.png")
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
    return [sys.executable, "-m", "rerun_cli", "--bind", "127.0.0.1", "--port", port, *options, str(file)]


def _failed(file: Path) -> NoViewer:
    return NoViewer(
        f"the Rerun viewer failed on {file}: it needs a display or, for a picture, a Vulkan driver (Debian: "
        "mesa-vulkan-drivers)"
    )
