import math
import re
from pathlib import Path

import pytest
from study_folders import MINE, NETWORKS, episodes, leave, print_page, read_page

from crowdbench.metrics.summary import wilson
from crowdbench.runs.folder import run_directory

pytestmark = pytest.mark.usefixtures("study_folder")


def test_a_row_of_networks_is_what_one_computes_by_hand(tmp_path):
    asked = read_page(NETWORKS)
    (row,) = asked.tables[0].rows
    nan = math.nan
    leave(row.runs[0], tmp_path, episodes([1] * 9 + [0], navigation_time=[10.0] * 8 + [19.0, nan]))
    leave(row.runs[1], tmp_path, episodes([1] * 5 + [0] * 5, navigation_time=[12.0] * 5 + [nan] * 5))
    leave(row.variant[0], tmp_path, episodes([1] * 8 + [0] * 2))
    leave(row.variant[1], tmp_path, episodes([1] * 4 + [0] * 6))
    leave(row.second_reading, tmp_path, episodes([1] * 9 + [0] * 3, navigation_time=[9.5] * 9 + [nan] * 3))
    assert sorted(run_directory(run, tmp_path).name for run in asked.runs) == sorted(
        path.name for path in tmp_path.glob("mine-*")
    )
    text = asked.tables[0].fill(tmp_path).markdown()
    assert text.startswith("## Learned planners\n\nOn circle_crossing_5, cases test:0:10.\n")
    header, _, line = [line for line in text.splitlines() if line.startswith("| ")]
    assert [cell.strip() for cell in header.strip("|").split("|")] == [
        "planner", "networks", "reported success, %", "success, %", "reported time, s", "time, s",
        "success, %, CrowdNav's rule",
    ]  # fmt: skip
    cells = [cell.strip() for cell in line.strip("|").split("|")]
    assert cells[:3] == ["mine", "2", "99"]
    assert cells[3] == "70.0 (0.0 to 100.0)"
    assert cells[4] == "10.6"
    assert re.fullmatch(r"11\.500 \(\d\.\d{3} to 1\d\.\d{3}\)", cells[5])
    assert cells[6].startswith("60.0 (")
    *_, heading, each, again_heading, again = [line for line in text.splitlines() if line]
    assert (heading, each) == ("Success of each network:", "- mine: one 90.0 %, two 50.0 %")
    assert again_heading.startswith("Second reading")
    second, first = again.removeprefix("- mine with one: ").split("; ")
    assert re.fullmatch(r"75\.0 % \(.*\) in 9\.500 s \(.*\) on test:12:24", second)
    assert re.fullmatch(r"90\.0 % \(.*\) in 11\.000 s \(.*\) on test:0:10", first)
    assert r"\*" not in asked.markdown(asked.fill(tmp_path), "study tiny.toml")


def test_the_variant_and_the_cases_are_what_is_run():
    runs = read_page(NETWORKS).tables[0].rows[0].all_runs
    assert [str(one.spec.cases) for one in runs] == ["test:0:10"] * 4 + ["test:12:24"]
    assert [one.scenario.rules.collision for one in runs] == ["swept"] * 2 + ["crowdnav"] * 2 + ["swept"]
    assert [one.spec.options["weights"] for one in runs] == ["one", "two", "one", "two", "one"]


def test_the_variant_may_be_run_by_the_first_network_alone_and_the_heading_says_so(tmp_path):
    asked = read_page(NETWORKS.replace('" } }', '" }, networks = "first" }'))
    (row,) = asked.tables[0].rows
    assert [one.spec.options["weights"] for one in row.all_runs] == ["one", "two", "one", "one"]
    for each in asked.runs:
        success = [1] * len(each.spec.cases) if each not in row.variant else [1] * 8 + [0] * 2
        leave(each, tmp_path, episodes(success, navigation_time=[9.0] * len(each.spec.cases)))
    found = asked.tables[0].fill(tmp_path)
    assert found.rows[0].variant_success_rate == wilson(episodes([1] * 8 + [0] * 2).columns["success_rate"])
    assert "| success, %, CrowdNav's rule (first network) |" in found.markdown()


def test_a_table_may_have_no_variant_and_no_second_reading(tmp_path):
    asked = read_page("".join(line for line in NETWORKS.splitlines(True) if not line.startswith(("variant", "second"))))
    assert len(asked.runs) == 2
    for each in asked.runs:
        leave(each, tmp_path, episodes([1] * each.spec.cases.stop, navigation_time=[9.0] * each.spec.cases.stop))
    text = asked.tables[0].fill(tmp_path).markdown()
    header, _, line = [line for line in text.splitlines() if line.startswith("|")]
    assert header == "| planner | networks | reported success, % | success, % | reported time, s | time, s |"
    assert line.count("|") == header.count("|")
    assert "Second reading" not in text


@pytest.mark.slow
def test_a_label_replan_every_options_and_privilege_are_shown():
    Path("mine.py").write_text(MINE.replace("return made", "made.privileged = True; return made"))
    every = NETWORKS.replace("cases", "replan_every = 8\ncases", 1)
    (row,) = read_page(every).tables[0].rows
    assert (row.label, row.second_reading.spec.replanning.every) == ("mine", 8)
    assert run_directory(row.second_reading, Path()).name.startswith(
        "mine-circle_crossing_5-12-24-weights=one-replan_every=8-look_first=8-"
    )
    (row,) = read_page(every + "options = { margin = 0.3 }").tables[0].rows
    assert row.label == "mine (margin=0.3)"
    print_page(NETWORKS.replace("planner =", 'label = "trained | alone"\nplanner ='), "--out", "there")
    again = read_page(Path("tiny.toml").read_text())
    text = again.markdown(again.fill(Path("there")), "study tiny.toml")
    assert r"| trained \| alone * | 2 |" in text
    assert text.splitlines()[-1].startswith(r"\* is privileged")


def test_an_option_may_be_a_table():
    Path("mine.py").write_text(MINE.replace("margin=0.0", "margin=0.0, limits=None"))
    (row,) = read_page(NETWORKS + "options = { limits = { speed = 1.0, turn = false } }").tables[0].rows
    assert row.runs[0].spec.options == {"limits": {"speed": 1.0, "turn": False}, "weights": "one"}
    assert row.label == "mine (limits={speed=1.0, turn=false})"
