"""Whether the order of planners holds elsewhere: the test, its reliability and power, and the study's page."""

import re
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from crowdbench.cli.app import build_script
from crowdbench.utils.toml import Location, parse_table
from studies.orders import Cases, agreement, decided_signs, draw_pairs, resample_means
from studies.transfer.permutation import p_value, reliability, share
from studies.transfer.power import power
from studies.transfer.run import transfer
from studies.transfer.table import FilledRankings, RankingsSpec

STUDY = """
[[rankings]]
title = "Order"
cases = "test:6"
suite = ["circle_crossing_5"]
planners = ["straight", "orca", "orca_margin", "social_force"]

[rankings.worlds.near]
track = "perfect"
scenarios = ["circle_crossing_5_visible"]

[rankings.worlds.tracked]
track = "realistic"
scenarios = ["square_crossing_5"]
pedestrians = "power_law_people"
cases = "test:8"
"""

SKILL = np.linspace(0.2, 0.8, 8)


def scenario(seed, skill, source="a", cases=100, blocks=None):
    """Return normal scores of planners around their skill."""
    value = np.random.default_rng(seed).normal(skill[:, None], 0.2, (len(skill), cases))
    return Cases(source, value, np.arange(cases) if blocks is None else blocks)


def test_planners_that_are_drawn_twice_make_no_pairs_with_themselves():
    times = draw_pairs(3)
    assert times[0].tolist() == [1.0] * 3
    # Three planners are drawn three times.
    assert {tuple(row) for row in times[1:].tolist()} == {(1, 1, 1), (2, 0, 0), (0, 2, 0), (0, 0, 2), (0, 0, 0)}
    assert times[1:].mean() == pytest.approx(6 / 9, abs=0.05)


def test_recordings_in_common_have_the_same_hours_drawn():
    blocks = np.repeat(np.arange(6), 10)
    hours = blocks[None].astype(float)  # a score that says which hours were drawn
    one, same, other = (Cases(source, hours, blocks) for source in ("eth", "eth", "hotel"))
    assert one.resample()[0, 0] == blocks.mean()
    assert (one.resample() == same.resample()).all()
    assert (one.resample() != other.resample()).mean() > 0.5
    halves = one.halves(50)
    assert (halves.sum(axis=0) == 2 * blocks.mean()).all()
    assert set(np.unique(halves * 3)) <= set(range(16))  # sums of three whole hours
    assert len(np.unique(halves)) > 3


def test_pairs_agree_only_where_both_decide():
    good = resample_means([scenario(0, np.array([0.9, 0.5, 0.1]))])
    noise = resample_means([scenario(1, np.array([0.5, 0.5, 0.5]), "b")])
    assert agreement(good, good) == (3, 3)
    assert agreement(good, -good) == (0, 3)
    assert agreement(good, noise)[1] < 3


def test_the_share_that_agrees_has_an_interval_over_planners_and_cases():
    suite, mixed = (resample_means([scenario(0, skill)]) for skill in (SKILL, SKILL[[7, 1, 2, 3, 4, 5, 6, 0]]))
    same = share(suite, suite)
    assert (same.mean, same.low, same.high) == (1.0, 1.0, 1.0)
    assert same.n == np.count_nonzero(decided_signs(suite)[0])
    found = share(suite, mixed)
    assert found.low < found.mean < found.high
    nothing = share(suite, resample_means([scenario(1, np.full(8, 0.5), cases=2)]) * 0.0)
    assert nothing.n == 0
    assert np.isnan(nothing.mean)


@pytest.mark.nightly
@pytest.mark.parametrize("rho", [0.3, 0.9])
def test_intervals_of_the_share_contain_the_mean_of_studies(rho):
    draws, found = np.random.default_rng(5), []
    for _ in range(200):
        skills = draws.multivariate_normal([0.5, 0.5], 0.01 * np.array([[1.0, rho], [rho, 1.0]]), size=11).T
        suite, world = (
            resample_means([Cases(source, draws.normal(skill[:, None], 0.3, (11, 100)), np.arange(100))])
            for source, skill in zip("ab", skills, strict=True)
        )
        found.append(share(suite, world))
    true = np.mean([each.mean for each in found])
    assert np.mean([each.low <= true <= each.high for each in found]) >= 0.93


def test_perfect_agreement_has_the_least_p_and_opposite_orders_the_largest():
    signs = decided_signs(resample_means([scenario(0, SKILL)]))[0]
    assert p_value(signs, signs, np.random.default_rng(0), 2000) == pytest.approx(1 / 2001, abs=1e-3)
    assert p_value(signs, -signs, np.random.default_rng(0), 2000) > 0.99
    assert p_value(signs, 0.0 * signs, np.random.default_rng(0), 2000) == 1.0


def test_independent_orders_have_uniform_p():
    draws = np.random.default_rng(3)
    one, other = np.triu_indices(8, 1)

    def signs():
        skill = draws.permutation(8)
        return np.where(np.abs(skill[one] - skill[other]) > 1, np.sign(skill[one] - skill[other]), 0.0)

    p = np.array([p_value(signs(), signs(), draws, 200) for _ in range(400)])
    for level in (0.1, 0.25, 0.5, 0.75):
        assert (p <= level).mean() == pytest.approx(level, abs=0.07)


def test_signal_is_reliable_noise_is_not_and_more_cases_are_better():
    assert reliability([scenario(0, SKILL)]) > 0.95
    assert abs(np.mean([reliability([scenario(seed, np.full(8, 0.5))]) for seed in range(8)])) < 0.5
    weak = 0.5 + 0.1 * (SKILL - 0.5)
    few, many = (np.mean([reliability([scenario(s, weak, cases=n)]) for s in range(5)]) for n in (20, 2000))
    assert few < 0.7 < many


def test_the_reliability_is_that_of_all_cases():
    """Spearman and Brown step the correlation of halves up to that of two whole sets of cases."""
    weak = 0.5 + 0.15 * (SKILL - 0.5)
    ranks = [
        np.argsort(np.argsort([scenario(s, weak).value.mean(axis=1) for s in seeds]))
        for seeds in (range(200), range(200, 400))
    ]
    true = np.mean([np.corrcoef(a, b)[0, 1] for a, b in zip(*ranks, strict=True)])
    assert np.mean([reliability([scenario(seed, weak)]) for seed in range(60)]) == pytest.approx(true, abs=0.06)


def test_blocks_of_time_are_divided_together():
    """Cases of one hour repeat it, so that cases alone would seem reliable."""
    hours = np.random.default_rng(0).normal(size=(8, 6))
    value, blocks = np.repeat(hours, 20, axis=1), np.repeat(np.arange(6), 20)
    together, apart = (reliability([Cases("a", value, each)]) for each in (blocks, np.arange(120)))
    assert apart > 0.8
    assert together < 0.6


def test_power_grows_with_the_correlation_and_with_planners_and_is_small_without_any():
    cases = [900, 300, 300]
    found = [power(correlation, 10, cases, 60) for correlation in (0.0, 0.5, 0.9)]
    assert found[0] <= 0.1
    assert found == sorted(found)
    assert found[2] > 0.8
    assert power(0.7, 6, cases, 60) < power(0.7, 14, cases, 60)


def compare(**worlds):
    """Compare a suite of skilled planners with worlds of these cases."""
    table = {"scenarios": ["x"], "track": "perfect"}
    planners = [f"p{number}" for number in range(len(SKILL))]
    content = {"title": "Order", "cases": "test:6", "suite": ["y"], "planners": planners}
    spec = parse_table(RankingsSpec, {**content, "worlds": dict.fromkeys(worlds, table)}, Location("order.toml"))
    cases = {"suite, perfect": [scenario(0, SKILL, "y")], **{name: [each] for name, each in worlds.items()}}
    return FilledRankings.of(spec, planners, cases, "Power: none.")


def test_the_verdict_counts_tested_worlds_alone_and_corrects_by_holm():
    found = compare(
        like=scenario(1, SKILL, "b"),
        other=scenario(2, SKILL[[3, 6, 0, 5, 2, 7, 4, 1]], "c"),
        noisy=scenario(3, np.full(8, 0.5), "d", cases=4),
    )
    like, other, noisy = found.worlds
    assert [world.verdict for world in found.worlds] == ["holds", "not shown", "undecided"]
    assert noisy.reliability < 0.7
    assert (noisy.p, noisy.share, noisy.corrected) == (None, None, None)
    assert like.corrected == pytest.approx(2 * like.p)  # two tests, not three
    assert other.corrected == pytest.approx(other.p)
    assert like.agree + like.disagree + like.undecided == 28
    assert like.disagree == 0
    assert "holds in 1 of 3 worlds: like.** Not shown: other. Undecided because of a reliability below 0.7: noisy." in (
        found.verdict
    )
    assert noisy.cells()[3:] == ["", "", "", "", "undecided"]
    assert found.planners == [f"p{number}" for number in reversed(range(8))]


def test_an_unreliable_suite_leaves_every_world_undecided(monkeypatch):
    monkeypatch.setattr("studies.transfer.table.RELIABLE", 1.01)
    (world,) = compare(like=scenario(1, SKILL, "b")).worlds
    assert world.verdict == "undecided"


@pytest.mark.slow
def test_the_study_prints_its_reliability_its_power_and_its_verdict(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("order.toml").write_text(STUDY)

    def printed(*options):
        result = CliRunner().invoke(build_script(transfer), ["--file", "order.toml", *options])
        assert result.exit_code == 0, result.output
        return result.stdout

    alone, page = printed("--reliability"), printed()
    assert "| tracked |" in alone
    assert "agree" not in alone
    for name in ("suite, perfect", "suite, realistic", "near", "tracked"):
        (value,) = re.findall(rf"\| {name} \| (\S+) \|", alone)
        assert value in page
    assert "The suite's order holds in" in page
    assert "Cases test:0:6, test:0:8 in tracked." in page
    (said,) = re.findall("Power, .*", printed("--power"))
    assert said in page
