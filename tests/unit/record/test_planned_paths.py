"""What a planner predicted and considered is read back from a recording."""

import dataclasses

import numpy as np
import pytest
from helpers import drive

from crowdbench.drawing import LIGHT
from crowdbench.record.decisions import BEST, draw_decisions, read_paths


@pytest.fixture(scope="module")
def said():
    """An episode in which the vehicle does not see pedestrian 2, and a planner has logged futures and twenty ways."""
    trace = drive("straight", "1")
    states = trace.position.shape[1]
    perceived = np.where(np.arange(5)[:, None] == 2, np.nan, trace.position[:, :, 1:])
    predicted = np.zeros((1, states - 1, 3, 8, 5, 2)) + np.arange(5.0)[:, None]
    considered = np.zeros((1, states - 1, 8, 20, 3)) + np.arange(20.0)[:, None]
    planned = np.zeros((1, states - 1, 8, 1, 2)) + 7.0
    logs = {"predicted": predicted, "sampled": considered, "planned": planned}
    return dataclasses.replace(trace, perceived=perceived, logs=logs)


def test_all_that_is_known_is_predicted_and_the_best_ways_are_considered(said):
    ways = read_paths(list(draw_decisions(said, 0)), said.rules.dt)
    assert sorted(ways) == list(range(int(said.steps[0])))
    for state in ways.values():
        whom = np.array([way[-1, 0] for way in state.predicted])
        assert np.unique(whom, return_counts=True)[0].tolist() == [0.0, 1.0, 3.0, 4.0]
        thirds = np.array([way[0, 0] for way in state.considered]).reshape(-1, BEST)
        np.testing.assert_array_equal(thirds, np.tile(np.arange(19.0, 19.0 - BEST, -1.0), (len(thirds), 1)))
        assert {tuple(point) for way in state.planned for point in way} == {(7.0, 7.0)}
        drawn = [(shape.color, len(shape.points)) for shape in state.shapes()]
        assert {color for color, _ in drawn} == {LIGHT.predicted, LIGHT.considered, LIGHT.vehicle}
        assert drawn[-1][0] == LIGHT.vehicle  # over all others


def test_predictions_start_where_the_vehicle_measures_the_pedestrians(said):
    measured = dataclasses.replace(said, perceived=said.perceived + 0.4)
    for state, paths in read_paths(list(draw_decisions(measured, 0)), said.rules.dt).items():
        starts = {tuple(np.round(path[0], 4)) for path in paths.predicted if path[0, 0] != path[0, 1]}
        where = np.delete(measured.perceived[0, state], 2, axis=0)
        assert starts == {tuple(point) for point in where.astype(np.float32).astype(float).round(4).tolist()}


def test_a_planner_that_logs_nothing_has_no_ways(said):
    assert read_paths(list(draw_decisions(dataclasses.replace(said, logs={}), 0)), said.rules.dt) == {}


def test_commands_are_paths_of_one_second_and_the_best_one_is_planned(said):
    fan = np.zeros((1, said.position.shape[1] - 1, 4, 3)) + np.arange(12.0).reshape(4, 3)
    fan[:, :, 1, 2] = np.nan  # cannot be chosen
    logged = dataclasses.replace(said, logs={"commands": fan})
    paths = read_paths(list(draw_decisions(logged, 0)), said.rules.dt, commands=True)
    assert sorted(paths) == list(range(int(said.steps[0])))
    for state, found in paths.items():
        starts = np.array([path[0] for path in (*found.considered, *found.planned)])
        np.testing.assert_allclose(starts, np.tile(said.position[0, state, 0], (4, 1)), atol=1e-5)
        commands = np.array([path[1] - path[0] for path in (*found.considered, *found.planned)])
        np.testing.assert_allclose(commands, fan[0, 0, [0, 2, 3, 3], :2], atol=1e-5)
        assert len(found.planned) == 1
