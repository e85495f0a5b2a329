"""The study of reactions: people of each type, and how far their orders of planners agree."""

from pathlib import Path

import numpy as np
import pytest
from scipy.stats import kendalltau
from typer.testing import CliRunner

from crowdbench.cli.app import build_script
from studies.orders import Cases, draw_pairs, resample_means
from studies.reactions.run import reactions
from studies.reactions.tau import estimate_tau, kendall

STUDY = """
description = "Few."
cases = "test:2"
scenarios = ["groups_12"]
planners = ["straight", "orca", "orca_margin"]
"""


def test_tau_is_that_of_scipy_where_nobody_ties():
    a, b = np.random.default_rng(0).random((2, 12))
    assert kendall(a, b, np.ones(66)) == pytest.approx(kendalltau(a, b).statistic)
    assert kendall(a, np.zeros(12), np.ones(66)) == 0.0


@pytest.mark.nightly
@pytest.mark.parametrize("rho", [0.5, 0.9])
def test_intervals_of_tau_contain_the_true_one(rho):
    draws, times, covered = np.random.default_rng(5), draw_pairs(12), 0
    true, covariance = 2.0 / np.pi * np.arcsin(rho), np.array([[1.0, rho], [rho, 1.0]])
    for _ in range(200):
        skills = draws.multivariate_normal([0.0, 0.0], covariance, size=12).T
        means = [
            resample_means([Cases(source, draws.normal(skill[:, None], 0.5, (12, 100)), np.arange(100))])
            for source, skill in zip("ab", skills, strict=True)
        ]
        tau = estimate_tau(kendall(*means, times))
        covered += tau.low <= true <= tau.high
    assert covered / 200 >= 0.92


@pytest.mark.slow
def test_people_of_each_type_have_a_column_and_each_pair_of_types_a_tau(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("few.toml").write_text(STUDY)
    result = CliRunner().invoke(build_script(reactions), ["--file", "few.toml", "--cases", "val:12"])
    assert result.exit_code == 0, result.output
    lines = result.stdout.splitlines()
    table = lines.index("| planner | avoid | ignore | yield late | are attracted |")
    rates = {
        cells[1].strip(): [float(cell.split()[0]) for cell in cells[2:-1]]
        for cells in (line.split("|") for line in lines[table + 2 : table + 5])
    }
    assert set(rates) == {"straight", "orca", "orca_margin"}
    # `straight` never slows down: it lives on people who avoid it.
    assert rates["straight"][0] > rates["straight"][1]
    assert sum(line.count(" to ") == 1 and " of " in line for line in lines if line.startswith("| ")) == 6
    assert "Cases val:0:12 of `groups_12`." in result.stdout
