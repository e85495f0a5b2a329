import math
import re
from pathlib import Path

import pytest
from studies import MINE, SEEDS, episodes, leave, read, study

pytestmark = pytest.mark.usefixtures("study_folder")


def test_a_row_of_seeds_is_what_one_computes_by_hand(tmp_path):
    asked = read(SEEDS)
    (row,) = asked.tables[0].rows
    nan = math.nan
    leave(row.test[0], tmp_path, episodes([1] * 9 + [0], navigation_time=[10.0] * 8 + [19.0, nan]))
    leave(row.test[1], tmp_path, episodes([1] * 5 + [0] * 5, navigation_time=[12.0] * 5 + [nan] * 5))
    leave(row.variant[0], tmp_path, episodes([1] * 8 + [0] * 2))
    leave(row.variant[1], tmp_path, episodes([1] * 4 + [0] * 6))
    leave(row.validation, tmp_path, episodes([1] * 9 + [0] * 3, navigation_time=[9.5] * 9 + [nan] * 3))
    assert sorted(run.directory for run in asked.runs) == sorted(path.name for path in tmp_path.glob("mine-*"))
    text = asked.tables[0].fill(tmp_path).markdown()
    assert text.startswith("## Learned planners\n")
    header, _, line = [line for line in text.splitlines() if line.startswith("| ")]
    assert [cell.strip() for cell in header.strip("|").split("|")] == [
        "planner", "scenario", "seeds", "success", "time", "success, CrowdNav's rule",
        "shipped, val:0:12", "shipped, test:0:10", "reported",
    ]  # fmt: skip
    cells = [cell.strip() for cell in line.strip("|").split("|")]
    assert cells[:3] == ["mine", "circle_crossing_5", "2"]
    assert re.fullmatch(r"70\.0 % \(\d\d\.\d to \d+\.\d\)", cells[3])
    assert re.fullmatch(r"11\.50 s \(10\.00 to 1\d\.\d\d\)", cells[4])
    assert cells[5].startswith("60.0 % (")
    assert cells[6:] == ["75.0 %, 9.50 s", "90.0 %, 11.00 s", "99 %, 10.6 s"]
    assert "\n- mine on circle_crossing_5: one 90.0 %, two 50.0 %\n" in text
    assert r"\*" not in text


def test_the_variant_and_the_cases_are_what_is_run():
    runs = read(SEEDS).tables[0].rows[0]
    assert [str(one.cases) for one in (*runs.test, *runs.variant, runs.validation)] == ["test:0:10"] * 4 + ["val:0:12"]
    rules = [one.scenario.rules.collision for one in (*runs.test, *runs.variant, runs.validation)]
    assert rules == ["swept"] * 2 + ["crowdnav"] * 2 + ["swept"]
    weights = [one.about["options"]["weights"] for one in (*runs.test, *runs.variant, runs.validation)]
    assert weights == ["one", "two", "one", "two", "one"]


def test_a_table_of_seeds_may_have_no_variant(tmp_path):
    asked = read("".join(line for line in SEEDS.splitlines(True) if not line.startswith("variant")))
    assert len(asked.runs) == 3
    for each in asked.runs:
        leave(each, tmp_path, episodes([1] * each.cases.stop, navigation_time=[9.0] * each.cases.stop))
    header, _, line = [line for line in asked.tables[0].fill(tmp_path).markdown().splitlines() if line.startswith("|")]
    assert "success, " not in header
    assert line.count("|") == header.count("|")


def test_a_label_replan_every_and_privilege_are_shown():
    Path("mine.py").write_text(MINE.replace("return made", "made.privileged = True; return made"))
    rows = read(SEEDS + "replan_every = 8\n").tables[0].rows
    assert (rows[0].planner, rows[0].validation.replan_every) == ("mine (replan_every=8)", 8)
    assert rows[0].validation.directory.startswith("mine-circle_crossing_5-val-12-weights=one-replan_every=8-")
    study(SEEDS.replace("reported", 'label = "trained | alone"\nreported'), "--out", "there")
    text = next(iter(read(Path("tiny.toml").read_text()).tables)).fill(Path("there")).markdown()
    assert r"| trained \| alone * | circle_crossing_5 |" in text
    assert text.splitlines()[-1].startswith(r"\* sees")
