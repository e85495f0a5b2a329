"""Ladders: simulated futures, the command, and its figure."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from crowdbench.catalog import load_scenario
from crowdbench.cli import build_script
from crowdbench.planners.base import Planner
from crowdbench.planners.driver import Driver
from crowdbench.runs.rollout import rollout
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.certified import Certified
from crowdbench.sim.sensor import observe
from crowdbench.utils.errors import InputError
from studies.ladder.futures import AWAY, Simulated
from studies.ladder.plot import plot
from studies.ladder.run import ladder
from studies.ladder.table import find_certified

STEPS = 12


class Standing(Planner):
    """Stands where it is."""

    def plan(self, obs):
        return np.zeros((len(obs), 2))


def foreseen(name, futures, *, start=4, cases=3, **overrides):
    """What is predicted after some steps in which the vehicle stands, and the trace of what came true."""
    scenario = load_scenario(name, {"vehicle.preferred_speed": 1.0, **overrides})
    predictor, seen = Simulated(scenario, futures), []

    def look(world):
        seen.append(world)

    trace = rollout(Driver(Standing(), "standing"), scenario, Cases("test", 0, cases), undisturbed=False, watch=look)
    world = seen[start]
    predictor.foresee(world)
    return world, predictor.predict(observe(world), STEPS).position, trace


def came_true(world, trace):
    """Where people really were in the steps after a moment; who was there all the time; and which episodes went on."""
    time = int(world.step[0]) + np.arange(STEPS + 1)
    row = np.flatnonzero(trace.steps >= time[-1])
    position, person = trace.position[row][:, time, 1:], trace.person[row][:, time]
    stays = (trace.present[row][:, time, 1:] & (person == person[:, :1])).all(axis=1)
    return row, position[:, 1:], stays


@pytest.mark.parametrize("name", ["restless_20", "intersection_16", "circle_crossing_20_seen", "groups_12"])
def test_the_true_future_comes_true(name):
    world, predicted, trace = foreseen(name, None)
    row, position, stays = came_true(world, trace)
    assert stays.any()
    everywhere = np.broadcast_to(stays[:, None], position.shape[:3])
    np.testing.assert_allclose(predicted[row, 0][everywhere], position[everywhere], atol=1e-12)


def test_futures_differ_by_what_is_chance_alone():
    predicted = foreseen("restless_20", 4)[1]
    assert (np.abs(predicted - predicted[:, :1]).max(axis=(2, 3, 4))[:, 1:] > 0.1).all()
    for name in ("circle_crossing_20", "circle_crossing_20_seen"):  # who sees the vehicle stays the same
        _, predicted, _ = foreseen(name, 4)
        np.testing.assert_array_equal(predicted, np.repeat(predicted[:, :1], 4, axis=1))
    again = foreseen("restless_20", 4, cases=2)[1]
    np.testing.assert_array_equal(again, foreseen("restless_20", 4)[1][:2])


def test_who_leaves_is_far_away():
    world, predicted, _ = foreseen("circle_crossing_20", None, start=30)
    here = world.present[:, 1:]
    away = np.linalg.norm(predicted[:, 0, -1] - world.position[:, :1], axis=2) > 0.9 * AWAY
    assert (away & here).any()
    assert not (away & here).all()


@pytest.mark.slow
def test_a_ladder_is_kept_and_drawn(tmp_path):
    (tmp_path / "own.toml").write_text(
        'time_limit = 15.0\n[pedestrians]\nnumber = 3\npolicy = "stop_and_go"\n[sensor]\nrange = 2.0\n'
    )
    command = [str(tmp_path / "own.toml"), "--cases", "3", "--planner", "straight", "--planner", "orca"]
    command += ["--out", str(tmp_path / "runs")]
    result = CliRunner().invoke(build_script(ladder), command)
    assert result.exit_code == 0, result.output
    assert "points above the rung below, due to" in result.stdout
    again = CliRunner().invoke(build_script(ladder), [*command, "--json"])
    assert "run 1" not in again.output  # all are kept
    (found,) = json.loads(again.stdout)
    assert list(found["success"]) == ["P0", "P1", "P2", "P3"]  # nobody looked for certificates
    assert [step["reason"] for step in found["steps"]] == ["perception", "prediction", "luck"]
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
        (["own.toml", "own.toml"], "scenarios is .*own.toml.*, but must be a list of texts .* none of them twice"),
        (["own.toml", "other/own.toml"], "scenarios is own, own, but must be scenarios of different names"),
        (["own.toml", "--cases", "many"], "'many' are not a range of cases"),
        (["own.toml", "--planner", "nobody"], "no planner is called 'nobody'"),
    ],
)
def test_what_is_no_ladder_is_refused(arguments, sentence, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for place in ("own.toml", "other/own.toml"):
        Path(place).parent.mkdir(exist_ok=True)
        Path(place).write_text('[layout]\ngenerator = "circle_crossing"\n[pedestrians]\nnumber = 2\n')
    with pytest.raises(InputError, match=sentence):
        build_script(ladder)(arguments, standalone_mode=False)


def test_certificates_are_of_the_cases_that_were_examined():
    scenario = load_scenario("blocks_12")

    def found(digest, number):
        examined = {"scenario": digest, "margin": 0.1, "test": {"examined": 9, "uncertified": [2]}}
        status = dataclasses.replace(scenario.certificates, certified=Certified.model_validate(examined))
        return find_certified(dataclasses.replace(scenario, certificates=status), Cases("test", 0, number))

    assert np.flatnonzero(~found(scenario.digest, 9)).tolist() == [2]
    assert found(scenario.digest, 10) is None
    assert found("another", 9) is None
