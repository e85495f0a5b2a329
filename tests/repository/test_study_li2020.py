import json
import re
from pathlib import Path

import pytest

from crowdbench.cli.app import build_script
from studies.li2020 import table
from studies.li2020.run import reproduce as command

pytestmark = pytest.mark.usefixtures("study_folder")

STOPS = """
from pathlib import Path
import numpy as np
from crowdbench import Planner
from crowdbench.utils.errors import Interrupted

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
title = "Table 1: first"
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
title = "Table 2: second"
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
    monkeypatch.setattr(table, "FILE", Path("tiny.toml"))


def reproduce(*arguments):
    build_script(command)(arguments, standalone_mode=False)


def finished():
    """When each run was finished, by the name of its directory."""
    return {path.parent.name: path.stat().st_mtime_ns for path in Path("runs/li2020").glob("[!.]*/result.json")}


@pytest.mark.slow
def test_what_was_interrupted_goes_on_and_repeats_nothing(tiny, capsys):
    Path("stop").touch()
    with pytest.raises(SystemExit) as error:
        reproduce()
    assert error.value.code == 130
    told = capsys.readouterr()
    assert told.out == ""
    assert told.err.splitlines()[-1].endswith("goes on with the runs that are kept in runs/li2020")
    before = finished()
    assert len(before) == 4
    Path("stop").unlink()
    reproduce()
    printed = capsys.readouterr()
    assert "run 1 of 1: stops on circle_crossing_5, cases test:0:6" in printed.err
    assert before.items() < finished().items()
    assert re.findall("^## .*", printed.out, re.MULTILINE) == ["## Table 1: first", "## Table 2: second"]
    assert "| learned | 2 | 90 |" in printed.out
    assert re.search(
        "^Claims of the paper: [01] hold, [01] are refuted, [01] are undecided, 0 have no verdict .one network..$",
        printed.out,
        re.MULTILINE,
    )
    # Once for all tables.
    assert printed.out.count("Figures are means over the networks") == 1
    reproduce("--format", "json")
    found = json.loads(capsys.readouterr().out)
    assert found["quick"] is False
    assert [table["title"] for table in found["tables"]] == ["Table 1: first", "Table 2: second"]
    (claim,) = found["tables"][0]["claims"]
    assert claim["verdict"] in ("holds", "refuted", "undecided")
    assert claim["networks"] == [2, 2]
    assert found["tables"][0]["rows"][0]["measured"]["success_rate"]["n"] == 12


def test_a_quick_look_at_one_table_says_that_it_is_one_and_runs_no_more(tiny, capsys):
    reproduce("--quick", "--table", "1")
    printed = capsys.readouterr().out
    first, _, second, *_ = printed.splitlines()
    assert first.startswith("Printed by `python studies/li2020/run.py --table 1 --quick`.")
    assert second.startswith("A quick look: ")
    assert "Claims of the paper: 0 hold, 0 are refuted, 0 are undecided, 1 have no verdict" in printed
    assert "On circle_crossing_5, cases test:0:3." in printed
    assert "## Table 2" not in printed
    assert sorted("margin" in name for name in finished()) == [False, True]
    assert all("weights=one" in name for name in finished())
