"""Dials: the estimate of a level, the files, the command, and their figures and tables."""

import itertools
import json
import math

import numpy as np
import pytest
from scipy.stats import beta, norm
from typer.testing import CliRunner

from crowdbench.catalog import load_scenario
from crowdbench.cli.app import build_script
from crowdbench.scenario.cases import Cases
from studies.dials import estimate, table
from studies.dials.dial import dials, load_dial
from studies.dials.plot import plot
from studies.dials.run import dial as find_level

DIAL = build_script(find_level)

OWN = """
description = "A circle"
time_limit = 12.0

[layout]
generator = "circle_crossing"

[pedestrians]
number = 2

[dial]
key = "pedestrians.number"
levels = [1, 4, 9]
label = "{} people on a circle"
"""


def drive_known(draws, middle, width, shared, spread=1.0, levels=9):
    """The scores of both stages where their mean falls as a logistic curve; cases are easy or hard at all levels."""

    def scores(cases):
        own = math.sqrt(1.0 - shared) * draws.standard_normal((levels, cases))
        luck = norm.cdf(math.sqrt(shared) * draws.standard_normal(cases) + own)
        mean = 1.0 / (1.0 + np.exp((np.arange(levels) - middle) / width))[:, None]
        return beta.ppf(luck, spread * mean, spread * (1.0 - mean))

    first, second = scores(30), scores(240)
    return first, {level: second[level] for level in estimate.levels_around(first)}


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("middle", "width", "shared", "spread"), [(4.3, 0.4, 0.2, 0.1), (5.5, 1.2, 0.0, 1.0), (3.6, 1.5, 0.3, 10.0)]
)
def test_a_known_curve_is_found_without_bias_and_as_often_as_the_interval_says(
    middle, width, shared, spread, monkeypatch
):
    monkeypatch.setattr(estimate, "RESAMPLES", 1000)
    draws, trials = np.random.default_rng(1), 250
    truth = middle + width * math.log(1.0 / estimate.WANTED - 1.0)
    found = [estimate.fit(*drive_known(draws, middle, width, shared, spread)) for _ in range(trials)]
    assert abs(np.mean([each.wanted.level for each in found]) - truth) < 0.1
    assert 0.92 <= np.mean([each.wanted.low <= truth <= each.wanted.high for each in found]) <= 0.99
    assert np.mean([each.is_monotone for each in found]) > 0.98


@pytest.mark.parametrize(("score", "level", "around"), [(0.0, -math.inf, [0, 1, 2]), (1.0, math.inf, [6, 7, 8])])
def test_beyond_the_levels_there_is_no_number(score, level, around):
    first = np.full((9, 30), score)
    assert estimate.levels_around(first) == around
    found = estimate.fit(first, {each: np.full(240, score) for each in around})
    assert found.wanted.level == found.wanted.low == found.wanted.high == level
    assert found.cases.tolist() == [30 + 240 * (number in around) for number in range(9)]
    assert all(map(math.isnan, estimate.difference(found.wanted, found.wanted)))


def test_a_score_that_rises_has_no_level():
    first = (np.arange(30) < np.array([28, 27, 10, 9, 29, 28, 5, 3, 0])[:, None]).astype(float)
    second = {level: np.tile(first[level], 8) for level in estimate.levels_around(first)}
    assert not estimate.fit(first, second).is_monotone
    first[4:6] = np.arange(30) < 9
    second = {level: np.tile(first[level], 8) for level in estimate.levels_around(first)}
    assert estimate.fit(first, second).is_monotone


def test_a_difference_is_paired():
    first, second = drive_known(np.random.default_rng(3), 5.0, 0.8, 0.5)
    found = estimate.fit(first, second).wanted
    assert estimate.difference(found, found) == (0.0, 0.0, 0.0)
    harder = np.vstack([first[1:], np.zeros_like(first[:1])])
    worse = estimate.fit(harder, {level - 1: each for level, each in second.items()}).wanted
    level, low, high = estimate.difference(found, worse)
    assert level == pytest.approx(1.0)
    assert high - low < 0.5 * (found.high - found.low)


@pytest.mark.slow
def test_dials_that_ship_have_nine_levels_and_the_same_people_at_all():
    found = [load_dial(name) for name, _ in dials()]
    assert len(found) >= 6
    for dial in found:
        assert len(dial.levels) == 9
        worlds = [load_scenario(dial.file, {dial.key: level}).worlds(Cases("test", 0, 3)) for level in dial.levels]
        for easier, harder in itertools.pairwise(worlds):
            both = easier.position.shape[1]
            for part in ("position", "goal", "radius"):
                np.testing.assert_array_equal(getattr(easier, part), getattr(harder, part)[:, :both])


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (("[dial]", "[knob]"), "has no table [dial]: a dial has one, with key, levels and label"),
        (
            ("[1, 4, 9]", "[1, 9, 4]"),
            "dial.levels is [1, 9, 4], but must be a list of three or more numbers that rise or fall",
        ),
        (('key = "pedestrians.number"', 'key = "pedestrians.count"'), "pedestrians.count"),
    ],
)
def test_what_is_wrong_in_a_dial_is_said_in_a_sentence(change, reason, tmp_path):
    (tmp_path / "own.toml").write_text(OWN.replace(*change))
    result = CliRunner().invoke(DIAL, [str(tmp_path / "own.toml"), "--planner", "orca", "--out", str(tmp_path)])
    assert result.exit_code == 1
    assert reason in str(result.exception)


@pytest.fixture
def few(monkeypatch):
    """Few cases in both stages."""
    monkeypatch.setattr(table, "FIRST", Cases("test", 0, 6))
    monkeypatch.setattr(table, "SECOND", Cases("test", 6, 20))


@pytest.mark.slow
def test_a_dial_is_driven_kept_and_drawn(few, tmp_path):
    (tmp_path / "own.toml").write_text(OWN)
    files = []
    for planner in ("straight", "P3"):
        command = [str(tmp_path / "own.toml"), "--planner", planner, "--out", str(tmp_path / "runs")]
        result = CliRunner().invoke(DIAL, command)
        assert result.exit_code == 0, result.output
        again = CliRunner().invoke(DIAL, [*command, "--format", "json"])
        assert "run 1" not in again.output  # all are kept
        found = json.loads(again.stdout)
        (row,) = found["rows"]
        assert row["cases"] == ([6, 6, 6] if planner == "P3" else [20, 20, 20])
        first = load_scenario(str(tmp_path / "own.toml"), {"pedestrians.number": 9})
        assert first.max_agents == 10
        files += [tmp_path / "runs" / f"{planner}-own-6.json"]
        assert json.loads(files[-1].read_text()) == found
        assert "people on a circle" in result.output
    figure = tmp_path / "dial.svg"
    assert CliRunner().invoke(build_script(plot), [*map(str, files), "--out", str(figure)]).exit_code == 0
    assert ">people on a circle<" in figure.read_text()
    assert "P3 of the ladder" in figure.read_text()
    options = ["--planner", "P2", "--option", "horizon=3"]
    assert "P2 is a rung of the ladder, which takes no options" in str(
        CliRunner().invoke(DIAL, [str(tmp_path / "own.toml"), *options]).exception
    )
    files[0].write_text(files[0].read_text().replace('"own"', '"other"'))
    result = CliRunner().invoke(build_script(plot), [*map(str, files), "--out", str(figure)])
    assert "is of another dial than" in str(result.exception)


@pytest.mark.slow
def test_a_study_has_a_table_for_each_dial_the_best_planner_first(few, tmp_path):
    (tmp_path / "own.toml").write_text(OWN)
    (tmp_path / "study.toml").write_text(
        f'[[dials]]\ntitle = "Dials"\nplanners = ["straight", "orca", "P3"]\ndials = ["{tmp_path / "own.toml"}"]\n'
    )
    command = ["--file", str(tmp_path / "study.toml"), "--out", str(tmp_path / "runs")]
    result = CliRunner().invoke(DIAL, command)
    assert result.exit_code == 0, result.output
    rows = [line for line in result.stdout.splitlines() if line.startswith("| ")]
    assert rows[0] == "| planner | score of 0.3 at ... people on a circle | levels behind the best |"
    assert [row.split(" | ")[0] for row in rows[2:]] == ["| P3: the true future", "| orca", "| straight"]
    assert rows[2].endswith("|  |")  # nobody is behind what is no planner
    (filled,) = json.loads(CliRunner().invoke(DIAL, [*command, "--format", "json"]).stdout)["tables"][0]["dials"]
    search, orca, straight = (np.array(row["score"]) for row in filled["rows"])
    assert (search >= np.maximum(orca, straight)).all()
    assert orca[0] >= straight[0]
