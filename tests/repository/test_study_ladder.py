"""Ladders: simulated futures, the command, and its figure."""

import dataclasses
import json

import numpy as np
import pytest
from typer.testing import CliRunner

from crowdbench.catalog import load_scenario, read_suite
from crowdbench.cli.app import build_script
from crowdbench.core.types import PERFECT_SENSOR
from crowdbench.planners.driver import Driver
from crowdbench.planners.planner import Planner
from crowdbench.runs.rollout import rollout
from crowdbench.scenario.cases import Cases
from crowdbench.sim.sensor import observe
from crowdbench.utils.errors import InputError
from crowdbench.utils.toml import Location, parse_table
from studies.ladder.futures import FUTURES, Knowledge, Simulated, adds_nothing, has_chance
from studies.ladder.plot import plot
from studies.ladder.run import FILE, ladder
from studies.ladder.table import SENSED, FilledLadder, Ladder, LaddersSpec, LadderStudy, gain
from studies.pages import read_file

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


@pytest.mark.slow
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


def test_a_gain_is_paired_by_case():
    below = np.array([0.1, 0.9, 0.3, 0.7, 0.2, 0.6, 0.4, 0.5])
    found = gain(below + 0.05, below)
    assert [found.mean, found.low, found.high] == pytest.approx([0.05] * 3)
    assert gain(below, below).mean == 0.0
    other = gain(below[::-1], below)
    assert other.low < -0.2
    assert other.high > 0.2


def ladder_of(cases, monkeypatch):
    """Return the ladder of a scenario without its runs: rung P3 has a score of 0.5 in each case."""
    monkeypatch.setattr("studies.ladder.table.read_scores", lambda run, out: np.full(len(run.spec.cases), 0.5))
    spec = parse_table(LaddersSpec, {"title": "x", "planners": ["straight"], "cases": cases}, Location("x"))
    return Ladder.of("circle_20", spec)


@pytest.mark.parametrize(("number", "said"), [(8, "0.800"), (9, "0.800 (8 cases)")])
def test_best_known_scores_are_compared_in_the_cases_that_have_one(number, said, monkeypatch, tmp_path):
    of_suite = ladder_of(f"val:{number}", monkeypatch)
    found = FilledLadder.of(dataclasses.replace(of_suite, known=dict.fromkeys(range(8), 0.8)), tmp_path)
    assert (found.score["best known"].n, found.score["P3"].n) == (8, number)
    assert found.steps[-1].knowledge == "search"
    assert found.steps[-1].gain.mean == pytest.approx(0.3)
    assert found.cells()[-3:] == ["+0.30 (+0.30 to +0.30)", said, "0.500 (straight)"]


def test_scenarios_and_test_cases_without_best_known_scores_have_a_dash(monkeypatch, tmp_path):
    for each in (dataclasses.replace(ladder_of("val:2", monkeypatch), known={}), ladder_of("test:2", monkeypatch)):
        found = FilledLadder.of(each, tmp_path)
        assert list(found.score) == ["P0", "P1", "I", "G", "GP", "P2", "P3"]
        assert found.cells()[-3:] == ["-", "-", "0.500 (straight)"]


def test_the_first_rung_and_planners_drive_with_realistic_sensing_and_the_others_see_all(monkeypatch):
    found = ladder_of("val:2", monkeypatch)
    sensors = {name: run.scenario.rules.sensor for name, run in found.rungs.items()}
    assert sensors["P0"] == found.planners[0].scenario.rules.sensor == load_scenario("circle_20", SENSED).rules.sensor
    assert sensors["P0"].detector is not None
    assert all(sensors[name] == PERFECT_SENSOR for name in sensors if name != "P0")


def test_ladders_are_those_of_the_ranked_scenarios_unless_some_are_named():
    (page,) = read_file(FILE, LadderStudy).ladders
    spec = parse_table(LaddersSpec, {"title": "x", "planners": ["straight"]}, Location("x"))
    assert spec.scenarios == read_suite().ranked
    assert set(page.scenarios) <= set(spec.scenarios)


@pytest.mark.nightly
def test_a_ladder_is_kept_and_drawn(tmp_path):
    (tmp_path / "own.toml").write_text(
        'time_limit = 15.0\n[pedestrians]\nnumber = 3\npolicy = "stop_and_go"\n[sensor]\nrange = 2.0\n'
    )
    command = [str(tmp_path / "own.toml"), "--cases", "3", "--planner", "straight", "--planner", "orca"]
    command += ["--out", str(tmp_path / "runs")]
    result = CliRunner().invoke(build_script(ladder), command)
    assert result.exit_code == 0, result.output
    assert "gained by this search, with" in result.stdout
    again = CliRunner().invoke(build_script(ladder), [*command, "--format", "json"])
    assert "run 1" not in again.output  # all are kept
    (found,) = json.loads(again.stdout)
    assert list(found["score"]) == ["P0", "P1", "I", "G", "GP", "P2", "P3"]  # nobody searched the best scores
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
