import math
import re

import pytest
from study_folders import NETWORKS, episodes, leave, read_page

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
