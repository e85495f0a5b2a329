import io
import re
import sys
import time

import numpy as np
import pytest
from helpers import Still

from crowdbench.catalog import load_planner, load_scenario
from crowdbench.cli import train
from crowdbench.planners.driver import Driver
from crowdbench.runs.rollout import rollout
from crowdbench.scenario.cases import Cases
from crowdbench.utils import compiled
from crowdbench.utils import progress_bars as module
from crowdbench.utils.progress_bars import announce_compilation, progress


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.fixture
def clock(monkeypatch):
    """A clock that stands still: a test moves it on by `clock.now += seconds`."""

    class Clock:
        now = 100.0

        def monotonic(self):
            return self.now

    clock = Clock()
    monkeypatch.setattr(module, "time", clock)
    return clock


def work(clock, tell, seconds, amount, times=1):
    for _ in range(times):
        clock.now += seconds
        tell(amount)


def test_without_a_terminal_each_tenth_is_a_line(clock, capsys):
    with progress(100, "of 100 cases") as tell:
        work(clock, tell, 60.0, 1)
        work(clock, tell, 1.0, 2.5, times=38)
        work(clock, tell, 1.0, 4)
    assert capsys.readouterr().err.splitlines() == [
        "11 % of 100 cases, 36 s left",
        "21 % of 100 cases, 32 s left",
        "31 % of 100 cases, 28 s left",
        "41 % of 100 cases, 24 s left",
        "51 % of 100 cases, 20 s left",
        "61 % of 100 cases, 16 s left",
        "71 % of 100 cases, 12 s left",
        "81 % of 100 cases, 8 s left",
        "91 % of 100 cases, 4 s left",
        "100 % of 100 cases",
    ]


def test_work_that_ends_soon_prints_nothing_without_a_terminal(clock, capsys):
    with progress(3, "of 3 cases") as tell:
        work(clock, tell, 0.8, 1, times=3)
    assert capsys.readouterr().err == ""


def test_long_phases_without_a_percentage_are_named_once_and_long_silence_is_broken(monkeypatch, capsys):
    monkeypatch.setattr(module, "PERIOD", 0.01)
    monkeypatch.setattr(module, "SLOW", 0.05)
    with progress(100, "of 100 cases") as tell:
        time.sleep(0.2)
        tell(1)
        time.sleep(0.2)
        monkeypatch.setattr(module, "ALIVE", 0.01)
        time.sleep(0.2)
        monkeypatch.setattr(module, "ALIVE", 60.0)
        tell(99)
        time.sleep(0.2)
    said = capsys.readouterr().err.splitlines()
    assert [said[0], *dict.fromkeys(said[1:])] == ["loading", "1 % of 100 cases", "100 % of 100 cases", "finishing"]
    assert len(said) > 4
    time.sleep(0.05)
    assert capsys.readouterr().err == ""


def frames(terminal):
    """The texts that a terminal showed, without control codes and bars."""
    shown = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]|[━╸╺]", "", terminal.getvalue())
    return list(dict.fromkeys(line.strip() for line in re.split(r"[\r\n]+", shown) if line.strip()))


def open_terminal(monkeypatch):
    """Replace standard error by a terminal. A fixture could not, because pytest replaces it again."""
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setenv("TERM", "xterm")
    return terminal


@pytest.mark.parametrize("columns", [40, 80])
def test_a_bar_names_loading_compiling_cases_and_finishing(monkeypatch, columns):
    terminal = open_terminal(monkeypatch)
    monkeypatch.setenv("COLUMNS", str(columns))
    with progress(100, "of 100 cases") as tell:
        time.sleep(0.3)
        module._tell_compilation()
        time.sleep(0.3)
        tell(0)
        tell(30)
        time.sleep(0.3)
        tell(70)
        time.sleep(0.3)
    phases = ["loading", "compiling", "30 % of 100 cases", "finishing"]
    assert list(dict.fromkeys(re.sub(r" 0:00:\d\d$", "", frame) for frame in frames(terminal))) == phases


def test_no_time_left_is_estimated_from_a_moment_or_without_progress(clock, monkeypatch):
    open_terminal(monkeypatch)
    with progress(100, "of 100 cases") as tell:
        work(clock, tell, 60.0, 1)
        assert str(module._shown[-1]) == "1 % of 100 cases"
        work(clock, tell, 1.0, 3, times=3)
        assert str(module._shown[-1]) == "10 % of 100 cases, 30 s left"
    with progress(1.0, "trained") as tell:
        work(clock, tell, 5.0, 0.0, times=3)
        assert str(module._shown[-1]) == "0 % trained"


def test_a_dumb_terminal_gets_lines(clock, monkeypatch):
    terminal = open_terminal(monkeypatch)
    monkeypatch.setenv("TERM", "dumb")
    with progress(10) as tell:
        work(clock, tell, 10.0, 1, times=2)
    assert terminal.getvalue() == "10 % of 10 cases\n20 % of 10 cases, 80 s left\n"


def driven(planner):
    """The trace of 30 episodes, and what was told of them."""
    told = []
    trace = rollout(
        Driver(planner, "any"), load_scenario("circle_crossing_5"), Cases.parse("val:30"), progress=told.append
    )
    return trace, np.array(told)


@pytest.mark.parametrize("planner", [load_planner("orca"), Still()])
def test_parts_of_episodes_are_told_at_each_step_and_sum_to_the_episodes(planner):
    trace, told = driven(planner)
    assert len(told) == trace.steps.max()
    assert told.min() >= 0.0
    assert told.sum() == pytest.approx(30)


def test_compilation_is_announced_once_in_a_process(capsys):
    module._say_compilation.cache_clear()
    for _ in range(3):
        announce_compilation()
        module._tell_compilation()
    assert capsys.readouterr().err.count("compiling") == 1
    assert compiled._listeners.count(module._tell_compilation) == 1


def test_the_progress_of_a_training_is_followed_between_its_validations(monkeypatch):
    monkeypatch.setattr(train, "PERIOD", 0.01)
    done, told = [0.0], []
    with train._follow(lambda: done[0], told.append):
        for done[0] in (0.2, 0.5, 0.9):
            time.sleep(0.1)
        done[0] = 1.0
    assert {0.2, 0.5, 0.9, 1.0} <= {round(value, 9) for value in np.cumsum(told)}
