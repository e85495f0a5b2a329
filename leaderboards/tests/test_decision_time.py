"""The time of a decision in one world alone."""

import numpy as np
import pytest

from crowdbench import Cases, Planner, load_scenario
from crowdbench.results import StoredCommands
from crowdbench.runs import EVERY_STEP
from crowdbench_leaderboards.decision_time import time_single_world


class Clock:
    now = 0.0

    def perf_counter(self):
        return self.now


class Slower(Planner):
    """Stands still; its decisions take 1, 2, 3, ... ms by the given clock."""

    def __init__(self, clock):
        self.clock, self.calls = clock, 0

    def plan(self, obs):
        assert len(obs) == 1
        self.calls += 1
        self.clock.now += 1e-3 * self.calls
        return np.zeros((1, 2))


def test_decisions_are_timed_in_one_world_alone_after_a_case_to_warm_up(monkeypatch):
    clock = Clock()
    monkeypatch.setattr("crowdbench_leaderboards.decision_time.time", clock)
    scenario = load_scenario("circle_crossing_5", {"time_limit": 3.0})
    steps = scenario.rules.max_steps
    stands = StoredCommands(np.arange(3), np.full(3, steps), np.zeros((3 * steps, 2)))
    planner = Slower(clock)
    found = time_single_world(planner, "slower", scenario, EVERY_STEP, Cases("val", 0, 3), stands, lambda: 0.0)
    assert found.seconds == pytest.approx(1e-3 * np.arange(steps + 1, 3 * steps + 1))
    assert found.is_same.all()
