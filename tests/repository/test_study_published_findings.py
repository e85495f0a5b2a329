"""The study of published findings: its claims and verdicts, its room, and tangent actions."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from helpers import rollout
from lookahead_scenes import crowded

from crowdbench import Cases, Driver, InputError, Planner, load_planner, load_scenario
from crowdbench.metrics import Estimate
from crowdbench.plugins.kind import load_module
from crowdbench.utils.toml import Location
from studies.command import make_runs
from studies.li2020.claims import POINTS, REDUCTION, Verdict
from studies.pages import read_file
from studies.published_findings.claims import Assessment, ClaimSpec, tally
from studies.published_findings.findings import Finding, FindingSpec, FindingsStudy, page
from studies.published_findings.sweeps import correlate, rank_correlation

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "studies" / "published_findings"
ROOM = str(FOLDER / "room.toml")
HERE = Location("run.toml")
tangent, room = load_module(FOLDER / "tangent.py"), load_module(FOLDER / "room.py")


def verdict(least, most, **bounds):
    claim = ClaimSpec(text="A", reported="1", **bounds)
    return Assessment(claim, POINTS, Estimate((least + most) / 2, least, most, 10, 1.0)).verdict


def test_a_claim_holds_within_its_range_and_is_refuted_outside():
    assert verdict(0.1, 0.2, low=0.0) == Verdict.HOLDS
    assert verdict(0.1, 0.2, low=0.1, high=0.2) == Verdict.HOLDS
    assert verdict(-0.1, 0.2, low=0.0) == Verdict.UNDECIDED
    assert verdict(-0.2, -0.1, low=0.0) == Verdict.REFUTED
    assert verdict(0.3, 0.4, low=0.1, high=0.2) == Verdict.REFUTED
    assert verdict(0.1, 0.4, low=0.0, high=0.2) == Verdict.UNDECIDED
    assert verdict(np.nan, np.nan, low=0.0) == Verdict.UNDECIDED
    assert verdict(1.0, 1.0, low=0.0) == Verdict.UNDECIDED  # too few events for an interval


def test_the_range_of_a_claim_is_shown_in_the_unit_of_the_figure():
    figure = Estimate(0.5, 0.4, 0.6, 10, 1.0)
    for bounds, shown in (
        ({"low": 0.0}, "0.0 or more"),
        ({"high": 0.2}, "20.0 or less"),
        ({"low": 0.1, "high": 0.2}, "10.0 to 20.0"),
    ):
        assert Assessment(ClaimSpec(text="A", **bounds), REDUCTION, figure).range == shown


def test_claims_without_a_reported_figure_are_not_counted():
    figure = Estimate(0.5, 0.4, 0.6, 10, 1.0)
    claims = [Assessment(ClaimSpec(text="A", reported=each, low=0.0), POINTS, figure) for each in ("1", "", "2")]
    assert tally(claims) == "Reported: 2 hold, 0 are refuted, 0 are undecided."
    assert claims[1].cells()[1] == "not in the paper"


def test_the_correlation_is_spearmans_over_all_pairs():
    levels = np.array([1.0, 2.0, 3.0])
    assert rank_correlation(np.array([0.9, 0.5, 0.1]), levels) == pytest.approx(-1.0)
    rates = np.array([[0.9, 0.5, 0.1], [0.2, 0.6, 0.7]])
    # Spearman's correlation of (1, 2, 3, 1, 2, 3) with the rates, from scipy.stats.spearmanr.
    assert rank_correlation(rates, levels) == pytest.approx(-0.2390457, abs=1e-6)
    assert np.isnan(rank_correlation(np.ones((2, 3)), levels)).all()


def test_the_interval_of_a_correlation_includes_other_planners():
    levels, draws = np.arange(5.0), np.random.default_rng(1)
    rates = np.array([0.9, 0.8, 0.6, 0.4, 0.2])
    alike = (draws.random((4, 5, 200)) < rates[None, :, None]).astype(float)
    found = correlate(alike, levels)
    assert -1.0 <= found.low < found.mean < found.high < -0.8
    apart = np.concatenate([alike[:2], alike[2:, ::-1]])
    mixed = correlate(apart, levels)
    assert mixed.low < -0.5
    assert mixed.high > 0.5


def test_the_file_of_the_study_is_in_order_and_its_planners_exist():
    study = read_file(FOLDER / "run.toml", FindingsStudy)
    density, _tangents, attention = study.findings
    for sweep in density.sweeps:
        assert len(sweep.levels) == 7
        assert len(sweep.cases) >= 200
        for level in sweep.levels:
            load_scenario(str(ROOT / sweep.scenario), level.overrides)
    assert [len(finding.pairs) for finding in study.findings] == [0, 5, 8]
    assert all(claim.reported for pair in attention.pairs[:5] for claim in pair.claims)


def spec(**changes):
    claims = [
        {"text": "Fewer", "reported": "50 %", "measure": "without_contact", "kind": "reduction", "low": 0.5},
        {"text": "Less", "reported": "1", "measure": "success_rate", "kind": "difference", "high": 0.0},
    ]
    sides = {
        "row": {"planner": "straight", "overrides": {"pedestrians.number": 5}},
        "than": {"planner": "straight", "overrides": {"pedestrians.number": 1}},
    }
    levels = [{"value": number / 100, "overrides": {"pedestrians.number": number}} for number in (1, 5, 20)]
    falls = [{"text": "Falls", "reported": "-1", "low": -1.0, "high": 0.0}]
    scene = {"scenario": ROOM, "cases": "val:12"}
    return FindingSpec(
        title="Crowds",
        reported="Reported: much.",
        differs=["All differs."],
        sweeps=[{"title": "density", "planners": ["straight"], "levels": levels, "claims": falls, **scene}],
        pairs=[{**scene, **sides, "claims": claims, **changes}],
    )


@pytest.mark.slow
def test_a_finding_has_its_claims_and_its_table(tmp_path):
    finding = Finding.load(spec(), tmp_path, HERE)
    assert len(finding.runs) == 5
    make_runs(finding.runs, tmp_path)
    filled = finding.fill(tmp_path)
    falls, fewer, less = filled.claims
    assert falls.figure.mean == pytest.approx(-1.0)
    success = filled.details[0].rows[0][1:4]
    assert float(success[0]) > float(success[1]) > float(success[2])
    rates = [float(rate) / 100 for rate in success]
    assert fewer.figure.mean == pytest.approx(1 - rates[1] / rates[0], abs=2e-3)
    assert less.figure.mean == pytest.approx(rates[1] - rates[0], abs=2e-3)
    assert f"(success {success[0]} to {success[1]} %)" in less.claim.text
    text = page(FindingsStudy(description="Checks.", findings=[spec()]), [filled])
    assert "## Crowds\n\nReported: much." in text
    assert "All differs." in text


def test_unknown_planners_and_weights_get_one_sentence(tmp_path):
    weights = {"planner": str(ROOT / "adapters" / "ds_rnn" / "ds_rnn.py"), "weights": ["absent"]}
    for side, sentence in (({"planner": "nobody"}, "nobody"), (weights, "absent.safetensors")):
        with pytest.raises(InputError, match=rf"in findings.*pairs.*{sentence}") as error:
            Finding.load(spec(row=side), tmp_path, HERE.at("findings", 0))
        assert "\n" not in str(error.value)


def test_half_of_the_pedestrians_pass_and_half_cross():
    world = load_scenario(ROOM, {"pedestrians.number": 20}).draw("val", np.arange(30))
    start, goal = world.position[:, 1:], world.goal[:, 1:]
    crosses = start[..., 0] * goal[..., 0] < 0.0
    assert 0.4 < crosses.mean() < 0.6
    assert (start[..., 1] * goal[..., 1] < 0.0)[~crosses].all()
    assert np.abs(start).max() <= 4.7
    assert np.abs(goal).max() <= 4.7
    apart = np.linalg.norm(world.position[:, :, None] - world.position[:, None], axis=3)
    assert apart[:, ~np.eye(21, dtype=bool)].min() > 0.8
    assert world.position[:, 0].tolist() == [[0.0, -4.0]] * 30
    assert world.goal[:, 0].tolist() == [[0.0, 4.0]] * 30


def test_a_narrow_room_has_room_for_few_and_says_when_it_is_full():
    narrow = {"layout.width": 1.5, "pedestrians.number": 3}
    assert np.abs(load_scenario(ROOM, narrow).draw("val", np.arange(10)).position[..., 0]).max() <= 0.445
    with pytest.raises(InputError, match=r"no room in 1.5 x 10 m: lower pedestrians.number"):
        load_scenario(ROOM, {**narrow, "pedestrians.number": 40}).draw("val", np.arange(1))


def test_pedestrians_who_arrive_come_in_again():
    scenario = load_scenario(ROOM, {"pedestrians.number": 6})
    trace = rollout(Driver(load_planner("straight"), "straight"), scenario, Cases.parse("val:4"))
    jumps = np.linalg.norm(np.diff(trace.position[:, :, 1:], axis=1), axis=3)
    assert (jumps > 1.0).any()
    assert trace.person.max() >= 6


class Right(Planner):
    def plan(self, obs):
        return np.tile([[1.0, 0.0]], (len(obs), 1))


def scene(people, position=(0.0, -2.0), goal=(0.0, 4.0)):
    """One vehicle that sees people at positions."""
    obs = crowded(2, len(people)).take(slice(1, 2))
    vehicle = dataclasses.replace(
        obs.vehicle,
        position=np.array([position]),
        goal=np.array([goal]),
        route=np.full((1, 0, 2), np.nan),
        radius=np.array([0.3]),
        preferred_speed=np.array([1.0]),
    )
    crowd = dataclasses.replace(
        obs.pedestrians,
        position=np.array([people], float),
        radius=np.full((1, len(people)), 0.3),
        seen=np.ones((1, len(people)), bool),
    )
    return dataclasses.replace(obs, vehicle=vehicle, pedestrians=crowd)


def command(obs):
    return tangent.TangentPlanner(Right(), margin=0.25).plan(obs)[0].tolist()


def test_a_group_in_the_way_is_passed_by_its_tangent_on_the_side_of_the_goal():
    group = [(-0.5, 0.0), (0.7, 0.0)]
    x, y = command(scene(group, position=(0.0, -1.4)))
    assert (x, y) == pytest.approx((-1.4 / np.hypot(1.4, 0.1), 0.1 / np.hypot(1.4, 0.1)))
    assert command(scene(group, position=(0.0, -2.0))) == [1.0, 0.0]  # too far
    assert command(scene(group[:1], position=(0.0, -1.4))) == [1.0, 0.0]  # alone
    assert command(scene([group[0], (1.2, 0.0)], position=(0.0, -1.4))) == [1.0, 0.0]  # not together
    assert command(scene(group, position=(0.0, 1.4))) == [1.0, 0.0]  # behind
    assert command(scene(group, position=(0.0, -1.4), goal=(0.1, -0.9))) == [1.0, 0.0]  # the goal is in front of it


def test_pedestrians_that_are_not_seen_form_no_groups():
    obs = scene([(-0.5, 0.0), (0.7, 0.0)], position=(0.0, -1.4))
    hidden = dataclasses.replace(obs.pedestrians, seen=np.array([[True, False]]))
    assert command(dataclasses.replace(obs, pedestrians=hidden)) == [1.0, 0.0]
    assert command(scene([])) == [1.0, 0.0]


def test_chains_of_neighbours_are_one_group():
    position = np.array([[(1.4 * i, 0.0) for i in range(5)] + [(9.0, 0.0)]])
    member = tangent.find_groups(position, np.ones((1, 6), bool))
    assert member[0, :5, :5].all()
    assert member[0, 5].tolist() == [False] * 5 + [True]
    centre, reach = tangent.enclose(position, np.full((1, 6), 0.3), member)
    np.testing.assert_allclose(centre[0, [0, 5]], [(2.8, 0.0), (9.0, 0.0)])
    np.testing.assert_allclose(reach[0, [0, 5]], [3.1, 0.3])


@pytest.mark.parametrize(("gap", "share"), [(0.6, 1.0), (0.4, 0.3), (0.2, 0.0)])
def test_a_near_pedestrian_turns_the_tangent_away(gap, share):
    obs = scene([(0.0, 0.0), (0.0, 1.0)], position=(0.0, -0.6 - gap))
    across = np.array([[1.0, 0.0]])
    np.testing.assert_allclose(tangent.keep_distance(obs, across)[0], [share, share - 1.0], atol=1e-12)
