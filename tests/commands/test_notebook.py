"""`crowdbench.run` and what it returns."""

import re

import numpy as np
import pytest
from typer.testing import CliRunner

import crowdbench
from crowdbench.cli.app import app
from crowdbench.planners.planner import Planner
from crowdbench.utils.errors import InputError


class Halts(Planner):
    def plan(self, obs):
        return np.zeros((len(obs), 2))


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
    assert found.directory is None
    assert kept.directory == tmp_path / "run"
    assert found.metrics == kept.metrics | {"crowd": found.metrics["crowd"]}
    assert found.metrics["crowd"].mean == 5.0
    assert (found.planner, found.scenario, found.cases) == ("orca", "circle_crossing_5", "test:0:20")


def test_a_planner_of_the_notebook_is_driven_and_kept(tmp_path):
    found = crowdbench.run(Halts(), "circle_crossing_5", "val:3", overrides={"time_limit": 5.0}, out=tmp_path / "run")
    assert found.planner == "Halts"
    assert found.metrics["timeout_rate"].mean == 1.0
    assert (tmp_path / "run" / "run.rrd").exists()
    with pytest.raises(crowdbench.InputError, match="exists"):
        crowdbench.run(Halts(), cases=3, out=tmp_path / "run")


def test_it_is_shown_as_a_table_with_units(found):
    shown = found._repr_markdown_()
    success = found.metrics["success_rate"]
    assert shown.startswith("**orca** on circle_crossing_5, cases test:0:20\n\n| metric |")
    assert (
        f"| success | success_rate | {100 * success.mean:.1f} % | {100 * success.low:.1f} to {100 * success.high:.1f} |  | 20 |"
        in shown
    )
    assert re.search(r"\| jerk \| [\d.]+ m/s\^3 \| [\d.]+ to [\d.]+ \| [\d.]+ \| 20 \|", shown)


def test_episodes_are_a_table_of_arrow_and_pandas(found):
    pandas = pytest.importorskip("pandas")
    table = found.episodes.to_arrow()
    assert table.column_names[:3] == ["case", "outcome", "steps"]
    frame = pandas.DataFrame.from_arrow(found.episodes)
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


def test_what_needs_a_kept_run_says_so():
    found = crowdbench.run("straight", cases=2)
    for use in (lambda: found.view(0), lambda: found.render(0), lambda: found.compare(found)):
        with pytest.raises(InputError, match=r"the run was not kept: give run\(..., out=DIR\)"):
            use()
