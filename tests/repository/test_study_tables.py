import numpy as np
import pytest
from study_folders import TABLE, cells, fill, read_page, table

from crowdbench.metrics.summary import bootstrap, wilson

pytestmark = pytest.mark.usefixtures("study_folder")


def test_reported_stands_beside_measured(tmp_path):
    one, two = table([1] * 18 + [0] * 2), table([1] * 19 + [0], time=np.linspace(9.0, 11.0, 20))
    found = fill(read_page(TABLE), tmp_path, mine=[one, two], other=[one, two], orca=[two])
    text = found.markdown()
    assert text.startswith("## Beside\n\nOn circle_crossing_5, replan_every=2, look_first=8, cases test:0:20.\n")
    header, mine, other, orca = cells(text)
    assert header == [
        "planner", "networks", "reported success, %", "success, %", "reported time, s", "time, s",
        "largest change of velocity, m/s", "jerk, m/s^3",
    ]  # fmt: skip
    assert mine[:3] == ["mine", "2", "97.2"]
    assert mine[3].startswith("92.5 (")
    assert mine[4] == "12.58"
    assert mine[6:] == ["1.000 (1.000 to 1.000)", "5.000 (5.000 to 5.000)"]
    assert (other[2], other[4]) == ("", "")
    assert orca[:3] == ["orca", "", ""]
    alone = found.rows[2].measured
    assert alone["success_rate"] == wilson(two.columns["success_rate"])
    # Student's interval, and a bootstrap's: of a mean over 19 cases they differ a little.
    time = bootstrap(two.columns["navigation_time"], np.ones(20))
    assert alone["navigation_time"].mean == pytest.approx(time.mean)
    assert alone["navigation_time"].low == pytest.approx(time.low, abs=0.05)


@pytest.mark.parametrize("solves", [True, False])
def test_networks_that_all_solve_every_case_or_none_are_no_more_certain_than_one(tmp_path, solves):
    alike = table([solves] * 20)
    found = fill(
        read_page(TABLE), tmp_path, mine=[alike] * 2, other=[alike, table([solves] * 19 + [not solves])], orca=[alike]
    )
    mine, other, orca = (row.measured["success_rate"] for row in found.rows)
    assert mine == orca == wilson(alike.columns["success_rate"])
    assert other.n == 40


def test_failures_count_for_success_alone(tmp_path):
    hasty = table([1] * 10 + [0] * 10, change=[1.0] * 10 + [9.0] * 10, jerk=[2.0] * 10 + [9.0] * 10)
    found = fill(read_page(TABLE), tmp_path, mine=[hasty] * 2, other=[hasty] * 2, orca=[hasty])
    for row in found.rows:
        assert [row.measured[name].mean for name in ("max_velocity_change", "jerk")] == [1.0, 2.0]
        assert row.measured["success_rate"].mean == 0.5
