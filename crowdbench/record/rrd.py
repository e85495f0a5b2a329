"""Rerun's files: opening, joining, and one sentence for each error."""

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
    """Turn errors of Rerun and of the file system into an InputError with the given sentence."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Rerun warns of a missing end before it raises an error for it
            yield
    except (RuntimeError, ValueError, OSError) as error:
        raise InputError(sentence) from error


def opening(path: Path) -> contextlib.AbstractContextManager[None]:
    """A context for reading a file. Raises InputError where it is missing, damaged or not a Rerun file."""
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


def join(folder: Path, parts: Sequence[str], application: str, blueprint: rrb.Blueprint) -> Path:
    """Make one file of several recordings and a blueprint.

    Args:
        folder: Where the parts are; the file is written there too.
        parts: The names of the recordings' files.
        application: The name under which the viewer lists the file.
        blueprint: How the viewer shows them.

    Returns:
        The path of the file.

    Raises:
        OSError: The file could not be written in full.
    """
    blueprint.save(application, folder / "layout.rbl")
    # `rrd route` copies the messages as they are: it is faster than `rrd merge` and needs less memory.
    command = [sys.executable, "-m", "rerun_cli", "rrd", "route", "-o", "whole.rrd", "layout.rbl", *parts]
    # In a session of its own, because Ctrl-C in a terminal interrupts all processes of the session's group.
    subprocess.run(command, cwd=folder, capture_output=True, start_new_session=True)
    whole = folder / "whole.rrd"
    # On a full disk, rerun writes part of the file and exits with 0.
    if len(RrdReader(whole).recordings()) < len(parts):
        raise OSError(f"{whole} is incomplete")
    return whole
