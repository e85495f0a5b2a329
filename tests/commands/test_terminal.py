"""What commands print on a terminal: whole words at every width, colours, and a bar that moves."""

import contextlib
import fcntl
import io
import os
import pty
import re
import signal
import struct
import subprocess
import sys
import termios

import pytest

from crowdbench import run
from crowdbench.cli import app as cli
from crowdbench.cli.console import BAD, GOOD, print_table, say
from crowdbench.utils.tables import Grid

GREEN, RED = "\x1b[32m", "\x1b[31m"


def without_codes(text):
    return re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", text)


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.fixture
def on_terminal(monkeypatch):
    """Call a function while a stream is a terminal of a width, and return what it prints."""

    def call(columns, do, stream="stdout", **variables):
        terminal = Terminal()
        with monkeypatch.context() as patch:
            patch.setattr(sys, stream, terminal)
            patch.delenv("NO_COLOR", raising=False)
            for name, value in {"COLUMNS": str(columns), "TERM": "xterm", **variables}.items():
                patch.setenv(name, value)
            patch.setattr(cli, "prepare_streams", lambda: None)
            patch.setattr(cli.interrupts, "handle", lambda: None)
            patch.setattr(cli.watchdog, "enable", lambda: None)
            do()
        return terminal.getvalue()

    return call


def command(monkeypatch, *arguments, status=0):
    def do():
        monkeypatch.setattr(sys, "argv", ["crowdbench", *arguments])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        assert (ended.value.code or 0) == status

    return do


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs")
    for planner in ("orca", "orca_margin"):
        run(planner, "circle_crossing_5", "val:12", out=folder / planner)
    return [str(folder / "orca"), str(folder / "orca_margin")]


COMMANDS = {
    "list": ["list"],
    "planners": ["list", "planners"],
    "metrics": ["list", "metrics"],
    "options": ["list", "planners", "sarl_sgan_kce"],
    "compare": ["compare"],
    "table": ["table"],
    "all metrics": ["table", "--all-metrics"],
    "one metric": ["table", "--columns", "scenario"],
}


@pytest.mark.parametrize("name", COMMANDS)
def test_no_word_is_broken_at_any_width(monkeypatch, on_terminal, runs, name):
    arguments = [*COMMANDS[name], *(runs if COMMANDS[name][0] != "list" else [])]

    def words(text):
        return set(without_codes(text).replace(":", "").split())

    whole = words(on_terminal(1000, command(monkeypatch, *arguments)))
    for columns in (40, 60, 80, 100, 200):
        printed = on_terminal(columns, command(monkeypatch, *arguments))
        assert words(printed) <= whole
        too_long = [line for line in without_codes(printed).splitlines() if len(line) > columns]
        assert [line for line in too_long if " " in line.strip()] == []


def test_a_sentence_breaks_at_spaces_and_a_command_at_its_end_does_not(on_terminal):
    text = "33 collisions (cases 0, 2, 3): crowdbench view runs/orca-circle_crossing_5 --case 0"
    printed = on_terminal(40, lambda: say(text), "stderr")
    assert printed == "33 collisions (cases 0, 2, 3):\n  crowdbench view runs/orca-circle_crossing_5 --case 0\n"
    assert on_terminal(100, lambda: say(text), "stderr") == f"{text}\n"
    assert on_terminal(20, lambda: say("  words of an indented line"), "stderr") == "  words of an\n    indented line\n"


def print_verdicts():
    colors = {"passed": GOOD, "failed": BAD}
    grid = Grid("", ("", "check"), [("passed", "one"), ("failed", "two")], align="ll")
    print_table(grid, lambda row, cell: colors.get(cell, ""))


def test_verdicts_are_green_and_red_where_the_terminal_can(on_terminal, capsys):
    shown = on_terminal(80, print_verdicts)
    assert f"{GREEN}passed" in shown
    assert f"{RED}failed" in shown
    assert not re.search(r"\x1b\[3\dm", on_terminal(80, print_verdicts, NO_COLOR="1"))
    assert "\x1b" not in on_terminal(80, print_verdicts, TERM="dumb")
    print_verdicts()
    assert "\x1b" not in capsys.readouterr().out


def test_errors_are_red_and_failures_of_a_case_too(monkeypatch, on_terminal, runs, capsys):
    arguments = ["list", "planners", "nothing"]
    assert on_terminal(80, command(monkeypatch, *arguments, status=1), "stderr").startswith(f"{RED}crowdbench: ")
    changed = on_terminal(80, command(monkeypatch, "compare", *runs, "--metric", "sct"))
    lines = [line for line in changed.splitlines() if re.search("orca \\w+, orca_margin", line)]
    assert lines
    for line in lines:
        before, after = re.match(r".*?orca (\w+), orca_margin (\w+)", line).groups()
        color = GREEN if after == "success" else RED if before == "success" else ""
        assert line.startswith(f"{color}orca")


SLOW = """
import time
import numpy as np
from crowdbench import Planner

class Slow(Planner):
    def plan(self, obs):
        time.sleep(0.02)
        return np.zeros((len(obs), 2))

def planner():
    return Slow()
"""


@pytest.mark.slow
@pytest.mark.parametrize("interrupted", [False, True])
def test_a_run_on_a_real_terminal_shows_a_bar_to_its_end_and_leaves_the_cursor(tmp_path, interrupted):
    (tmp_path / "slow.py").write_text(SLOW)
    terminal, end = pty.openpty()
    fcntl.ioctl(end, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 40, 0, 0))
    variables = {name: value for name, value in os.environ.items() if name not in ("COLUMNS", "NO_COLOR")}
    process = subprocess.Popen(
        [sys.executable, "-m", "crowdbench", "run", "--planner", "./slow.py", "--cases", "val:4"],
        cwd=tmp_path,
        stdin=end,
        stdout=subprocess.PIPE,
        stderr=end,
        env={**variables, "TERM": "xterm"},
    )
    os.close(end)
    shown, status, is_interrupted = b"", 0, interrupted
    with contextlib.suppress(OSError):  # the other end is closed
        while part := os.read(terminal, 65536):
            shown += part
            if interrupted and re.search(rb"[1-9]\d* % of 4 cases", shown):
                process.send_signal(signal.SIGINT)
                interrupted = False
                status = 130
    os.close(terminal)
    out = process.communicate()[0].decode()
    text = without_codes(shown.decode())
    assert process.returncode == status
    assert "loading" in text
    assert len(set(re.findall(r"(\d+) % of 4 cases", text))) > (0 if status else 3)
    assert status == (130 if is_interrupted else 0)
    assert shown.rindex(b"\x1b[?25h") > shown.rindex(b"\x1b[?25l")
    if status:
        assert " ".join(text.split()).endswith("crowdbench: interrupted: nothing was kept")
    else:
        assert "\x1b" not in out
        assert "success" in out
