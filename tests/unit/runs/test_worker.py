"""Parts on a worker, called here in this process, and the faults of clusters."""

import dataclasses
from concurrent.futures import Future

import pytest

from crowdbench.results.result_file import read_result
from crowdbench.runs import worker
from crowdbench.runs.loading import load_run
from crowdbench.runs.make import make_with
from crowdbench.runs.spec import RunSpec
from crowdbench.runs.worker import PartTask, make_part
from crowdbench.scenario.cases import Cases
from crowdbench.utils.errors import InputError, MachineFault
from crowdbench.utils.executors import Executor, open_executor

LATE = "def metric(trace):\n    return trace.gap[:, 0] if 5 not in trace.case else trace.nothing\n"


@pytest.fixture(autouse=True)
def forget():
    yield
    worker._close()
    worker._files.clear()


@pytest.fixture
def run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "late.py").write_text(LATE)
    spec = RunSpec("straight", "circle_crossing_5", Cases.parse("8"), metrics=("./late.py",), record="commands")
    return load_run(spec)


def here(change=lambda task: task):
    """Workers that run a task in this process when it is submitted."""

    def submit(function, task):
        future = Future()
        future.set_result(function(change(task)))
        return future

    return Executor(submit, 4)


def test_the_cases_are_shared_out_and_a_failed_metric_is_reported(run, tmp_path):
    done = []
    [made] = make_with(here(), [(run, tmp_path / "a")], progress=done.append)
    assert (made.is_complete, made.error) == (True, None)
    assert sum(done) == pytest.approx(8.0)
    assert run.failed["late"].startswith("metric late raised AttributeError")
    result = read_result(tmp_path / "a")
    assert "late" not in result["metrics"]
    assert result["outcomes"]["success"] + result["outcomes"]["collision"] == 8
    with pytest.raises(InputError, match="it is this run without metric late"):
        make_with(here(), [(run, tmp_path / "a")])


def test_a_worker_with_another_version_is_refused(run, tmp_path):
    other = here(lambda task: dataclasses.replace(task, id="0" * 64))
    with pytest.raises(MachineFault, match="has another version of crowdbench, or of a file of the run"):
        make_with(other, [(run, tmp_path / "a")])
    assert not (tmp_path / "a").exists()


def test_a_worker_without_the_folder_of_the_command_is_refused(run, tmp_path):
    other = here(lambda task: dataclasses.replace(task, working_directory="/nowhere"))
    with pytest.raises(MachineFault, match=r"cannot enter /nowhere \(No such file or directory\): start the"):
        make_with(other, [(run, tmp_path / "a")])


def test_a_part_on_the_disk_of_another_machine_is_refused(run, tmp_path):
    other = here(lambda task: dataclasses.replace(task, out=tmp_path / "elsewhere" / "a"))
    (tmp_path / "elsewhere" / f"a.parts-{run.id.digest[:8]}-commands").mkdir(parents=True)
    with pytest.raises(MachineFault, match="does not have it here: give --out a folder that all workers share"):
        make_with(other, [(run, tmp_path / "a")])


def test_an_error_stops_its_run_only(run, tmp_path):
    def fail(task):
        if task.out.name == "bad":
            (tmp_path / "late.py").unlink(missing_ok=True)  # the run cannot be loaded any more
            worker._close()
        return task

    good = load_run(RunSpec("straight", "circle_crossing_5", Cases.parse("4"), record="none"))
    runs = [(good, tmp_path / "good"), (run, tmp_path / "bad")]
    made = make_with(here(fail), runs)
    assert [each.is_complete for each in made] == [True, False]
    assert "late.py" in str(made[1].error)


def test_a_worker_that_outlives_an_edit_is_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text("from crowdbench.planners.reactive import ORCAPlanner\nfrom gap import GAP\n")
    with (tmp_path / "mine.py").open("a") as file:
        file.write("def planner():\n    return ORCAPlanner(GAP)\n")
    spec = RunSpec("./mine.py", "circle_crossing_5", Cases.parse("2"), record="none")
    (tmp_path / "gap.py").write_text("GAP = 0.1\n")
    make_with(here(), [(load_run(spec), tmp_path / "a")])
    (tmp_path / "gap.py").write_text("GAP = 0.2\n")
    with pytest.raises(MachineFault, match=r"gap\.py was edited after the worker on .* had loaded it: start"):
        make_with(here(), [(load_run(spec), tmp_path / "b")])


def test_the_progress_of_a_worker_is_read_from_its_file(run, tmp_path):
    task = PartTask(run.spec, run.id.digest, str(tmp_path), tmp_path / "a", Cases.parse("8"))
    assert task.read_progress() == 0.0
    task.folder.mkdir()
    for text, number in (("", 0.0), ("2.5", 2.5), ("9", 8.0)):
        task.progress_file.write_text(text)
        assert task.read_progress() == number
    assert make_part(task).is_made
    assert not task.progress_file.exists()
    assert not make_part(task).is_made


@pytest.mark.parametrize(
    ("engine", "variable", "address", "sentence"),
    [
        ("ray", "RAY_ADDRESS", "127.0.0.1:1", "the ray workers cannot be reached: "),
        ("ray", "RAY_ADDRESS", "host:abc", "the ray workers cannot be reached: invalid literal"),
        ("dask", "DASK_SCHEDULER_ADDRESS", "nonsense", "the dask workers cannot be reached: missing port number"),
    ],
)
def test_a_cluster_that_cannot_be_reached_is_named(engine, variable, address, sentence, monkeypatch):
    pytest.importorskip("ray" if engine == "ray" else "distributed")
    monkeypatch.setenv(variable, address)
    with pytest.raises(MachineFault, match=f"^{sentence}"), open_executor(engine, None, None):
        pass
