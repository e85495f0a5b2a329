"""The study of headroom: scenarios as they are and at other levels, with the contacts that were nobody's fault."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from crowdbench.cli.app import build_script
from studies.suite.headroom import headroom

STUDY = """
cases = "val:30"
planners = ["straight", "orca"]
scenarios = ["circle_crossing_20"]
[levels."pedestrians.number"]
circle_crossing_20 = [2]
"""


@pytest.mark.slow
def test_a_scenario_has_a_row_as_it_is_and_one_for_each_level(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("few.toml").write_text(STUDY)
    result = CliRunner().invoke(build_script(headroom), ["--file", "few.toml", "--format", "json"])
    assert result.exit_code == 0, result.output
    dense, sparse = json.loads(result.stdout)
    assert (dense["level"], sparse["level"]) == ({}, {"pedestrians.number": 2})
    assert sparse["success_rate"][1] > dense["success_rate"][1]
    # `straight` does not time out, and is struck by some of those who do not see it.
    ends = [dense[name][0] for name in ("success_rate", "at_fault_rate", "struck_rate")]
    assert sum(ends) == pytest.approx(100.0)
    assert ends[2] > 0.0
    assert dense["struck_noticed_rate"] == [0.0, 0.0]
