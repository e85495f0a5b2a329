import csv
import json
import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
from study_folders import CROWDS, MINE, NETWORKS, made, print_page, read_page, refused

from crowdbench import catalog
from crowdbench.results.result_file import read_result
from crowdbench.runs.folder import make_in_folder, run_directory
from crowdbench.runs.loading import load_run
from crowdbench.runs.make import make_run
from crowdbench.runs.spec import RunSpec
from crowdbench.scenario.cases import Cases
from crowdbench.utils.errors import InputError
from studies.folder import load_runs, missing_runs, read_episodes
from studies.schema import PlannerSpec
from studies.tables import read_tables

pytestmark = pytest.mark.usefixtures("study_folder")

STUDIES = Path(__file__).parents[2] / "studies"


def test_runs_of_planners_in_a_scenario_are_the_runs_of_their_specs():
    changed = {"pedestrians.number": 3}
    base = RunSpec("", "circle_crossing_5", Cases("val", 0, 2), overrides=changed, pedestrians="social_force")
    [run] = load_runs([PlannerSpec(planner="orca")], base)
    assert run.id == load_run(run.spec).id


@pytest.mark.slow
def test_only_what_is_missing_is_run(capsys):
    print_page(CROWDS)
    first = capsys.readouterr()
    before = made()
    assert "run 4 of 4: orca_margin on square_crossing_5, cases test:0:8" in first.err
    print_page(CROWDS.replace('["orca", "orca_margin"]', '["orca", "orca_margin", "social_force"]'))
    second = capsys.readouterr()
    assert "run 1 of 2: social_force on circle_crossing_5" in second.err
    print_page(CROWDS)
    again = capsys.readouterr()
    assert "run " not in again.err
    assert again.out == first.out
    assert len(made()) == 6
    assert before.items() <= made().items()
    names = [path.name for path in Path("runs/study-tiny").glob("*/*")]
    assert sorted(set(names)) == ["episodes.csv", "result.json"]


def digests(text):
    """What the names of the directories end in: all else in them is for people."""
    return {run_directory(run, Path()).name.rpartition("-")[2] for run in read_page(text).runs}


def test_whatever_changes_a_number_makes_another_run(monkeypatch):
    Path("crowd.toml").write_text("[pedestrians]\nnumber = 5\n")
    text = NETWORKS.replace("circle_crossing_5", "./crowd.toml")
    before = digests(text)
    assert len(before) == 5
    assert digests(text.replace("0.99", "0.98").replace("Learned", "Trained")) == before
    assert not digests(f"{text}options = {{ margin = 0.3 }}\n") & before
    assert not digests(text.replace("cases", "replan_every = 2\ncases")) & before
    assert digests(text.replace("cases", "look_first = 2\ncases")) == before
    # Of the 5 runs so many stay: with other cases, the one of the second reading.
    assert len(digests(text.replace('"10"', '"11"')) & before) == 1
    Path("weights.json").write_text('{"one": 0.2, "two": 0.3}')
    assert len(digests(text) & before) == 3
    Path("weights.json").write_text('{"one": 0.2, "two": 0.1}')
    Path("crowd.toml").write_text("[pedestrians]\nnumber = 4\n")
    assert not digests(text) & before
    Path("crowd.toml").write_text("[pedestrians]\nnumber = 5\n")
    assert digests(text) == before
    Path("mine.py").write_text(MINE + "# changed\n")
    assert not digests(text) & before
    Path("mine.py").write_text(MINE)
    Path("helper.py").write_text("MARGIN = 0.1\n")
    Path("mine.py").write_text(MINE + "    import helper\n")
    helped = digests(text)
    Path("helper.py").write_text("MARGIN = 0.2\n")
    assert not digests(text) & helped
    Path("mine.py").write_text(MINE)
    monkeypatch.setattr("crowdbench.runs.run.code", lambda: "another simulator")
    assert not digests(text) & before


def test_a_run_that_was_interrupted_is_not_taken_for_the_whole(tmp_path):
    one = read_page(CROWDS).runs[0]
    directory = run_directory(one, tmp_path)
    make_run(replace(one, spec=replace(one.spec, cases=Cases.parse("5"))), directory)
    assert missing_runs([one, one], tmp_path) == [one]
    make_in_folder(one, tmp_path, lambda done: None)
    assert read_result(directory)["run"]["cases"] == "test:0:8"
    assert missing_runs([one], tmp_path) == []
    assert len(read_episodes(one, tmp_path)) == 8


def test_an_edited_run_is_named_and_one_that_cannot_be_checked_is_made_again(tmp_path):
    one = read_page(CROWDS).runs[0]
    make_in_folder(one, tmp_path, lambda done: None)
    directory = run_directory(one, tmp_path)
    table = (directory / "episodes.csv").read_text()
    (directory / "episodes.csv").write_text(table.replace("collision", "success"))
    with pytest.raises(InputError, match=r"episodes\.csv is not the file that the run wrote"):
        missing_runs([one], tmp_path)
    (directory / "episodes.csv").write_text(table)
    assert missing_runs([one], tmp_path) == []
    (directory / "result.json").unlink()
    assert missing_runs([one], tmp_path) == [one]


STOPS = """
import time
from dataclasses import replace
from pathlib import Path
import numpy as np
from crowdbench import Planner

class Stops(Planner):
    def plan(self, obs):
        while Path("wait").exists():
            Path("reached").touch()
            time.sleep(0.05)
        return np.zeros((len(obs), 2))

def planner():
    return Stops()
"""


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_a_killed_study_goes_on_where_it_stopped(number, capsys):
    Path("stops.py").write_text(STOPS)
    text = CROWDS.replace('"orca_margin"', '"./stops.py"')
    Path("tiny.toml").write_text(text)
    Path("wait").touch()
    process = subprocess.Popen(
        [sys.executable, STUDIES / "run.py", "tiny.toml"],
        stderr=subprocess.PIPE,
        text=True,
        # A process started in the background ignores SIGINT unless told otherwise.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    deadline = time.monotonic() + 100
    while not Path("reached").exists():
        assert time.monotonic() < deadline
        assert process.poll() is None
        time.sleep(0.05)
    os.kill(process.pid, number)
    _, errors = process.communicate(timeout=60)
    if number == signal.SIGINT:
        assert process.returncode == 130
        assert errors.splitlines()[-1] == (
            "crowdbench: interrupted: the same command goes on with the runs that are kept in runs/study-tiny"
        )
    before = {name: when for name, when in made().items() if ".parts-" not in name}
    assert [name.partition("-")[0] for name in before] == ["orca"]
    Path("wait").unlink()
    print_page(text)
    assert "run 1 of 3: stops on circle_crossing_5" in capsys.readouterr().err
    assert before.items() <= made().items()
    assert len(made()) == 4


@pytest.mark.slow
def test_a_page_in_json_has_the_numbers_of_its_tables(capsys):
    print_page(NETWORKS + CROWDS)
    printed = capsys.readouterr().out
    print_page(NETWORKS + CROWDS, "--format", "json")
    found = json.loads(capsys.readouterr().out)
    assert found["study"] == "tiny"
    networks, crowds = found["tables"]
    (row,) = networks["rows"]
    success = row["measured"]["success_rate"]
    assert "| {mean:.1f} ({low:.1f} to {high:.1f}) |".format_map({k: 100 * v for k, v in success.items()}) in printed
    assert row["success_rates"][0] == row["second_reading"]["first"]["success_rate"]["mean"]
    assert [crowd["scenario"] for crowd in crowds["crowds"]] == ["circle_crossing_5", "square_crossing_5"]
    gap = crowds["crowds"][1]["planners"][1]["minimum_gap"]
    assert "{mean:.3f} ({low:.3f} to {high:.3f})".format_map(gap) in printed
    assert crowds["crowds"][0]["pairs"][0]["names"][0] == "orca"
    print_page(NETWORKS + CROWDS, "--format", "csv")
    records = list(csv.DictReader(capsys.readouterr().out.splitlines()))
    assert [record["planner"] for record in records] == ["mine", "orca", "orca_margin", "orca", "orca_margin"]
    assert float(records[0]["measured.success_rate.mean"]) == success["mean"]
    print_page(NETWORKS + CROWDS, "--format", "latex")
    assert capsys.readouterr().out.count("\\toprule") == 3


BROKEN = {
    "": ["has no table", "[[tables]] or [[networks]]"],
    "[[table]]": ["unknown key table", "tables", "networks"],
    CROWDS.replace("planners", "planer"): ["unknown key tables[1].planer", "title, planners, scenarios"],
    CROWDS.replace('"orca_margin"', '"orca"'): ["tables[1].planners", "differ in their names or options"],
    CROWDS.replace('"square_crossing_5"', '"square"'): ["in tables[1], no scenario is called 'square'"],
    CROWDS.replace('["circle_crossing_5", "square_crossing_5"]', '"every"'): [
        "tables[1].scenarios is 'every'",
        '"all" or a list',
    ],
    CROWDS.replace('"8"', '"many"'): ["in tables[1], cases 'many'", "val:100"],
    NETWORKS.partition("[[networks.rows]]")[0]: ["networks[1].rows is missing", "one table or more"],
    NETWORKS.replace("collision", "colision"): ["in networks[1].rows[1]", "unknown key colision"],
    NETWORKS.replace("./mine.py", "orca"): ["in networks[1].rows[1], orca has no option 'weights'"],
    "tables = ": ["not valid TOML"],
}


@pytest.mark.parametrize("text", BROKEN)
def test_a_broken_study_gets_one_sentence(text):
    Path("orca.py").write_text((catalog.PLANNERS.folder / "orca.py").read_text())
    refused(text, BROKEN[text])


@pytest.mark.slow
def test_a_folder_of_tracks_that_no_run_needs_is_refused():
    with pytest.raises(InputError, match=r"--data does not go with study\.toml"):
        read_tables(STUDIES / "kce" / "study.toml", Path())


def test_a_study_that_is_not_there_is_told():
    with pytest.raises(InputError, match=r"study nowhere.toml cannot be read"):
        read_tables(Path("nowhere.toml"))


@pytest.mark.slow
def test_shards_make_their_share_and_the_last_one_prints_the_tables(capsys):
    print_page(CROWDS, "--out", "whole")
    whole = capsys.readouterr().out
    print_page(CROWDS, "--shard", "2/3")
    told = capsys.readouterr()
    assert told.out == ""
    assert re.findall(r"run \d of \d: (\w+ on \w+)", told.err) == ["orca_margin on circle_crossing_5"]
    assert told.err.splitlines()[-1] == (
        "crowdbench: 1 of 4 runs are in runs/study-tiny; the last process to finish, or the same command "
        "without --shard, prints the tables"
    )
    print_page(CROWDS, "--shard", "1/3")
    assert "3 of 4 runs are in runs/study-tiny" in capsys.readouterr().err
    print_page(CROWDS, "--shard", "3/3")
    assert capsys.readouterr().out == whole
    for name in made():
        tables = [Path(folder, name, "episodes.csv").read_bytes() for folder in ("whole", "runs/study-tiny")]
        assert tables[0] == tables[1]


SLOW = """
import os, time
from pathlib import Path
from crowdbench.planners.reactive import ORCAPlanner

class Slow(ORCAPlanner):
    def reset(self, rows):
        Path(f"batch-{time.monotonic_ns()}-{os.getpid()}").touch()
        while len(list(Path().glob("batch-*"))) < 2:
            time.sleep(0.01)

def planner():
    return Slow()
"""


@pytest.mark.slow
def test_processes_that_are_given_the_same_study_share_its_runs(capsys):
    Path("slow.py").write_text(SLOW)
    text = CROWDS.replace('"orca", "orca_margin"', '"orca", "./slow.py"')
    Path("tiny.toml").write_text(text)
    command = [sys.executable, STUDIES / "run.py", "tiny.toml"]
    processes = [subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) for _ in range(2)]
    ended = [process.communicate(timeout=100) for process in processes]
    assert [process.returncode for process in processes] == [0, 0], ended
    # Neither process goes on before each has a run of the slow planner, of which there are two.
    assert len({path.name.rpartition("-")[2] for path in Path().glob("batch-*")}) == 2
    # A process that looks for a run just before the other one has merged it makes it again; this may happen once.
    assert len(list(Path().glob("batch-*"))) <= 3
    assert len(made()) == 4
    assert any(printed for printed, _ in ended)
    for printed, told in ended:
        assert printed or "runs are in runs/study-tiny; the last process to finish" in told
