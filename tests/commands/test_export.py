"""`crowdbench export`: tracks and steps of a run, beside what the environment and the recording say."""

from pathlib import Path

import gymnasium
import numpy as np
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from crowdbench.cli import app
from crowdbench.runs.load import load_run
from crowdbench.runs.rollout import rollout
from crowdbench.runs.shards import make_run
from crowdbench.runs.spec import RunSpec
from crowdbench.scenario.cases import Cases


def make(folder, scenario, planner="orca"):
    run = load_run(RunSpec(planner, scenario, Cases("test", 0, 6), record="commands"))
    make_run(run, folder)
    return run


def invoke(*arguments):
    return CliRunner().invoke(app, ["export", *map(str, arguments)])


@pytest.mark.parametrize("scenario", ["circle_crossing_5", "noisy_10", "unicycle_10"])
def test_steps_are_what_the_environment_shows_and_pays(tmp_path, scenario):
    make(tmp_path / "run", scenario)
    assert invoke(tmp_path / "run", "--out", tmp_path / "out").exit_code == 0
    table = pq.read_table(tmp_path / "out" / "steps.parquet").to_pylist()
    env = gymnasium.make("crowdbench/Vehicle-v0", scenario=scenario, action="native")
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
