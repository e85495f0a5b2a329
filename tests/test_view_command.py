"""`crowdbench view`: which case it shows."""

import numpy as np
import pytest
from typer.testing import CliRunner

from crowdbench.cli import app
from crowdbench.errors import InputError
from crowdbench.evaluate.results import EPISODES, Episodes
from crowdbench.record import view


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run of twenty cases, of which the failures and the first ten are recorded."""
    out = tmp_path_factory.mktemp("run") / "run"
    assert CliRunner().invoke(app, ["run", "--planner", "orca", "--cases", "20", "--out", str(out)]).exit_code == 0
    return out


@pytest.fixture
def shown(monkeypatch):
    """The cases and times that the viewer is asked to show."""
    asked = []
    monkeypatch.setattr(view, "view", lambda path, case, screenshot, **more: asked.append((case, more)))
    return asked


@pytest.mark.parametrize(("metric", "sign"), [("jerk", 1.0), ("minimum_gap", -1.0), ("navigation_time", 1.0)])
def test_the_worst_recorded_case_is_shown(metric, sign, run, shown):
    assert CliRunner().invoke(app, ["view", str(run), "--worst", metric, "--time", "2"]).exit_code == 0
    recorded = view.recorded_cases(run / "run.rrd")
    assert 10 <= len(recorded) < 20
    values = sign * Episodes.read(run / EPISODES).columns[metric][recorded]
    assert shown == [(recorded[int(np.nanargmax(values))], {"seconds": 2.0, "web": False})]


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--worst", "jerk", "--case", "3"], "--worst chooses the case"),
        (["--worst", "jerkk"], "has no metric jerkk; it has success_rate"),
        (["--worst", "imposed_delay"], "imposed_delay is not defined in any recorded case"),
    ],
)
def test_a_case_that_cannot_be_chosen_gets_one_sentence(arguments, sentence, run, shown):
    with pytest.raises(InputError, match=sentence):
        raise CliRunner().invoke(app, ["view", str(run), *arguments]).exception
    assert not shown


def test_the_worst_of_a_file_alone_is_not_known(run, shown):
    with pytest.raises(InputError, match=r"--worst needs the directory of a run, whose episodes.csv has the metrics"):
        raise CliRunner().invoke(app, ["view", str(run / "run.rrd"), "--worst", "jerk"]).exception
