"""Random examples for tests: edits of files, and the answer of a command to them.

`CROWDBENCH_FUZZ=500 pytest -n 0 tests/commands/test_fuzz.py tests/commands/test_fuzz_inputs.py` tries 500 random
examples of each kind, else there are a few, which are always the same. `CROWDBENCH_FUZZ_LOG` is a file that receives
each example before it is tried.
"""

import contextlib
import io
import os
import re
import sys
import time
from unittest import mock

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

from crowdbench.cli import app as cli

FUZZ = int(os.environ.get("CROWDBENCH_FUZZ", "0"))
LONGEST = 10.0
"""Seconds of processor time that an answer may take."""

fuzz = settings(
    max_examples=FUZZ or 5,
    derandomize=not FUZZ,
    deadline=None,
    database=None,
    suppress_health_check=list(HealthCheck),
)

TOKENS = [
    *("", "0", "-1", "1", "2", "1e309", "-1e308", "1e-320", "nan", "inf", "9" * 30, "4611686018427387904", "0.25"),
    *("true", "null", "[]", "{}", "[[]]", '""', '"x"', "[0.0, 0.0]", "[" * 300, "é", "\0", "\ud7ff", "../x"),
    *("/dev/zero", ",", "\n", "orca", '"recorded"', "straight", "{ a = 1 }", "[x]", "a = 1", "=", ".", '"', "-"),
    *("test:0:1000000000000", "1_0"),
]
VALUES = st.recursive(
    st.sampled_from(
        [None, True, 0, -1, 3, 10**9, 2**63, 10**30, 1e300, -0.5, 1e-320, "", "x", "test:0:9", "é\0", "all"]
    ),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(["x", "", "low", "n"]), inner, max_size=2)
    ),
    max_leaves=4,
)
EDITS = st.lists(st.tuples(st.floats(0, 0.999), st.sampled_from(TOKENS) | st.text(max_size=3)), min_size=1, max_size=3)
FIELDS = st.lists(st.tuples(st.floats(0, 0.999), st.none() | VALUES, st.booleans()), min_size=1, max_size=3)
BYTES = st.lists(st.tuples(st.floats(0, 0.999), st.binary(max_size=8)), min_size=1, max_size=3)


def edit_text(text, edits):
    """Put other words into a text."""
    for where, word in edits:
        spans = [match.span() for match in re.finditer(r"[\w.+-]+|[^\s\w]", text)] or [(0, 0)]
        start, stop = spans[int(where * len(spans))]
        text = text[:start] + word + text[stop:]
    return text


def edit_bytes(content, edits):
    for where, other in edits:
        at = int(where * len(content))
        content = content[:at] + other + content[at + len(other) + (not other) :]
    return content


def edit_json(table, edits):
    """Put other values into tables within tables, or remove some."""
    for where, value, is_removed in edits:
        places = list(places_in(table))
        inside, key = places[int(where * len(places))]
        if is_removed:
            del inside[key]
        else:
            inside[key] = value
        if not table:
            break
    return table


def places_in(table):
    for key in list(table) if isinstance(table, dict) else range(len(table)):
        yield table, key
        if isinstance(table[key], dict | list):
            yield from places_in(table[key])


def log(example):
    """Write an example to a file, if there is one, so that it is known if it ends this process."""
    if path := os.environ.get("CROWDBENCH_FUZZ_LOG"):
        with open(path, "a") as file:
            file.write(f"{example!r}\n")


def answer(*arguments):
    """Run a command in this process: its exit status. Fail where it needs a report, or takes long."""

    def run(*given):
        with (
            mock.patch.object(sys, "argv", ["crowdbench", *map(str, given)]),
            mock.patch.object(cli.interrupts, "handle"),
            mock.patch.object(cli.watchdog, "enable"),
            contextlib.redirect_stdout(io.StringIO()) as out,
            contextlib.redirect_stderr(out),
            pytest.raises(SystemExit) as stop,
        ):
            cli.main()
        return stop.value.code or 0, out.getvalue()

    log(arguments)
    start = time.process_time()
    status, said = run(*arguments)
    took = time.process_time() - start
    if status == 3:
        run("--debug", *arguments)  # raises what it was
    assert status in (0, 1, 2), said
    assert took < LONGEST, arguments
    return status
