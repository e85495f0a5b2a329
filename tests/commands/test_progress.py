import io
import sys
import time

import numpy as np
import pytest
from helpers import Still

from crowdbench.catalog import load_planner, load_scenario
from crowdbench.planners.driver import Driver
from crowdbench.runs.rollout import rollout
from crowdbench.scenario.cases import Cases
from crowdbench.utils import progress_bars as module
from crowdbench.utils.progress_bars import progress


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


def test_the_time_left_does_not_count_what_comes_before_the_first_report(clock, capsys):
    with progress(100, "of 100 cases") as tell:
        work(clock, tell, 60.0, 1)
        work(clock, tell, 1.0, 2.5, times=10)
    assert capsys.readouterr().err.splitlines() == [
        "1 % of 100 cases",
        "8 % of 100 cases, about 37 s left",
        "16 % of 100 cases, about 34 s left",
        "23 % of 100 cases, about 31 s left",
    ]


def test_no_time_left_is_estimated_from_a_moment_or_without_progress(clock, capsys):
    with progress(100, "of 100 cases") as tell:
        work(clock, tell, 2.4, 1)
        work(clock, tell, 0.1, 1)
    with progress(1.0, "trained") as tell:
        work(clock, tell, 5.0, 0.0, times=3)
    assert capsys.readouterr().err.splitlines() == ["2 % of 100 cases", *3 * ["0 % trained"]]


def test_work_that_is_done_at_once_shows_nothing(clock, capsys):
    with progress(3, "of 3 cases") as tell:
        work(clock, tell, 0.8, 1, times=3)
    assert capsys.readouterr().err == ""


def test_a_line_comes_also_while_nothing_is_reported(monkeypatch, capsys):
    monkeypatch.setattr(module, "PLAIN_INTERVAL", 0.01)
    with progress(100, "of 100 cases"):
        time.sleep(0.2)
    said = capsys.readouterr().err
    assert said.splitlines()[:2] == 2 * ["0 % of 100 cases"]
    time.sleep(0.05)
    assert capsys.readouterr().err == ""


def test_a_terminal_shows_the_same_estimate(clock, monkeypatch):
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setenv("TERM", "xterm")
    with progress(100, "of 100 cases") as tell:
        work(clock, tell, 60.0, 1)
        work(clock, tell, 1.0, 3, times=3)
    assert "10 % of 100 cases, about 30 s left" in terminal.getvalue()


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
