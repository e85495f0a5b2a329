"""`crowdbench view`: which case it shows."""

import shutil

import numpy as np
import pytest
from typer.testing import CliRunner

from crowdbench.catalog import load_scenario
from crowdbench.cli.app import app
from crowdbench.record import viewer
from crowdbench.record.recorded_cases import read_recorded, recorded_outcomes
from crowdbench.results.episodes import EPISODES, Episodes
from crowdbench.utils.errors import InputError


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run of twenty cases, of which the failures and the first ten are recorded."""
    out = tmp_path_factory.mktemp("run") / "run"
    assert CliRunner().invoke(app, ["run", "--planner", "orca", "--cases", "20", "--out", str(out)]).exit_code == 0
    return out


@pytest.fixture
def shown(monkeypatch):
    """The cases that the viewer is asked to show, and whether in a browser."""
    asked = []
    monkeypatch.setattr(viewer, "view", lambda path, case, *, web: asked.append((case, web)))
    return asked


@pytest.mark.parametrize(("metric", "sign"), [("jerk", 1.0), ("minimum_gap", -1.0), ("navigation_time", 1.0)])
def test_the_worst_case_is_shown(metric, sign, run, shown):
    assert CliRunner().invoke(app, ["view", str(run), "--worst", metric, "--web"]).exit_code == 0
    values = sign * Episodes.read(run / EPISODES).columns[metric]
    assert shown == [(int(np.nanargmax(values)), True)]


def test_the_first_failure_is_shown_and_the_cases_of_each_outcome_are_listed(run, shown):
    done = CliRunner().invoke(app, ["view", str(run)])
    episodes = Episodes.read(run / EPISODES)
    failed, solved = episodes.failures["collision"], episodes.case[episodes.columns["success_rate"]]
    assert shown == [(failed[0], False)]
    lines = done.stdout.splitlines()
    assert lines[0].startswith(f"{len(failed)} collisions (cases {failed[0]}, {failed[1]}")
    assert lines[1].startswith(f"{len(solved)} successes (cases {solved[0]}, {solved[1]}")
    assert lines[2] == f"case test/{failed[0]}"


def test_a_case_that_is_not_recorded_is_simulated_again(run, monkeypatch, tmp_path):
    recorded, episodes = recorded_outcomes(run / "run.rrd"), Episodes.read(run / EPISODES)
    (case, *_) = [case for case in range(20) if case not in recorded]
    found = []
    monkeypatch.setattr(viewer, "view", lambda path, number, *, web: found.append(read_recorded(path, number)))
    assert CliRunner().invoke(app, ["view", str(run), "--case", str(case)]).exit_code == 0
    (properties,) = (episode.properties for episode in found)
    assert properties["case"] == [case]
    assert properties["metrics"][0]["path_length"] == episodes.columns["path_length"][case]
    shutil.copytree(run, tmp_path / "run")
    monkeypatch.setattr("crowdbench.cli.cases.make_loader", lambda *_: lambda run: load_scenario("square_crossing_5"))
    with pytest.raises(InputError, match=f"case {case} of .* ends in another way when it is simulated again"):
        raise CliRunner().invoke(app, ["view", str(tmp_path / "run"), "--case", str(case)]).exception


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--worst", "jerk", "--case", "3"], "--worst chooses the case"),
        (["--worst", "jerkk"], "has no metric jerkk .did you mean jerk..; it has success_rate"),
        (["--worst", "imposed_delay"], "imposed_delay is not defined in any case"),
    ],
)
def test_a_case_that_cannot_be_chosen_gets_one_sentence(arguments, sentence, run, shown):
    with pytest.raises(InputError, match=sentence):
        raise CliRunner().invoke(app, ["view", str(run), *arguments]).exception
    assert not shown


def test_the_worst_of_a_file_alone_is_not_known(run, shown):
    with pytest.raises(InputError, match=r"--worst needs the directory of a run, whose episodes.csv has the metrics"):
        raise CliRunner().invoke(app, ["view", str(run / "run.rrd"), "--worst", "jerk"]).exception
