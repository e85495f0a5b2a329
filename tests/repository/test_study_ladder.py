"""Ladders: simulated futures, the command, and its figure."""

import dataclasses
import json

import numpy as np
import pytest
from typer.testing import CliRunner

from crowdbench.catalog import load_scenario
from crowdbench.cli.app import build_script
from crowdbench.planners.driver import Driver
from crowdbench.planners.planner import Planner
from crowdbench.runs.rollout import rollout
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.certified import Certified
from crowdbench.sim.sensor import observe
from crowdbench.utils.errors import InputError
from studies.ladder.futures import FUTURES, Knowledge, Simulated, adds_nothing, has_chance
from studies.ladder.plot import plot
from studies.ladder.run import ladder
from studies.ladder.table import find_certified, paired_gain

STEPS = 12


class Standing(Planner):
    """Stands where it is."""

    def plan(self, obs):
        return np.zeros((len(obs), 2))


def foreseen(name, knows, *, start=4, cases=3, command=(0.0, 0.0), **overrides):
    """What is predicted after some steps in which the vehicle stands, and the trace of what came true."""
    scenario = load_scenario(name, {"vehicle.preferred_speed": 1.0, **overrides})
    predictor, seen = Simulated(scenario, knows), []

    def look(world):
        seen.append(world)

    trace = rollout(Driver(Standing(), "standing"), scenario, Cases("test", 0, cases), undisturbed=False, watch=look)
    world = seen[start]
    predictor.foresee(world)
    plan = np.broadcast_to(command, (cases, STEPS, 2))
    return world, predictor.predict_given(observe(world), STEPS, plan).position, trace


def came_true(world, trace):
    """Where people really were in the steps after a moment; who was there all the time; and which episodes went on."""
    time = int(world.step[0]) + np.arange(STEPS + 1)
    row = np.flatnonzero(trace.steps >= time[-1])
    position, person = trace.position[row][:, time, 1:], trace.person[row][:, time]
    stays = (trace.present[row][:, time, 1:] & (person == person[:, :1])).all(axis=1)
    return row, position[:, 1:], stays


@pytest.mark.parametrize("name", ["mixed_20", "streets_16_blind", "circle_20", "groups_12"])
def test_the_true_future_comes_true(name):
    world, predicted, trace = foreseen(name, Knowledge.ALL)
    row, position, stays = came_true(world, trace)
    assert stays.any()
    everywhere = np.broadcast_to(stays[:, None], position.shape[:3])
    np.testing.assert_allclose(predicted[row, 0][everywhere], position[everywhere], atol=1e-12)


def test_futures_differ_by_what_is_chance_alone():
    predicted = foreseen("mixed_20", Knowledge.ATTENTION)[1]
    assert predicted.shape[1] == FUTURES
    assert (np.abs(predicted - predicted[:, :1]).max(axis=(2, 3, 4))[:, 1:] > 0.1).all()
    again = foreseen("mixed_20", Knowledge.ATTENTION, cases=2)[1]
    np.testing.assert_array_equal(again, predicted[:2])


def test_pedestrians_that_leave_are_replaced_in_the_true_future_only():
    everything_but_chance, future = (
        foreseen("streets_16_blind", knows) for knows in (Knowledge.ATTENTION, Knowledge.ALL)
    )
    assert everything_but_chance[1].shape[1] == future[1].shape[1] == 1
    assert not adds_nothing(load_scenario("streets_16_blind"), Knowledge.ALL)
    world, trace = future[0], future[2]
    row, position, stays = came_true(world, trace)
    soon = stays[:, None] & (np.arange(STEPS) < 1)[None, :, None]
    np.testing.assert_allclose(everything_but_chance[1][row, 0][soon], position[soon], atol=1e-12)


@pytest.mark.parametrize("name", ["circle_20_blind", "circle_20"])
def test_knowledge_of_chance_adds_nothing_where_there_is_none(name):
    assert adds_nothing(load_scenario(name), Knowledge.ALL)
    np.testing.assert_array_equal(foreseen(name, Knowledge.ATTENTION)[1], foreseen(name, Knowledge.ALL)[1])


def test_knowledge_of_policies_adds_nothing_where_all_walk_by_orca_and_ignore_the_vehicle():
    same, other = "circle_20_blind", "mixed_20"
    assert adds_nothing(load_scenario(same), Knowledge.POLICIES)
    np.testing.assert_array_equal(foreseen(same, Knowledge.GOALS)[1], foreseen(same, Knowledge.POLICIES)[1])
    assert not adds_nothing(load_scenario(other), Knowledge.POLICIES)
    assert not adds_nothing(load_scenario("circle_20"), Knowledge.POLICIES)
    assert not adds_nothing(load_scenario(same, {"pedestrians.orca.safety_space": 0.2}), Knowledge.POLICIES)
    goals, policies = (foreseen(other, knows)[1][:, 0] for knows in (Knowledge.GOALS, Knowledge.POLICIES))
    assert np.abs(goals - policies).max() > 0.1


def test_futures_without_knowledge_of_attention_differ_where_people_may_notice_the_vehicle():
    """The vehicle drives into the crowd, where some give way to it and some ignore it."""
    name = "circle_20"
    changes = {"pedestrians.attention.ignores": 0.5}
    scenario = load_scenario(name, changes)
    assert has_chance(scenario, Knowledge.POLICIES)
    assert not has_chance(scenario, Knowledge.ATTENTION)
    predicted = foreseen(name, Knowledge.POLICIES, start=8, command=(0.0, 1.0), **changes)[1]
    assert np.abs(predicted - predicted[:, :1]).max() > 0.1
    assert adds_nothing(load_scenario("circle_20_blind"), Knowledge.ATTENTION)


@pytest.mark.parametrize(("gained", "lost"), [(0.01, 0.01), (0.2, 0.1)])
def test_an_interval_of_a_gain_contains_the_true_gain_in_95_percent_of_studies(gained, lost):
    draws, covered = np.random.default_rng(7), []
    for _ in range(3000):
        kind = draws.random(200)
        only_above, only_below = kind < gained, kind > 1.0 - lost
        estimate = paired_gain(~only_below, ~only_above)
        covered.append(estimate.low <= gained - lost <= estimate.high)
    print(f"coverage {np.mean(covered):.3f}")
    assert np.mean(covered) > 0.94


@pytest.mark.slow
def test_a_ladder_is_kept_and_drawn(tmp_path):
    (tmp_path / "own.toml").write_text(
        'time_limit = 15.0\n[pedestrians]\nnumber = 3\npolicy = "stop_and_go"\n[sensor]\nrange = 2.0\n'
    )
    command = [str(tmp_path / "own.toml"), "--cases", "3", "--planner", "straight", "--planner", "orca"]
    command += ["--out", str(tmp_path / "runs")]
    result = CliRunner().invoke(build_script(ladder), command)
    assert result.exit_code == 0, result.output
    assert "points gained by this search, with" in result.stdout
    again = CliRunner().invoke(build_script(ladder), [*command, "--format", "json"])
    assert "run 1" not in again.output  # all are kept
    (found,) = json.loads(again.stdout)
    assert list(found["success"]) == ["P0", "P1", "I", "G", "GP", "P2", "P3"]  # nobody looked for certificates
    assert [step["knowledge"] for step in found["steps"]] == [
        "perception",
        "inference",
        "goals",
        "policies",
        "attention",
        "chance",
    ]
    assert [step["gain"] is None for step in found["steps"]] == [False, False, False, False, True, False]
    file, figure = tmp_path / "runs" / "own.json", tmp_path / "ladder.svg"
    assert json.loads(file.read_text()) == found
    assert CliRunner().invoke(build_script(plot), [str(file), "--out", str(figure)]).exit_code == 0
    assert "best planner" in figure.read_text()
    file.write_text("{}")
    result = CliRunner().invoke(build_script(plot), [str(file), "--out", str(figure)])
    assert "is not what `python studies/ladder/run.py` writes" in str(result.exception)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["own.toml", "other/own.toml"], "scenarios is own, own, but must be scenarios of different names"),
        (["own.toml", "--cases", "many"], "'many' are not a range of cases"),
    ],
)
def test_what_is_no_ladder_is_refused(arguments, sentence, tmp_path):
    for place in (tmp_path / "own.toml", tmp_path / "other/own.toml"):
        place.parent.mkdir(exist_ok=True)
        place.write_text('[layout]\ngenerator = "circle_crossing"\n[pedestrians]\nnumber = 2\n')
    given = [str(tmp_path / each) if each.endswith(".toml") else each for each in arguments]
    with pytest.raises(InputError, match=sentence):
        build_script(ladder)(given, standalone_mode=False)


def test_certificates_are_of_the_cases_that_were_examined():
    scenario = load_scenario("office_8")

    def found(digest, number):
        examined = {"scenario": digest, "margin": 0.1, "test": {"examined": 9, "uncertified": [2]}}
        status = dataclasses.replace(scenario.certificates, certified=Certified.model_validate(examined))
        return find_certified(dataclasses.replace(scenario, certificates=status), Cases("test", 0, number))

    assert np.flatnonzero(~found(scenario.digest, 9)).tolist() == [2]
    assert found(scenario.digest, 10) is None
    assert found("another", 9) is None
