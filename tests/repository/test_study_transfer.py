"""Whether the order of planners holds elsewhere: Kendall's tau, its interval, and the study's table."""

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import kendalltau
from typer.testing import CliRunner

from crowdbench.cli.app import build_script
from studies.transfer.kendall import Cases, agreement, draw_families, kendall
from studies.transfer.power import RESAMPLES, draw_rates, power
from studies.transfer.run import transfer

STUDY = """
[[rankings]]
title = "Order"
cases = "test:6"
suite = ["circle_crossing_5"]
alone = "square_crossing_5"
alone_cases = "test:8"

[rankings.families]
floor = ["straight"]
orca = ["orca", "orca_margin"]
other = ["social_force"]

[rankings.worlds]
near = ["circle_crossing_5_visible"]
"""


def scenario(draws, skill, source, cases=60, blocks=None):
    """Outcomes of planners that succeed as often as they are skilled."""
    success = draws.random((len(skill), cases)) < skill[:, None]
    return Cases(source, success.astype(float), np.arange(cases) if blocks is None else blocks)


def test_tau_is_that_of_scipy_where_nobody_ties():
    draws = np.random.default_rng(0)
    a, b = draws.random((2, 12))
    assert kendall(a, b, np.ones(66)) == pytest.approx(kendalltau(a, b).statistic)
    assert kendall(a, np.zeros(12), np.ones(66)) == 0.0


def test_families_that_are_drawn_twice_make_no_pairs_with_themselves():
    times = draw_families(np.array([0, 0, 1, 2]))
    assert times[0].tolist() == [1.0] * 6
    # Pairs (0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3): three families are drawn three times.
    assert {tuple(row) for row in times[1:][:, [0, 1, 3]].tolist()} <= {
        (n, n * m, n * m) for n in range(4) for m in range(4 - n)
    }
    assert times[:, 0].mean() == pytest.approx(1.0, abs=0.1)


def test_recordings_in_common_have_the_same_hours_drawn():
    blocks = np.repeat(np.arange(6), 10)
    hours = blocks[None].astype(float)  # a rate that says which hours were drawn
    one, same, other = (Cases(source, hours, blocks).resample()[:, 0] for source in ("eth", "eth", "hotel"))
    assert one[0] == blocks.mean()
    assert (one == same).all()
    assert (one != other).mean() > 0.5


def test_pairs_agree_only_where_both_decide():
    good = scenario(np.random.default_rng(0), np.array([0.95, 0.5, 0.05]), "a").resample()
    noise = scenario(np.random.default_rng(0), np.array([0.5, 0.5, 0.5]), "b").resample()
    assert agreement(good, good) == (3, 3)
    assert agreement(good, -good) == (0, 3)
    assert agreement(good, noise)[1] < 3


@pytest.mark.slow
def test_power_grows_with_tau_and_with_the_planners():
    cases, criterion, studies = [900, 300, 300], 0.3, 30
    few, many = np.arange(6), np.arange(20)
    taus = [power(tau, many, cases, criterion, studies) for tau in (0.3, 0.6, 0.95)]
    assert taus == sorted(taus)
    assert taus[0] < 0.2
    assert taus[2] > 0.9
    assert power(0.6, few, cases, criterion, studies) < taus[1]


@pytest.mark.slow
def test_a_true_tau_of_the_criterion_meets_it_as_rarely_as_the_bound_says():
    assert power(0.3, np.arange(11), [1500, 500, 500], 0.3) <= 0.05


@pytest.mark.slow
def test_intervals_of_tau_and_of_a_difference_of_taus_contain_the_true_ones():
    draws, times, rhos = np.random.default_rng(5), draw_families(np.arange(12))[: 1 + RESAMPLES], (0.9, 0.5)
    true, covered = 2.0 / np.pi * np.arcsin(rhos), np.zeros(3)
    studies = 200
    for _ in range(studies):
        skill = draws.normal(size=12)
        others = [rho * skill + np.sqrt(1.0 - rho**2) * draws.normal(size=12) for rho in rhos]
        world, *rates = (draw_rates(draws, each, 1500) for each in (skill, *others))
        suite, alone = (kendall(each, world, times) for each in rates)
        for number, (taus, truth) in enumerate(
            zip((suite, alone, suite - alone), (*true, true[0] - true[1]), strict=True)
        ):
            low, high = np.nanquantile(taus[1:], [0.025, 0.975])
            covered[number] += low <= truth <= high
    print(f"coverage of tau, of the other tau, and of their difference: {covered / studies}")
    assert (covered / studies >= 0.93).all()


@pytest.mark.slow
def test_the_study_prints_its_verdict(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("order.toml").write_text(STUDY)
    command = ["--file", "order.toml"]
    printed = CliRunner().invoke(build_script(transfer), command).output
    assert "The criterion was a lower bound above 0.3" in printed
    header = "| world | tau | decided pairs that agree | square_crossing_5 (8 cases) for the suite |"
    assert header in printed
    assert "Power: " in printed
    (said,) = re.findall("Power: .*", CliRunner().invoke(build_script(transfer), [*command, "--power"]).output)
    assert said in printed
