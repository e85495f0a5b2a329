"""Rerun's files and their chunks: reading, joining, and error messages of one sentence."""

from __future__ import annotations

import contextlib
import errno
import os
import subprocess
import sys
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Int
from rerun.chunk import Chunk, RrdReader

from crowdbench.utils.errors import InputError, NotWritten

ERRORS = (RuntimeError, ValueError, OSError)
"""Exceptions of Rerun and the file system."""

PROGRAM = """
import os, subprocess, sys
from rerun_cli.__main__ import main
if os.name == "posix":
    subprocess.call = lambda command: os.execv(command[0], command)
sys.exit(main())
"""
RERUN = [sys.executable, "-c", PROGRAM]
"""The command of Rerun's program. `python -m rerun_cli` would exit with 0 after an error, and a signal would end it
without the program."""

CONTENT_ERRORS = (LookupError, TypeError, AttributeError, ArithmeticError)
"""Further exceptions for a Rerun file with other contents than crowdbench writes."""


@contextlib.contextmanager
def writing(what: str, advice: str = "") -> Iterator[None]:
    """Open a context for writing a recording. Raises NotWritten with the reason if writing fails.

    Args:
        what: The written object.
        advice: A remedy, at the end of the sentence.
    """
    try:
        yield
    except ERRORS as error:
        reason = error.strerror if isinstance(error, OSError) else None
        if isinstance(error, UnicodeEncodeError):
            reason = "its path is not UTF-8, which Rerun needs"
        raise NotWritten(f"{what} could not be written: {reason or error}{advice}") from error


@contextlib.contextmanager
def reading(path: Path) -> Iterator[None]:
    """Open a context for reading a file. Raises InputError if it is missing, damaged or not a Rerun file."""
    if not path.is_file():
        raise InputError(f"there is no recording at {path}: give the directory of a run, or its run.rrd")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Rerun warns of a missing end before it raises an error for it
            yield
    except (*ERRORS, *CONTENT_ERRORS) as error:
        sentence = f"{path} is cut short, damaged or no Rerun file at all: give the run.rrd of a finished run"
        raise InputError(sentence) from error


def moments(steps: Int[np.ndarray, "time"], dt: float) -> list[rr.TimeColumn]:
    """Return the timeline of states in seconds since the start. A second timeline of their numbers would make files
    larger.

    Args:
        steps: Numbers of the states.
        dt: Length of a step in seconds.
    """
    return [rr.TimeColumn("time", duration=steps * dt)]


width = rr.Radius.ui_points
"""The widths of lines, or the radii of points, in points of the screen, independent of the zoom."""


def still(entity: str, *archetypes: rr.AsComponents) -> Chunk:
    """Return a static chunk with the components of an entity, the same at all times."""
    batches = [batch for archetype in archetypes for batch in archetype.as_component_batches()]
    return Chunk.from_columns(entity, [], [batch.partition([len(batch.as_arrow_array())]) for batch in batches])


def moving(
    entity: str, timeline: Sequence[rr.TimeColumn], counts: Sequence[int] | np.ndarray, *columns: rr.ComponentColumnList
) -> Chunk:
    """Return a chunk with the components of an entity at each time.

    Args:
        entity: Its path.
        timeline: The times.
        counts: Number of values of each column at each time.
        *columns: Its components.
    """
    return Chunk.from_columns(entity, timeline, [part for column in columns for part in column.partition(counts)])


def join(folder: Path, parts: Sequence[str], application: str, blueprint: rrb.Blueprint) -> Path:
    """Make one file of several recordings and a blueprint.

    Args:
        folder: The folder of the parts, and of the new file.
        parts: The names of the recordings' files.
        application: The name under which the viewer lists the file.
        blueprint: The layout of the viewer.

    Returns:
        The path of the file.

    Raises:
        OSError: The file could not be written in full.
    """
    switch = os.environ.pop("RERUN", None)  # RERUN=off is for programs with optional output: this one is requested
    blueprint.save(application, folder / "layout.rbl")
    if switch is not None:
        os.environ["RERUN"] = switch
    # `rrd route` copies the messages as they are: it is faster than `rrd merge` and needs less memory.
    command = [*RERUN, "rrd", "route", "-o", "whole.rrd", "layout.rbl", *parts]
    # In a new session, because Ctrl-C in a terminal interrupts all processes of the session's group.
    process = subprocess.run(command, cwd=folder, capture_output=True, start_new_session=True)
    whole = folder / "whole.rrd"
    if process.returncode:
        messages = process.stderr.decode(errors="replace").strip().splitlines() or ["no message"]
        raise OSError(f"rerun rrd route ended with status {process.returncode}: {messages[-1]}")
    # On a full disk, rerun writes part of the file and exits with 0.
    if not _holds(whole, len(parts)):
        raise OSError(
            errno.ENOSPC, "only a part was written, as on a full disk or under a limit of the size of files (ulimit -f)"
        )
    return whole


def _holds(path: Path, recordings: int) -> bool:
    """Return True if a file can be read and has the given number of recordings."""
    with contextlib.suppress(*ERRORS), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return len(RrdReader(path).recordings()) == recordings
    return False
