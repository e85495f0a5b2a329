"""The measurements run and count correctly. No test checks how fast anything is."""

import functools
import hashlib
import itertools
import json
import re

import numpy as np
import pytest
import torch
from safetensors.torch import save_file
from typer.testing import CliRunner

from crowdbench.bench import commands, decisions, measurement, simulator, speed_ups
from crowdbench.bench.measurement import Measurement
from crowdbench.bench.speed_ups import Variant, VariantComparison
from crowdbench.bench.suite import SUITE
from crowdbench.catalog import load_scenario
from crowdbench.cli import app
from crowdbench.cli.bench import bench_table, variants_table
from crowdbench.cli.tables import print_table
from crowdbench.networks.value import SARL
from crowdbench.planners.base import Planner
from crowdbench.planners.driver import Driver
from crowdbench.runs.decision_time import decide_alone
from crowdbench.runs.rollout import rollout
from crowdbench.runs.spec import EVERY_STEP
from crowdbench.scenario.cases import Cases
from crowdbench.train import ppo_worlds
from crowdbench.train import value as method
from crowdbench.train.driving_requests import PPORequest
from crowdbench.utils.errors import InputError

pytestmark = pytest.mark.slow

torch.set_num_threads(1)  # for so little work threads cost more than they save, much more where cores are busy

SARL_PER_PEDESTRIAN = 13 * 150 + 150 * 100 + 100 * 100 + 100 * 100 + 100 * 100 + 100
"""Multiply-adds of the embedding, the features' first layer, and the attention on the embedding."""

SARL_PER_STATE = 100 * 100 + 100 * 50 + 56 * 150 + 150 * 100 + 100 * 100 + 100
"""Multiply-adds of the attention on the crowd's mean, the features' last layer, and the value."""


STAND_IN = """
import torch
from crowdbench.predict.social_gan import SocialGAN
from crowdbench.networks.social_gan import Generator

def predictor(modes):
    torch.manual_seed(0)
    return SocialGAN(Generator(), {"dt": 0.25, "scenes": []}, modes)
"""


@pytest.fixture
def few_futures(tmp_path):
    """Options of SARL-SGAN-KCE: few futures, of random weights."""
    (tmp_path / "stand_in.py").write_text(STAND_IN)
    return {"predictor": str(tmp_path / "stand_in.py"), "modes": 3}


class Course(Planner):
    """Drives with one velocity, whatever comes."""

    def __init__(self, vx, vy=0.0):
        self.velocity = vx, vy

    def plan(self, obs):
        return np.full((len(obs), 2), self.velocity)


def test_a_planner_in_its_own_process_is_compared_with_one_that_is_not():
    here, apart, more = decisions.measure_isolation(worlds=2, rounds=1)
    assert here.unit == apart.unit == "ms"
    assert more.value == pytest.approx(100 * (apart.value / here.value - 1))


def take_seconds(monkeypatch, *seconds):
    """Let works take these seconds, one after the other, without doing them."""
    times = iter(seconds)
    monkeypatch.setattr(decisions, "seconds", lambda work: next(times))


@pytest.fixture
def short_training(monkeypatch):
    monkeypatch.setattr(method, "DEMONSTRATIONS", 4)
    monkeypatch.setattr(method, "ROUND", 2)
    monkeypatch.setattr(method, "BATCH", 128)


@pytest.mark.slow
def test_every_measurement_of_the_simulator_gives_a_time(monkeypatch):
    monkeypatch.setattr(simulator, "ROUNDS", 1)
    measured = [*simulator.measure_steps(), *simulator.measure_environments()]
    assert len(measured) == 6
    assert all(one.value > 0 and one.unit == "us" for one in measured)


@pytest.mark.slow
def test_environments_of_many_worlds_are_compared(monkeypatch):
    monkeypatch.setattr(simulator, "VEC_ENV_ROUNDS", 1)
    measured = list(simulator.measure_vec_env(worlds=3, steps=4))
    assert len(measured) == 2
    assert all(one.value > 0 and one.unit == "us" for one in measured)


def test_decisions_stand_beside_what_was_recorded_of_crowdnav():
    measured = list(decisions.measure_sarl(worlds=3, rounds=1, decisions=2))
    assert [one.crowdnav for one in measured] == [37.0, 67.0, 37.0, 67.0]
    assert all(one.value > 0 and one.unit == "ms" for one in measured)


def test_a_batch_is_counted_per_world(monkeypatch):
    monkeypatch.setattr(decisions, "seconds", lambda work: 1.5)
    measured = decisions.measure_sarl(worlds=3, rounds=1, decisions=2)
    assert [one.value for one in measured] == [500.0, 500.0, 1500.0, 1500.0]


def test_operations_are_counted_where_threads_share_them():
    threads = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        assert decisions.operations(decisions.sarl_decision(5, 60)) > 60 * 81 * 5 * SARL_PER_PEDESTRIAN
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(threads)


@pytest.mark.parametrize("pedestrians", [5, 10])
def test_the_operations_of_a_decision_are_those_of_its_layers(pedestrians):
    states = 256  # 3 * 81, filled up to a multiple of 16
    by_hand = 2 * states * (pedestrians * SARL_PER_PEDESTRIAN + SARL_PER_STATE)
    assert decisions.operations(decisions.sarl_decision(pedestrians, 3)) == by_hand


def test_the_share_of_the_limit_is_of_operations_per_second(monkeypatch):
    take_seconds(monkeypatch, 0.0, 0.0, 1e-6, 4e-3)
    limit, share = decisions.measure_share_of_limit(worlds=1, size=10, rounds=1)
    assert (limit.unit, share.unit) == ("GFLOP/s", "%")
    assert limit.value == pytest.approx(2 * 10**3 / 1e-6 / 1e9)
    reached = 2 * 88 * (5 * SARL_PER_PEDESTRIAN + SARL_PER_STATE) / 4e-3 / 1e9
    assert share.value == pytest.approx(100 * reached / limit.value)


def test_a_training_of_a_policy_and_cases_of_large_crowds_are_measured(monkeypatch):
    sizes = {"worlds": 4, "steps": 8, "segments": 4}
    monkeypatch.setattr(decisions, "PPORequest", functools.partial(PPORequest, ppo=sizes))
    monkeypatch.setattr(ppo_worlds, "CASES", 8)
    monkeypatch.setattr(decisions, "PAPER", ("sarl_lin",))
    [trained], [driven] = decisions.measure_ppo_training(steps=50), decisions.measure_large_crowds(cases=1)
    assert trained.unit == "steps/s"
    assert driven.unit == "s"
    assert trained.value > 0 < driven.value


@pytest.mark.usefixtures("short_training")
def test_a_training_is_estimated_from_parts_that_ran():
    [measured] = decisions.measure_training(episodes=60)
    assert measured.unit == "min"
    assert measured.value > 0
    assert "estimated from imitation and 3 of 30 rounds" in measured.work


def test_a_training_lasts_its_imitation_and_all_its_rounds(monkeypatch):
    take_seconds(monkeypatch, 30.0, 1.0, 2.0, 6.0)
    [measured] = decisions.measure_training(episodes=6000)
    assert measured.value == (30.0 + 60 * 3.0) / 60


def test_the_measured_rounds_explore_as_much_as_all_on_average(monkeypatch):
    explored = []
    monkeypatch.setattr(method.Training, "imitate", lambda running: 0.0)
    monkeypatch.setattr(method.Training, "improve", lambda running: explored.append(running.exploration))
    list(decisions.measure_training(episodes=60_000))
    first, last, part = method.EXPLORATION
    assert np.mean(explored) == pytest.approx(part * (first + last) / 2 + (1 - part) * last, abs=0.01)


def test_a_command_is_timed_with_its_memory():
    seconds, memory = commands.command("--help")
    assert 0.0 < seconds < 60.0
    assert 1e7 < memory < 1e11


@pytest.mark.slow
def test_a_run_of_sarl_is_timed_with_its_memory(monkeypatch, tmp_path):
    monkeypatch.setattr(commands, "REPETITIONS", 1)
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    weights = tmp_path / "stand-in.safetensors"
    save_file(SARL().state_dict(), weights)
    card = {"network": "sarl", "sha256": hashlib.sha256(weights.read_bytes()).hexdigest()}
    weights.with_suffix(".json").write_text(json.dumps(card))
    time, memory = commands.measure_sarl_runs(1, f"weights={weights}")
    assert (time.unit, memory.unit) == ("s", "MB")
    assert time.value > 0.0
    assert 10.0 < memory.value < 1e5


def test_the_memory_of_a_command_is_not_that_of_whoever_measures_it():
    ballast = np.ones(60_000_000)
    assert commands.command("--help")[1] < ballast.nbytes


@pytest.mark.slow
def test_a_run_of_sarl_sgan_kce_is_timed_with_its_memory(monkeypatch, few_futures):
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    options = [f"{key}={value}" for key, value in few_futures.items()]
    time, memory = commands.measure_sarl_sgan_kce_run(1, *options)
    assert (time.unit, memory.unit) == ("s", "MB")
    assert time.value > 0.0
    assert 10.0 < memory.value < 1e5


@pytest.mark.slow
def test_decisions_under_futures_are_timed(few_futures):
    measured = [
        *decisions.measure_sarl_sgan_kce(worlds=2, rounds=1, decisions=2, **few_futures),
        *decisions.measure_sarl_sgan_seq(worlds=2, rounds=1, **few_futures),
    ]
    assert all(one.value > 0 and one.unit == "ms" for one in measured)


def test_the_variants_are_what_their_names_say(few_futures):
    planners = speed_ups.variants(**few_futures)
    obs = decisions.observation(5, 3)
    reference, separate, half, *short = planners.values()
    assert [planner.shortlist for planner in (reference, separate, half, *short)] == [None] * 3 + [16, 8, 4]
    at_once, one_by_one = (planner.predictor.predict(obs, 2).position for planner in (reference, separate))
    np.testing.assert_allclose(one_by_one, at_once, atol=1e-6)
    joint, present = torch.rand(4, 5, 13), torch.ones(4, 5, dtype=torch.bool)
    with torch.inference_mode():
        exact, coarse = (planner.value(joint, present) for planner in (reference, half))
    assert coarse.dtype == torch.float32
    assert not torch.equal(exact, coarse)
    torch.testing.assert_close(exact, coarse, atol=0.05, rtol=0.0)


def test_variants_are_compared_on_the_decisions_of_the_first():
    wanted = {"stands": Course(0.0), "stands too": Course(0.0), "flees": Course(0.0, -1.0)}
    ended = []
    measured = speed_ups.compare(wanted, Cases("val", 0, 3), ended.append)
    stands, too, flees = measured.variants
    assert [variant.name for variant in measured.variants] == list(wanted)
    assert [variant.changed_commands for variant in (stands, too, flees)] == [0, 0, measured.decisions]
    assert (stands.changed_outcomes, too.changed_outcomes) == (0, 0)
    assert all(variant.seconds > 0.0 for variant in measured.variants)
    assert sum(ended) == pytest.approx(9)


def test_outcomes_that_differ_are_counted():
    wanted = {"north": Course(0.0, 1.0), "south": Course(0.0, -1.0)}
    cases = Cases("val", 0, 4)
    apart = speed_ups.compare(wanted, cases).variants[1].changed_outcomes
    one, other = (
        rollout(Driver(planner, "course"), load_scenario("circle_crossing_5"), cases).outcome
        for planner in wanted.values()
    )
    assert apart == (one != other).sum() > 0


def test_a_command_that_fails_is_no_measurement(tmp_path):
    with pytest.raises(InputError, match=r"run --planner nobody.*no planner is called 'nobody'"):
        commands.command("run", "--planner", "nobody", "--out", str(tmp_path / "run"))


def test_every_measurement_is_taken():
    names = [measure.__name__.removeprefix("measure_") for measure in SUITE]
    of_simulator = ["steps", "sight", "thousands", "environments", "vec_env"]
    of_trainings = ["training", "ppo_training"]
    of_decisions = [
        "isolation",
        "sarl",
        "share_of_limit",
        *of_trainings,
        "large_crowds",
        "sarl_sgan_kce",
        "sarl_sgan_seq",
    ]
    of_commands = ["start_up", "orca_runs", "first_run", "sarl_runs", "sarl_sgan_kce_run"]
    assert names == of_simulator + of_decisions + of_commands


def test_works_that_are_compared_take_turns():
    order = []
    times = itertools.count()

    def work(name):
        order.append(name)
        return float(next(times))

    ours, theirs = measurement.in_turns(3, lambda: work("ours"), lambda: work("theirs"))
    assert order == ["ours", "theirs"] * 4
    assert (ours, theirs) == (4.0, 5.0)


def test_all_measured_agents_are_at_work_in_every_step():
    for agents in (6, 51):
        start = simulator.circle(agents, 1)
        apart = np.linalg.norm(start[0, :, None] - start[0], axis=-1) + np.eye(agents) * 9
        assert apart.min() > 2 * simulator.RADIUS
        assert 2 * np.linalg.norm(start, axis=-1).min() > simulator.STEPS * simulator.DT


def test_the_table_says_how_many_times_faster_than_crowdnav(capsys):
    measured = [Measurement("alone", 1.0, "s"), Measurement("deciding", 2.0, "ms", 37.0)]
    print_table(bench_table(measured))
    _, _, alone, deciding = capsys.readouterr().out.splitlines()
    assert alone.split() == ["alone", "1", "s"]
    assert deciding.split() == ["deciding", "2", "ms", "37", "ms", "18.5x"]


def test_the_table_of_variants_says_what_each_saves_and_changes(capsys):
    measured = VariantComparison((Variant("slow", 6.0, 0, 0), Variant("quick", 1.5, 7, 1)), 2000, 50)
    print_table(variants_table("Variants", measured))
    _, _, slow, quick = capsys.readouterr().out.splitlines()
    assert slow.split() == ["slow", "6", "s", "1.0x", "0", "of", "50", "0", "of", "2,000"]
    assert quick.split() == ["quick", "1.5", "s", "4.0x", "1", "of", "50", "7", "of", "2,000"]


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
    monkeypatch.setattr("crowdbench.runs.decision_time.time", clock)
    scenario = load_scenario("circle_crossing_5", {"time_limit": 3.0})
    told = []
    arguments = Slower(clock), "slower", scenario, EVERY_STEP, Cases("val", 0, 3), None, told.append
    steps = scenario.rules.max_steps
    assert decide_alone(*arguments).seconds == pytest.approx(1e-3 * np.arange(steps + 1, 3 * steps + 1))
    assert told == [1, 1]


def test_the_command_prints_median_and_late_decisions_of_a_planner(monkeypatch):
    monkeypatch.setattr("crowdbench.cli.bench.CASES", "val:2")
    done = CliRunner().invoke(app, ["bench", "--planner", "straight", "--set", "time_limit=3.0"])
    assert done.exit_code == 0, done.output
    pattern = r"straight on circle_crossing_5: 9 decisions in one world alone take [\d.e-]+ ms \(median\), [\d.e-]+ ms"
    assert re.search(pattern, done.output), done.output
    both = CliRunner().invoke(app, ["bench", "--planner", "straight", "--lookahead"])
    assert isinstance(both.exception, InputError)
    assert "give one of them" in str(both.exception)
    nobody = CliRunner().invoke(app, ["bench", "--scenario", "doorway_8"])
    assert "need --planner" in str(nobody.exception)
