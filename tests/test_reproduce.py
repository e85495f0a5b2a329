import json
import re
from pathlib import Path

import pytest
from typer.exceptions import TyperException

from crowdbench.cli import app
from crowdbench.study import reproduction

pytestmark = pytest.mark.usefixtures("study_folder")

STOPS = """
from pathlib import Path
import numpy as np
from crowdbench import Planner
from crowdbench.errors import Interrupted

class Stops(Planner):
    def plan(self, obs):
        if Path("stop").exists():
            raise Interrupted
        return np.zeros((len(obs), 2))

def planner():
    return Stops()
"""

TINY = """
[[tables]]
title = "First"
scenario = "circle_crossing_5"
cases = "6"
quick = "3"

[[tables.rows]]
label = "learned"
planner = "./mine.py"
weights = ["one", "two"]
reported = { success_rate = 0.9 }

[[tables.rows]]
label = "margin"
planner = "./mine.py"
weights = ["one", "two"]
options = { margin = 0.3 }

[[tables.claims]]
text = "A margin helps"
source = "Experiment 1"
row = "margin"
than = "learned"
measure = "success_rate"
kind = "difference"
bound = 0.0

[[tables]]
title = "Second"
scenario = "circle_crossing_5"
cases = "6"
quick = "3"

[[tables.rows]]
planner = "./stops.py"
"""


@pytest.fixture
def tiny(monkeypatch):
    Path("stops.py").write_text(STOPS)
    Path("tiny.toml").write_text(TINY)
    monkeypatch.setattr(reproduction, "FILE", Path("tiny.toml"))


def reproduce(*arguments):
    app(["reproduce", *arguments], standalone_mode=False)


def finished():
    """When each run was finished, by the name of its directory."""
    return {path.parent.name: path.stat().st_mtime_ns for path in Path("runs/reproduce").glob("[!.]*/result.json")}


def test_what_was_interrupted_goes_on_and_repeats_nothing(tiny, capsys):
    Path("stop").touch()
    with pytest.raises(SystemExit) as error:
        reproduce()
    assert error.value.code == 130
    told = capsys.readouterr()
    assert told.out == ""
    assert told.err.splitlines()[-1].endswith("goes on with the runs that are kept in runs/reproduce")
    before = finished()
    assert len(before) == 4
    Path("stop").unlink()
    reproduce()
    printed = capsys.readouterr()
    assert "run 1 of 1: stops on circle_crossing_5, cases test:0:6" in printed.err
    assert before.items() < finished().items()
    assert re.findall("^## .*", printed.out, re.MULTILINE) == ["## First", "## Second"]
    assert "| learned | 2 | 90 % |" in printed.out
    assert re.search("^Claims: [01] holds, [01] refuted, [01] undecided.$", printed.out, re.MULTILINE)
    # Once for all tables.
    assert printed.out.count("Figures are means over the networks") == 1
    reproduce("--json")
    found = json.loads(capsys.readouterr().out)
    assert found["quick"] is False
    assert [table["title"] for table in found["tables"]] == ["First", "Second"]
    (claim,) = found["tables"][0]["claims"]
    assert claim["verdict"] in ("holds", "refuted", "undecided")
    assert claim["weights"] == ["one", "two"]
    assert found["tables"][0]["rows"][0]["measured"]["success_rate"]["n"] == 12


def test_a_quick_look_at_one_table_says_that_it_is_one_and_runs_no_more(tiny, capsys):
    reproduce("--quick", "--table", "1")
    printed = capsys.readouterr().out
    assert printed.startswith("A quick look: ")
    assert "On circle_crossing_5, cases test:0:3." in printed
    assert "## Second" not in printed
    assert sorted("margin" in name for name in finished()) == [False, True]
    assert all("weights=one" in name for name in finished())


def test_there_are_four_tables_to_choose_from(tiny):
    with pytest.raises(TyperException, match="less than or equal to 4"):
        reproduce("--table", "5")


@pytest.fixture
def shipped():
    return reproduction.tables(None, quick=False)


def test_the_shipped_file_has_the_paper_s_tables_first(shipped):
    assert [table.spec.title[:8] for table in shipped[:4]] == [f"Table {n}:" for n in (1, 2, 3, 4)]
    assert {str(table.cases) for table in shipped} == {"test:0:500"}
    assert [table.rows[0].runs[0].replanning.every for table in shipped[:4]] == [1, 1, 8, 1]
    assert [len(table.rows) for table in shipped] == [6, 4, 5, 5, 3, 3, 3]
    assert [bool(table.spec.variant) for table in shipped] == [True] + [False] * 6
    reported = [{row.label: row.reported for row in table.rows if row.reported} for table in shipped]
    assert [len(rows) for rows in reported] == [6, 4, 5, 2, 0, 0, 0]
    assert reported[3]["sarl_sgan_kce"] == {
        "success_rate": 0.98, "navigation_time": 10.94, "max_velocity_change": 1.16,
    }  # fmt: skip


def test_in_a_quick_look_claims_compare_the_same_network(shipped):
    for table in shipped:
        networks = {row.label: row.networks for row in table.quick_look().rows}
        assert table.spec.claims
        for claim in table.spec.claims:
            assert networks[claim.row] == networks[claim.than]
