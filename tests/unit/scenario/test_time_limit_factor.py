"""Time limits that are a multiple of each case's least time."""

import numpy as np
import pytest
from helpers import Still, drive, make, stored_trace

from crowdbench.catalog import load_scenario
from crowdbench.core.types import Outcome, Rules
from crowdbench.envs.parallel import parallel_env
from crowdbench.envs.vector import VehicleVectorEnv
from crowdbench.envs.vehicle import VehicleEnv
from crowdbench.metrics.registry import METRICS
from crowdbench.results.run_result import RunResult
from crowdbench.results.stored_tracks import read_tracks, write_tracks
from crowdbench.runs.score import replay_run
from crowdbench.scenario.cases import Cases


def test_a_case_times_out_after_a_multiple_of_its_least_time_without_an_early_second():
    episode = drive(Still(), "3", "circle_crossing_5", time_limit_factor=1.5)
    # The least time is 7.75 s, 31 steps: arrival in step 47 at 11.75 s would still count, and step 48 is too late.
    assert (METRICS["t_empty"](episode) == 7.75).all()
    assert (episode.outcome != Outcome.SUCCESS).all()
    late = episode.outcome == Outcome.TIMEOUT
    assert late.any()
    assert (episode.steps[late] == 48).all()
    assert (METRICS["navigation_time_or_limit"](episode) == 1.5 * 7.75).all()


def test_an_arrival_exactly_at_the_limit_is_a_success():
    free = {"pedestrians__number": 0, "time_limit_factor": 1.0}
    assert (drive("straight", "3", "circle_crossing_5", **free).outcome == Outcome.SUCCESS).all()
    late = drive("straight", "3", "circle_crossing_5", **(free | {"time_limit_factor": 0.9}))
    assert (late.outcome == Outcome.TIMEOUT).all()


def test_cases_of_a_batch_have_different_limits():
    trace = drive(Still(), "val:6", "office_8", time_limit_factor=0.5, time_limit=60.0)
    late = trace.outcome == Outcome.TIMEOUT
    expected = np.ceil(0.5 * METRICS["t_empty"](trace) / 0.25) + 1
    assert late.sum() > 2
    assert len(set(trace.steps[late])) > 1
    assert (trace.steps[late] == expected[late]).all()
    alone = drive(Still(), "val:4:5", "office_8", time_limit_factor=0.5, time_limit=60.0)
    assert np.array_equal(trace.episode(4).position, alone.episode(0).position)


def test_the_time_limit_bounds_every_case():
    short = drive(Still(), "2", "circle_crossing_5", time_limit_factor=4.0, time_limit=5.0)
    assert (short.steps <= Rules(time_limit=5.0).max_steps).all()
    assert (METRICS["navigation_time_or_limit"](short) == 5.0).all()


def test_scenarios_without_a_factor_stay_as_they_are():
    scenario = load_scenario("circle_crossing_5")
    assert "time_limit_factor" not in scenario.table
    assert "time_limit_factor" not in scenario.rules.to_table()
    assert (scenario.worlds(Cases("test", 0, 3)).max_steps == 97).all()
    other = load_scenario("circle_crossing_5", {"time_limit_factor": 4.0})
    assert other.table["time_limit_factor"] == 4.0
    assert other.digest != scenario.digest


def test_stored_runs_keep_their_limits(tmp_path):
    scenario = load_scenario("circle_crossing_5", {"time_limit_factor": 1.2})
    make(tmp_path / "run", "orca_margin", scenario, "6")
    run = RunResult.read(tmp_path / "run")
    run.check()
    assert not replay_run(run, scenario, METRICS).differences
    trace = stored_trace(tmp_path / "run")
    assert (trace.outcome == Outcome.TIMEOUT).any()
    write_tracks(trace, tmp_path / "tracks.parquet")
    again = read_tracks(tmp_path / "tracks.parquet")
    assert again.rules == trace.rules
    assert again.rules.time_limit_factor == 1.2
    for name in ("navigation_time_or_limit", "t_empty", "score"):
        assert np.array_equal(METRICS[name](again), METRICS[name](trace), equal_nan=True)


def test_environments_end_at_the_limit_of_each_case():
    scenario = load_scenario("office_8", {"time_limit_factor": 0.5, "time_limit": 60.0})
    env = VehicleEnv(scenario)
    for case in range(3):
        env.reset(options={"case": f"train/{case}"})
        limit = int(scenario.draw("train", np.array([case])).max_steps[0])
        ends = False
        while not ends:
            *_, terminated, truncated, _ = env.step(np.zeros(2))
            ends, limit = terminated or truncated, limit - 1
        assert limit == 0 if truncated else limit > 0


@pytest.mark.slow
def test_all_kinds_of_environments_have_the_limit():
    scenario = load_scenario("circle_crossing_5", {"time_limit_factor": 0.6})
    together, batch = parallel_env(scenario), VehicleVectorEnv(3, scenario=scenario)
    together.reset(options={"case": "val/2"})
    batch.reset(seed=1)
    for number in range(1, 21):  # 0.6 times 31 steps are 19 steps at most
        *_, truncated, _ = together.step({agent: np.zeros(2) for agent in together.agents})
        *_, ended, _ = batch.step(np.zeros((3, 2)))
        assert truncated["vehicle"] == ended.all() == ended.any() == (number == 20)
