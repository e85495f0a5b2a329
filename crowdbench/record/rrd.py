"""Rerun's files: opened, joined, and their errors said in a sentence."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path

import rerun.blueprint as rrb
from rerun.chunk import Chunk, RrdReader, StoreEntry

from crowdbench.errors import InputError


@contextlib.contextmanager
def errors_as(sentence: str) -> Iterator[None]:
    """Turn every error of Rerun's, or of the file system, into an InputError with this sentence."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Rerun warns of a missing end that it then raises for
            yield
    except (RuntimeError, ValueError, OSError) as error:
        raise InputError(sentence) from error


def opening(path: Path) -> contextlib.AbstractContextManager[None]:
    """To be used around reading a file. Raises InputError where it is missing, damaged or not a Rerun file."""
    if not path.is_file():
        raise InputError(f"there is no recording at {path}: give the run.rrd of a run with --record all or failures")
    return errors_as(f"{path} is cut short, damaged or no Rerun file at all: give the run.rrd of a finished run")


def foreign(path: Path) -> InputError:
    """The error for a Rerun file that crowdbench did not write."""
    return InputError(f"{path} is a Rerun file but holds no episodes of crowdbench: give the run.rrd of a run")


def chunks_of(reader: RrdReader, entry: StoreEntry, content: str) -> list[Chunk]:
    """The chunks of one recording in a file.

    Args:
        reader: The file.
        entry: Which of its recordings.
        content: A filter of entity paths, such as `/exact/**`.

    Returns:
        The chunks.
    """
    return reader.store(store=entry).stream().filter(content=content).to_chunks()


def join(folder: Path, parts: Sequence[str], application: str, layout: rrb.Blueprint) -> Path:
    """Make one file of several recordings and the layout to open them in.

    Args:
        folder: Where the parts are; the file is written there too.
        parts: The names of the recordings' files.
        application: The name under which the viewer lists the file.
        layout: How the viewer shows them.

    Returns:
        The path of the file.

    Raises:
        OSError: The file could not be written in full.
    """
    layout.save(application, folder / "layout.rbl")
    # Routing leaves the messages as they are, which is faster than `rrd merge` and needs less memory.
    command = [sys.executable, "-m", "rerun_cli", "rrd", "route", "-o", "whole.rrd", "layout.rbl", *parts]
    # In a session of its own, because Ctrl-C on a terminal reaches every process of the group.
    subprocess.run(command, cwd=folder, capture_output=True, start_new_session=True)
    whole = folder / "whole.rrd"
    # On a full disk rerun leaves a stump and exits with 0.
    if len(RrdReader(whole).recordings()) < len(parts):
        raise OSError(f"{whole} is incomplete")
    return whole
