"""`crowdbench export`: tracks and steps of a run, beside what the environment and the recording say."""

import itertools
import json
from pathlib import Path

import gymnasium
import numpy as np
import pyarrow.parquet as pq
import pytest
from helpers import fixture
from typer.testing import CliRunner

from crowdbench.cli.app import app
from crowdbench.core.types import Outcome
from crowdbench.runs.loading import load_run
from crowdbench.runs.make import make_run
from crowdbench.runs.rollout import rollout
from crowdbench.runs.spec import RunSpec
from crowdbench.scenario.cases import Cases


def make(folder, scenario, planner="orca"):
    run = load_run(RunSpec(planner, scenario, Cases("test", 0, 6), record="commands"))
    make_run(run, folder)
    return run


def invoke(*arguments):
    return CliRunner().invoke(app, ["export", *map(str, arguments)])


@pytest.mark.parametrize(
    "scenario",
    [
        "circle_crossing_5",
        pytest.param(fixture("noise_late"), marks=pytest.mark.slow),
        pytest.param("unicycle", marks=pytest.mark.slow),
    ],
)
def test_steps_are_what_the_environment_shows_and_pays(tmp_path, scenario):
    make(tmp_path / "run", scenario)
    assert invoke(tmp_path / "run", "--out", tmp_path / "out").exit_code == 0
    table = pq.read_table(tmp_path / "out" / "steps.parquet").to_pylist()
    env = gymnasium.make("crowdbench/Vehicle-v0", scenario=scenario, action="native", dtype="float64")
    case = None
    for row in table:
        if row["case"] != case:
            case = row["case"]
            observation, _ = env.reset(options={"case": f"test/{case}"})
            assert row["step"] == 0
        assert row["observation"] == observation.tolist()
        observation, reward, *ends, _ = env.step(np.array(row["action"]))
        assert row["reward"] == pytest.approx(reward)
        assert [row["terminated"], row["truncated"]] == ends
    assert {row["case"] for row in table} == set(range(6))


def test_tracks_are_where_everybody_was(tmp_path):
    run = make(tmp_path / "run", "circle_crossing_5")
    assert "6 cases in" in invoke(tmp_path / "run", "--out", tmp_path / "out").output
    trace = rollout(run.driver, run.scenario, run.spec.cases)
    for row, case in enumerate(trace.case):
        frame, person, *position = np.loadtxt(tmp_path / "out" / "tracks" / f"test-{case}.txt", unpack=True)
        frame, person = frame.astype(int), person.astype(int)
        assert set(person) == set(range(6))
        assert frame.max() == trace.steps[row]
        np.testing.assert_allclose(np.stack(position, axis=1), trace.position[row, frame, person], atol=1e-6)
    assert len(list((tmp_path / "out" / "tracks").iterdir())) == 6


NUMBER = (int, float)
SHAPE = {"type": str, "width": NUMBER, "length": NUMBER}
SOCNAV = {
    "metadata": str,
    "grid": dict.fromkeys(("width", "height", "cell_size", "x_orig", "y_orig", "angle_orig"), NUMBER)
    | {"data": [[int]]},
    "walls": [[NUMBER]],
    "sequence": [
        {
            "timestamp": NUMBER,
            "robot": dict.fromkeys(("x", "y", "angle", "speed_x", "speed_y", "speed_a"), NUMBER) | {"shape": SHAPE},
            "goal": dict.fromkeys(("x", "y", "angle", "pos_threshold", "angle_threshold"), NUMBER)
            | {"type": str, "human": type(None)},
            "people": [dict.fromkeys(("id", "x", "y", "angle"), NUMBER)],
            "objects": [{"id": NUMBER, "type": str, "x": NUMBER, "y": NUMBER, "angle": NUMBER, "shape": SHAPE}],
        }
    ],
}
"""The keys that the format requires, and the types of their values."""


def conforms(value, kind):
    if isinstance(kind, dict):
        return isinstance(value, dict) and all(key in value and conforms(value[key], of) for key, of in kind.items())
    if isinstance(kind, list):
        return isinstance(value, list) and all(conforms(each, kind[0]) for each in value)
    return isinstance(value, kind) and not isinstance(value, bool)


@pytest.fixture(
    scope="module",
    params=["door_10", *(pytest.param(name, marks=pytest.mark.slow) for name in ("car_28", "mixed_20"))],
)
def socnav(request, tmp_path_factory):
    """A scenario, a trace, and the content of the file of each of its cases."""
    folder = tmp_path_factory.mktemp("socnav")
    run = make(folder / "run", request.param)
    assert invoke(folder / "run", "--out", folder / "out", "--format", "socnav").exit_code == 0
    trace = rollout(run.driver, run.scenario, run.spec.cases)
    files = [folder / "out" / "tracks" / f"test-{case}.json" for case in trace.case]
    assert sorted(files) == sorted((folder / "out" / "tracks").iterdir())
    return request.param, trace, [json.loads(file.read_text()) for file in files]


@pytest.mark.slow
def test_socnav_files_have_the_keys_and_types_of_the_format(socnav):
    for content in socnav[2]:
        assert conforms(content, SOCNAV)
        assert "not rated by people" in content["metadata"]


@pytest.mark.slow
def test_the_robot_of_a_socnav_file_is_the_vehicle(socnav):
    scenario, trace, contents = socnav
    middle = np.mean([min(trace.rules.body), max(trace.rules.body)])
    for row, content in enumerate(contents):
        times = np.arange(trace.steps[row] + 1)
        robot = {key: np.array([moment["robot"][key] for moment in content["sequence"]]) for key in ("x", "y", "angle")}
        speed = np.array([moment["robot"]["speed_x"] for moment in content["sequence"]])
        np.testing.assert_allclose([moment["timestamp"] for moment in content["sequence"]], times * 0.25)
        np.testing.assert_allclose(robot["x"] - middle * np.cos(robot["angle"]), trace.position[row, times, 0, 0])
        np.testing.assert_allclose(robot["y"] - middle * np.sin(robot["angle"]), trace.position[row, times, 0, 1])
        np.testing.assert_allclose(speed[1:], np.diff(robot["x"]) / 0.25)
        last, is_car = content["sequence"][-1], scenario == "car_28"
        assert last["robot"]["shape"]["type"] == ("rectangle" if is_car else "circle")
        away = np.hypot(last["goal"]["x"] - robot["x"][-1], last["goal"]["y"] - robot["y"][-1])
        assert is_car or (away < last["goal"]["pos_threshold"]) == (trace.outcome[row] == Outcome.SUCCESS)


@pytest.mark.slow
def test_people_in_a_socnav_file_face_where_they_walk(socnav):
    _, trace, contents = socnav
    for row, content in enumerate(contents):
        compared = 0
        for t, (before, after) in enumerate(itertools.pairwise(content["sequence"])):
            assert len(after["people"]) == np.isfinite(trace.position[row, t + 1, 1:, 0]).sum()
            earlier = {person["id"]: (person["x"], person["y"]) for person in before["people"]}
            for person in after["people"]:
                step = np.subtract((person["x"], person["y"]), earlier.get(person["id"], np.nan))
                if (length := np.hypot(*step)) > 0.02:
                    compared += 1
                    assert np.dot([np.cos(person["angle"]), np.sin(person["angle"])], step) > 0.9 * length
        assert compared > 20


@pytest.mark.slow
def test_the_walls_of_a_socnav_file_are_in_its_grid(socnav):
    scenario, _, contents = socnav
    for content in contents:
        grid, cells = content["grid"], np.array(content["grid"]["data"])
        assert cells.shape == (grid["height"], grid["width"])
        assert (len(content["walls"]) > 0) == cells.any() == (scenario == "door_10")
        walls = np.array(content["walls"]).reshape(-1, 1, 2, 2)
        points = (walls[:, :, 0] + np.linspace(0, 1, 9)[:, None] * (walls[:, :, 1] - walls[:, :, 0])).reshape(-1, 2)
        column, row = ((points - [grid["x_orig"], grid["y_orig"]]) // grid["cell_size"]).astype(int).T
        assert cells[grid["height"] - 1 - row, column].all()


def test_what_cannot_be_exported_is_said_before_anything_is_written(tmp_path):
    make(tmp_path / "run", "circle_crossing_5")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine.txt").write_text("mine")
    for arguments in (["--out", tmp_path / "out"], ["--out", tmp_path / "out", "--overwrite"]):
        failed = invoke(tmp_path / "run", *arguments)
        assert failed.exit_code
        assert "out" in str(failed.exception)
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["mine.txt"]
    (tmp_path / "run" / "commands.parquet").unlink()
    failed = invoke(tmp_path / "run", "--out", tmp_path / "new")
    assert failed.exit_code
    assert not Path(tmp_path / "new").exists()
