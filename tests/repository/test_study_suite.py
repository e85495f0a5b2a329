"""The study of the suite: levels of its scenarios, ranks in both tracks of sensing, and the conditions on it."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from crowdbench import Cases, load_planner, load_scenario, read_suite, rollout
from crowdbench.cli.app import build_script
from crowdbench.metrics import Pair
from crowdbench.metrics.registry import METRICS
from studies.pages import read_file
from studies.suite import checks
from studies.suite.checks import AttackSpec, check_attack
from studies.suite.conditions import FILE as CONDITIONS
from studies.suite.conditions import ConditionsSpec
from studies.suite.levels import FILE, LevelsSpec, levels
from studies.suite.moving import t_close_moving
from studies.suite.rank import Block, order_texts, rank_grid
from studies.suite.run import FILE as ORDER
from studies.suite.run import SuiteSpec, order_grid, parts_grid, score_grid, suite
from studies.suite.standing import Standing

FEW = """
description = "Few."
[[planners]]
planner = "straight"
cases = "val:2"
[[planners]]
planner = "orca"
cases = "val:1"
[levels]
street_8 = [0, 8]
"""

NAMES = ["circle_20", "door_10"]


def standing(mean, *, faults=0, networks=1, cases=60, seed=0, spread=0.05):
    """A planner in two scenarios, whose first cases are collisions at fault."""
    draws = np.random.default_rng(seed)
    score = np.clip(mean + draws.normal(0.0, spread, (networks, 2, cases)), 0.01, 1.0)
    failed = np.broadcast_to(np.arange(cases) < faults, score.shape)
    time = np.where(failed, np.nan, 8.0)
    close = np.where(failed, np.nan, 10.0 / score - 8.0)
    zero = np.where(failed, 0.0, score)
    ones = np.ones(score.shape)
    return Standing(
        score=zero,
        success=1.0 - failed,
        at_fault=failed.astype(float),
        timeout=0.0 * ones,
        t_empty=10.0 * ones,
        time=time + 2.0,
        close=close - 2.0,
        close_moving=0.5 * (close - 2.0),
    )


@pytest.mark.slow
def test_levels_have_the_scores_of_planners_and_their_spread(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("few.toml").write_text(FEW)
    result = CliRunner().invoke(build_script(levels), ["--file", "few.toml", "--format", "json"])
    assert result.exit_code == 0, result.output
    empty, full = json.loads(result.stdout)
    assert (empty["scenario"], empty["people"], full["people"]) == ("street_8", 0, 8)
    assert empty["scores"] == pytest.approx([1.0, 1.0], abs=0.05)
    assert full["scores"] != empty["scores"]


def test_every_ranked_scenario_has_levels_and_its_own_level_is_among_them():
    spec = read_file(FILE, LevelsSpec)
    assert sorted(spec.levels) == sorted(read_suite().ranked)
    assert [name for name, numbers in spec.levels.items() if int(name.rpartition("_")[2]) not in numbers] == []


def test_at_least_ten_planners_have_a_place_on_the_earlier_suite():
    spec = read_file(ORDER, SuiteSpec)
    assert len({each.name for each in spec.planners} & set(spec.earlier)) >= 10


def test_the_order_shows_places_and_the_loss_between_tracks():
    tracks = {
        "perfect": {"a": standing(0.4), "b": standing(0.6)},
        "realistic": {"a": standing(0.35), "b": standing(0.3)},
    }
    grid = order_grid(tracks, {"a": 70.0, "b": 60.0})
    assert [row[:2] for row in grid.rows] == [["b", "2: 60.0"], ["a", "1: 70.0"]]
    assert grid.rows[0][2].startswith("1: 0.6")
    assert grid.rows[0][3].startswith("2: 0.3")
    scores = score_grid("realistic", tracks["realistic"], tracks["realistic"], NAMES)
    assert [row[0] for row in scores.rows] == ["a", "b"]


def test_parts_of_the_score_are_shares_of_the_least_time():
    grid = parts_grid("perfect", {"a": standing(0.5, faults=15, spread=0.0)})
    assert grid.rows == [["a", "75", "25.0", "0.0", "1.00", "1.00"]]


def test_planners_at_fault_are_ranked_below_all_others():
    standings = {"fair": standing(0.5), "rude": standing(0.8, faults=9), "slow": standing(0.3)}
    grid = rank_grid("Ranks", standings, {}, "")
    assert [row[:3] for row in grid.rows] == [["A", "fair", "1"], ["A", "slow", "2"], ["B", "rude", "1"]]
    assert grid.rows[2][5].startswith("15.0 (up to 22")


def test_an_order_is_claimed_only_where_both_crowds_decide_it():
    among = {"a": standing(0.5, seed=1), "b": standing(0.3, seed=2)}
    others = {"a": standing(0.4, seed=3), "b": standing(0.4, seed=3)}
    block = Block.of(among, others)
    assert [each.is_sure for each in block.pairs] == [True]
    assert block.claimed == []
    assert [str(each["a"]) for each in block.ranks()] == ["1", "1 to 2", "1 to 2"]
    assert isinstance(Block.of(among, among).claimed[0], Pair)


def test_other_prices_of_closeness_change_scores_as_they_say():
    one = standing(0.5, faults=6)
    np.testing.assert_allclose(one.priced(), one.score)
    assert (one.priced(2.0) <= one.score).all()
    assert one.priced(moving=True).mean() > one.score.mean()
    assert (one.priced(0.0)[one.success > 0.0] == 1.0).all()
    close, slow = standing(0.5), standing(0.5)
    slow = replace(slow, time=slow.time + slow.close, close=0.0 * slow.close)
    assert "2 of 2" in order_texts({"slow": slow, "close": close})[0]


def test_seconds_close_do_not_count_while_the_vehicle_stands():
    trace = rollout(load_planner("orca"), load_scenario("circle_20"), Cases("val", 0, 6))
    close, moving = METRICS["t_close"](trace), t_close_moving(trace)
    assert np.nanmax(close) > 0.0
    np.testing.assert_array_equal(close, moving)  # it never stands there
    trace.position[:, :, 0] = trace.position[:, :1, 0]
    assert not np.nansum(t_close_moving(trace)) > 0.0


def checked(name, standings):
    return getattr(checks, f"check_{name}")(standings, NAMES).holds


def test_each_condition_can_hold_and_fail():
    far = {str(k): standing(0.2 + 0.1 * k, seed=k) for k in range(5)}
    near = {str(k): standing(0.5, seed=k, spread=0.2) for k in range(5)}
    assert checked("best", far)
    assert not checked("best", far | {"top": standing(0.95, spread=0.001)})
    assert (checked("decided", far), checked("decided", near)) == (True, False)
    assert (checked("reliability", far), checked("reliability", near)) == (True, False)
    assert not checked("correlations", far)  # both scenarios order planners alike
    assert checked("straight", far | {"straight": standing(0.1)})
    assert not checked("straight", far | {"straight": standing(0.9)})


@pytest.mark.parametrize(("bound", "least", "holds"), [(False, 0.1, True), (True, 0.1, False), (True, 0.08, True)])
def test_an_attack_must_be_clearly_below_an_honest_planner(bound, least, holds):
    standings = {"honest": standing(0.5, seed=1), "attack": standing(0.395, seed=2)}
    spec = AttackSpec(planner="attack", below="best", least=least, bound=bound)
    assert check_attack(spec, {"honest": standings["honest"]}, standings).holds is holds


def test_the_conditions_are_tested_on_cases_that_chose_nothing():
    spec, chosen = read_file(CONDITIONS, ConditionsSpec), read_file(FILE, LevelsSpec)
    for each in (*spec.planners, *spec.aside):
        assert each.cases.start >= 1000
    assert len({each.name for each in spec.planners} - {each.planner for each in chosen.planners}) >= 5
    named = {each.name for each in (*spec.planners, *spec.aside)}
    assert {name for attack in spec.attacks for name in (attack.planner, attack.below)} - {"best"} <= named


def test_an_unknown_planner_gets_a_sentence():
    result = CliRunner().invoke(build_script(suite), ["nobody"])
    assert str(result.exception).startswith("the study has no planner nobody: it has straight, orca,")
