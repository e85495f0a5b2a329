"""`crowdbench.run` and what it returns."""

import copy
import functools
import gc
import os
import pickle
import re
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import crowdbench
from crowdbench.cli.app import app
from crowdbench.planners.planner import Planner
from crowdbench.runs.spec import RunSpec
from crowdbench.utils.errors import InputError


class Halts(Planner):
    def plan(self, obs):
        return np.zeros((len(obs), 2))


STROLL = """
import numpy as np
from crowdbench import PedestrianPolicy

class Stroll(PedestrianPolicy):
    def velocities(self, world, parameters):
        to_goal = world.goal[:, 1:] - world.position[:, 1:]
        return 0.5 * to_goal / np.maximum(np.linalg.norm(to_goal, axis=2, keepdims=True), 1e-6)

def policy():
    return Stroll()
"""


def crowd(trace):
    """How many people there are. [1]"""
    return trace.present[:, 0, 1:].sum(axis=1)


@pytest.fixture(scope="module")
def found():
    return crowdbench.run("orca", cases=20, metrics={"crowd": crowd})


def test_it_measures_what_the_command_measures(found, tmp_path):
    given = ["run", "--planner", "orca", "--cases", "20", "--record", "none", "--out", str(tmp_path / "run")]
    assert CliRunner().invoke(app, given).exit_code == 0
    kept = crowdbench.Result.read(tmp_path / "run")
    assert kept.directory == tmp_path / "run"
    assert found.metrics == kept.metrics | {"crowd": found.metrics["crowd"]}
    assert found.metrics["crowd"].mean == 5.0
    assert (found.planner, found.scenario, found.cases) == ("orca", "circle_crossing_5", "test:0:20")


def test_a_planner_of_the_notebook_is_driven_and_kept(tmp_path):
    found = crowdbench.run(Halts(), "circle_crossing_5", "val:3", overrides={"time_limit": 5.0}, out=tmp_path / "run")
    assert found.planner == "Halts"
    assert found.metrics["timeout_rate"].mean == 1.0
    assert (tmp_path / "run" / "run.rrd").exists()
    with pytest.raises(crowdbench.InputError, match="exists already"):
        crowdbench.run(Halts(), cases=3, out=tmp_path / "run")


def test_it_is_shown_as_a_table_with_units(found):
    shown = found._repr_markdown_()
    success = found.metrics["success_rate"]
    assert shown.startswith("**orca** on circle_crossing_5, cases test:0:20\n\n| metric |")
    mean, low, high = (f"{100 * value:.1f}" for value in (success.mean, success.low, success.high))
    assert f"| success | success_rate | {mean} % | {low} to {high} |  | 20 |" in shown
    assert re.search(r"\| jerk \| [\d.]+ m/s\^3 \| [\d.]+ to [\d.]+ \| [\d.]+ \| 20 \|", shown)


def test_episodes_are_a_table_of_arrow_and_pandas(found):
    pandas = pytest.importorskip("pandas")
    table = found.episodes.to_arrow()
    assert table.column_names[:3] == ["case", "outcome", "steps"]
    frame = found.episodes.to_pandas()
    pandas.testing.assert_frame_equal(pandas.DataFrame.from_arrow(found.episodes), frame, check_dtype=False)
    pandas.testing.assert_frame_equal(pandas.DataFrame(found.episodes), frame)
    assert (frame["outcome"] == "success").mean() == found.metrics["success_rate"].mean
    assert frame["navigation_time"].isna().sum() == (frame["outcome"] != "success").sum()
    assert table["navigation_time"].null_count == frame["navigation_time"].isna().sum()


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"planner": Halts(), "options": {"speed": 1.0}}, "options are for a planner that is named"),
        ({"planner": Halts}, "must be a name, a file or a Planner, such as MyPlanner()"),
        ({"planner": "orca", "metrics": {"jerk": crowd}}, "a column jerk exists already"),
        ({"planner": "orca", "record": "everything", "out": "run"}, "everything"),
        ({"planner": None}, "planner is None, but must be a name, a file or a Planner"),
        ({"planner": "orca", "scenario": None}, "scenario is None, but must be a name, or a file"),
        ({"planner": "orca", "cases": None}, "cases 'None' are not a range of cases"),
        ({"planner": "orca", "options": ["speed=1"]}, "options is .*, but must be a table"),
        ({"planner": "orca", "options": {1: 2}}, "options is .*, but must be a table"),
        ({"planner": "orca", "out": "a\0b"}, "out is 'a.*b', but must be the path of a directory"),
        ({"planner": "orca", "overrides": "vehicle.visible=true"}, "overrides are .*, but must be a table such as"),
        ({"planner": "orca", "overrides": {1: 2}}, "overrides are .*, but must be a table such as"),
        ({"planner": "orca", "overrides": ["vehicle.visible"]}, "overrides 'vehicle.visible' sets nothing"),
        ({"planner": "orca", "pedestrians": 3}, "pedestrians is 3, but must be a name, or a file"),
        ({"planner": "orca", "metrics": [crowd]}, "metrics is .*, but must be functions of a trace by name"),
        ({"planner": "orca", "metrics": {"crowd": 1}}, "metrics is .*, but must be functions of a trace by name"),
        ({"planner": "orca", "data": 1}, "data is 1, but must be the folder with recorded tracks"),
        ({"planner": "orca", "out": 1}, "out is 1, but must be the path of a directory"),
        ({"planner": Halts(), "key": 1}, "key is 1, but must be a text"),
        ({"planner": "orca", "progress": 1}, "progress is 1, but must be a function"),
    ],
)
def test_what_cannot_be_is_said_in_a_sentence(arguments, sentence, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(crowdbench.InputError, match=sentence):
        crowdbench.run(**arguments)
    assert list(tmp_path.iterdir()) == []


def test_a_kept_run_shows_its_failures_and_what_differs(tmp_path, monkeypatch):
    orca = crowdbench.run("orca", cases=12, out=tmp_path / "orca")
    other = crowdbench.run("straight", cases=12, out=tmp_path / "straight")
    assert orca.failures == {"collision": orca.episodes.case[orca.episodes.columns["collision_rate"]].tolist()}
    found = orca.compare(other)
    assert found.names == ("orca", "straight")
    text = found._repr_markdown_()
    assert text.startswith("orca and straight: 12 shared cases (test:0:12), ")
    assert "| metric | orca | straight | difference (95 % interval) | p |" in text
    assert repr(found) == text
    picture = orca.render(3)
    picture.save(tmp_path / "case.png")
    assert (tmp_path / "case.png").read_bytes().startswith(b"\x89PNG")
    assert picture._repr_png_().startswith(b"\x89PNG")
    opened = []
    monkeypatch.setattr("crowdbench.record.viewer.show", lambda file, *, web: opened.append((file.suffix, web)))
    orca.view("test/3", web=True)
    assert opened == [(".rrd", True)]
    with pytest.raises(InputError, match="case 40 is none of the cases test:0:12"):
        orca.render(40)


def test_a_run_without_a_directory_has_all_methods(monkeypatch, tmp_path):
    orca, other = (crowdbench.run(planner, cases="val:12") for planner in ("orca", "straight"))
    found = orca.compare(other)
    assert found.names == ("orca", "straight")
    assert orca.compare(crowdbench.run("orca", cases="val:12")).names == ("orca, first run", "orca, second run")
    trace = orca.trace("val/3")
    row = list(orca.episodes.case).index(3)
    assert (trace.split, list(trace.case), list(trace.steps)) == ("val", [3], [orca.episodes.steps[row]])
    assert trace.position.shape == (1, trace.steps[0] + 1, 6, 2)
    assert np.isfinite(trace.position).all()
    assert orca.render(3).size == orca.render("val/3").size
    assert orca.plot().mode == orca.plot("navigation_time_or_limit").mode == "RGB"
    opened = []
    monkeypatch.setattr("crowdbench.record.viewer.show", lambda file, *, web: opened.append(file.suffix))
    orca.view(3)
    assert opened == [".rrd"]
    for use in (orca.trace, orca.render, orca.view):
        with pytest.raises(InputError, match="case 40 is none of the cases val:0:12"):
            use(40)
    with pytest.raises(InputError, match="other is None, but must be the result of another run"):
        orca.compare(None)
    with pytest.raises(InputError, match="metric is 3, but must be the name of a metric"):
        orca.plot(3)


def test_a_trace_has_the_positions_of_the_run_and_the_inputs_of_all_metrics(found):
    whole = crowdbench.rollout("orca", "circle_crossing_5", 20)
    for case in (0, 7):
        one = found.trace(case)
        np.testing.assert_array_equal(one.position[0], whole.position[case, : one.steps[0] + 1])
        np.testing.assert_array_equal(one.command[0], whole.command[case, : one.steps[0]])
        for name, metric in crowdbench.METRICS.items():
            np.testing.assert_array_equal(metric(one)[0], found.episodes.columns[name][case], name)
    seen = crowdbench.run("orca", "circle_crossing_5_visible", cases=2).trace(0)
    assert seen.undisturbed.shape == (1, seen.steps[0] + 1, 5, 2)


def test_a_saved_run_is_read_by_python_and_by_the_commands(tmp_path):
    found = crowdbench.run("straight", cases=8)
    saved = found.save(tmp_path / "run")
    assert (saved.directory, saved.id) == (tmp_path / "run", found.id)
    assert found.save(str(tmp_path / "run")).directory == tmp_path / "run"
    assert crowdbench.Result.read(tmp_path / "run").metrics == found.metrics
    assert CliRunner().invoke(app, ["score", str(tmp_path / "run")]).exit_code == 0
    with pytest.raises(InputError, match="exists already"):
        crowdbench.run("straight", cases=9).save(tmp_path / "run")
    with pytest.raises(InputError, match="directory is None, but must be the path of a directory"):
        found.save(None)
    crowdbench.run("straight", cases=9).save(tmp_path / "run", overwrite=True)
    with pytest.raises(InputError, match="another run has replaced this one"):
        saved.trace(0)
    assert len(found.trace(0)) == 1


@pytest.mark.filterwarnings("ignore:.*fork")
def test_a_temporary_directory_lives_as_long_as_its_result():
    found = crowdbench.run("straight", cases=2)
    directory, others = found.directory, [copy.copy(found), copy.deepcopy(found)]
    with pytest.raises(InputError, match="cannot be pickled"):
        pickle.dumps(found)
    del found
    gc.collect()
    assert len(others[0].trace(1)) == len(others[1].trace(1)) == 1
    if pid := os.fork():
        assert os.waitpid(pid, 0)[1] == 0
    else:
        others.clear()
        os._exit(0)
    assert directory.is_dir()
    others.clear()
    gc.collect()
    assert not directory.parent.exists()


def test_a_cell_runs_twice(tmp_path):
    def cell(cases, **settings):
        return crowdbench.run("straight", cases=cases, out=tmp_path / "named", **settings)

    first, made = cell(5), (tmp_path / "named" / "result.json").stat().st_mtime_ns
    assert cell(5).id == first.id
    assert (tmp_path / "named" / "result.json").stat().st_mtime_ns == made
    with pytest.raises(InputError, match="exists already"):
        cell(6)
    assert cell(6, overwrite=True).cases == "test:0:6"


def test_files_of_a_user_are_needed_only_by_a_result_that_was_read(tmp_path):
    file = tmp_path / "stroll.py"
    file.write_text(STROLL)
    found = crowdbench.run("straight", cases=3, pedestrians=str(file))
    assert found.trace(1).position.shape[0] == 1
    read = crowdbench.Result.read(found.save(tmp_path / "run").directory)
    with pytest.raises(InputError, match="is a file of a user: give it with"):
        read.trace(1)
    for given in (str(file), [str(file)]):
        np.testing.assert_array_equal(read.trace(1, pedestrians=given).position, found.trace(1).position)


def test_an_interrupted_run_keeps_its_finished_parts_and_the_note_is_true(monkeypatch):
    monkeypatch.setattr("crowdbench.api.RunSpec", functools.partial(RunSpec, batch=2))

    def interrupt(done, total=[]):  # noqa: B006 (counts over calls)
        total.append(done)
        if sum(total) > 3.0:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt) as error:
        crowdbench.run("straight", cases=6, progress=interrupt)
    (note,) = error.value.__notes__
    folder = Path(re.search(r"`crowdbench merge (\S+)/\* --out ", note)[1])
    assert "the same command" not in note
    assert [path.name for path in folder.iterdir()] == ["test-0-2"]
    shutil.rmtree(folder.parent)


def test_a_cell_with_a_planner_object_is_made_again(tmp_path):
    def cell(planner, cases=3, **settings):
        found = crowdbench.run(planner, cases=cases, overrides=["time_limit=2.0"], out=tmp_path / "run", **settings)
        assert found.id == crowdbench.Result.read(tmp_path / "run").id
        return found.id

    assert cell(Halts()) != cell(Halts())
    assert cell("straight", metrics={"crowd": crowd}, overwrite=True) != cell("straight", metrics={"crowd": crowd})
    assert cell(Halts(), key="a", overwrite=True) == cell(Halts(), key="a")
    for different in ({"planner": Halts(), "key": "b"}, {"planner": Halts(), "cases": 4}, {"planner": "straight"}):
        with pytest.raises(InputError, match="exists already"):
            cell(**different)


def test_pandas_is_optional(found, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(InputError, match="to_pandas needs pandas: install it with pip install pandas"):
        found.episodes.to_pandas()


def test_overrides_are_a_table_or_texts():
    tables = {"vehicle.visible": True, "time_limit": 20.0}, ["vehicle.visible=true", "time_limit=20.0"]
    one, other = (crowdbench.load_scenario("circle_crossing_5", overrides) for overrides in tables)
    assert one.digest == other.digest
    assert one.rules.visible
    with pytest.raises(InputError, match="overrides are 3, but must be a table such as"):
        crowdbench.load_scenario("circle_crossing_5", overrides=3)
    with pytest.raises(InputError, match="scenario is None, but must be a name"):
        crowdbench.load_scenario(None)


def test_a_rollout_whose_logs_are_too_large_says_how_many_cases_fit(monkeypatch):
    class Talks(Halts):
        def plan(self, obs):
            obs.log("pace", np.zeros(len(obs)))
            return super().plan(obs)

    arguments = Talks(), crowdbench.load_scenario("circle_crossing_5", ["time_limit=2.0"]), 4
    assert crowdbench.rollout(*arguments, keep_logs=True).logs["pace"].shape[0] == 4
    monkeypatch.setattr("crowdbench.runs.rollout.LOG_MEMORY", 140)
    with pytest.raises(InputError, match="the planner's logs are too large: roll out 3 cases or fewer"):
        crowdbench.rollout(*arguments, keep_logs=True)


def test_a_rollout_takes_objects_or_names():
    planner = crowdbench.load_planner("orca", {"safety_space": 0.1})
    assert isinstance(planner, Planner)
    scenario = crowdbench.load_scenario("circle_crossing_5", ["pedestrians.number=2"])
    trace = crowdbench.rollout(planner, scenario, "val:3")
    assert (trace.split, trace.position.shape[0], trace.position.shape[2]) == ("val", 3, 3)
    assert len(crowdbench.rollout(Halts(), "circle_crossing_5", crowdbench.Cases("test", 4, 6))) == 2
    for wrong, sentence in [
        (("orka", scenario, 3), "no planner is called 'orka'"),
        ((Halts, scenario, 3), "planner is .*, but must be a name, a file or a Planner"),
        ((planner, None, 3), "scenario is None, but must be a name, a file or a Scenario"),
        ((planner, scenario, 2.5), "cases '2.5' are not a range of cases"),
        ((planner, scenario, 10**6), "a trace of 1000000 cases of circle_crossing_5 is too large"),
    ]:
        with pytest.raises(InputError, match=sentence):
            crowdbench.rollout(*wrong)
