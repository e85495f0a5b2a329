"""Certificates: what is solvable is solved, what is walled in is not, and runs print how many cases have one."""

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from crowdbench.catalog import SCENARIOS, load_scenario
from crowdbench.cli.app import app, build_script
from crowdbench.core.types import Outcome
from crowdbench.planners.driver import Driver
from crowdbench.runs.replay import Playback
from crowdbench.runs.rollout import rollout
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.certified import CERTIFICATES, Certified
from studies.certificates import run
from studies.certificates.certificate import SEARCH, certificates, make
from studies.certificates.crowds import Known, known_steps
from studies.certificates.expand import expand
from studies.certificates.search import Effort, Task, search

LAYOUTS = '''"""Places by hand."""

import numpy as np
from crowdbench.scenario.placement import Placement


def wait(rng, radius, preferred_speed):
    """A corridor of 0.9 m, along which somebody comes; the vehicle stands in a niche."""
    walls = [[-9, -0.45, 9, -0.45], [-9, 0.45, -0.5, 0.45], [0.5, 0.45, 9, 0.45], [-0.5, 0.45, -0.5, 2],
             [0.5, 0.45, 0.5, 2], [-0.5, 2, 0.5, 2], [9, -0.45, 9, 0.45], [-9, -0.45, -9, 0.45]]
    walls = np.array(walls, float).reshape(-1, 2, 2)
    return Placement(np.array([[0.0, 1.4], [4.0, 0.0]]), np.array([[4.0, 0.0], [-8.0, 0.0]]), obstacles=walls)


def detour(rng, radius, preferred_speed):
    """People who stand in a half circle, open to the vehicle, between it and its goal."""
    angle = np.linspace(0.0, np.pi, len(radius) - 1)
    people = 2.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return Placement(np.concatenate([[[0.0, -2.0]], people]), np.concatenate([[[0.0, 4.0]], people]))


def ring(rng, radius, preferred_speed):
    """People who stand around the goal."""
    angle = np.arange(len(radius) - 1) * (2.0 * np.pi / (len(radius) - 1))
    people = np.stack([np.cos(angle), np.sin(angle) + 2.0 + 0.1 * rng.random()], axis=1)
    closed = rng.random() < 0.5
    people = people if closed else people + 20.0
    return Placement(np.concatenate([[[0.0, 0.0]], people]), np.concatenate([[[0.0, 2.0]], people]))
'''

SCENARIO = """time_limit = LIMIT

[layout]
generator = "mine.py:LAYOUT"

[pedestrians]
number = NUMBER
policy = "straight"
"""


@pytest.fixture(autouse=True)
def planners(monkeypatch):
    """Has no planner drive the cases, unless a test names some."""

    def only(*names):
        monkeypatch.setattr("studies.certificates.certificate.PLANNERS", names)

    only()
    return only


@pytest.fixture
def made(tmp_path, monkeypatch):
    """Makes the scenario of one of the layouts in a file ./mine.toml."""
    monkeypatch.chdir(tmp_path)
    Path("mine.py").write_text(LAYOUTS)

    def make(layout, number):
        limit = 5.0 if layout == "ring" else 14.0
        text = SCENARIO.replace("LAYOUT", layout).replace("NUMBER", str(number)).replace("LIMIT", str(limit))
        Path("mine.toml").write_text(text)
        return load_scenario("mine.toml")

    return make


def found_in(scenario, cases="1", margins=(0.1, 0.0)):
    return certificates(scenario, Cases.parse(cases), margins, lambda done: None)


def played(scenario, certificate, split="test"):
    commands = np.zeros((1, scenario.rules.max_steps, 2))
    commands[0, : len(certificate.commands)] = certificate.commands
    return rollout(Driver(Playback(commands), "x"), scenario, Cases(split, certificate.case, certificate.case + 1))


def smallest_gap(trace):
    return min(np.nanmin(trace.gap), np.nanmin(trace.wall_gap))


def certify(*options):
    return CliRunner().invoke(build_script(run.certify), options)


@pytest.mark.slow
def test_who_must_wait_is_certified(made):
    scenario = made("wait", 1)
    (found,) = found_in(scenario)
    trace = played(scenario, found)
    assert trace.outcome == [Outcome.SUCCESS]
    assert smallest_gap(trace) >= 0.1
    # Somebody comes for 3.6 s to the niche, and the way from there to the goal takes 4 s.
    assert len(found.commands) * scenario.rules.dt > 7.0


@pytest.mark.slow
def test_who_must_go_around_is_certified_by_a_search(made):
    scenario = made("detour", 9)
    (found,) = found_in(scenario)
    assert found.means == SEARCH
    trace = played(scenario, found)
    assert trace.outcome == [Outcome.SUCCESS]
    assert smallest_gap(trace) >= 0.1
    assert np.nanmax(np.abs(trace.position[0, :, 0, 0])) > 2.0


@pytest.mark.slow
def test_whose_goal_is_walled_in_has_no_certificate_and_others_of_the_scenario_have(made):
    scenario = made("ring", 12)
    found = found_in(scenario, "4")
    closed = [case for case in range(4) if np.abs(scenario.draw("test", np.array([case])).position[0, 1:]).max() < 9.0]
    assert 0 < len(closed) < 4
    assert [each.case for each in found if not each.means] == closed
    assert all(each.is_exhausted == (each.case in closed) for each in found)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "overrides"),
    [
        ("circle_crossing_5_visible", {}),
        ("circle_crossing_10", {"collision": "crowdnav"}),
        ("circle_crossing_5", {"vehicle.dynamics": "unicycle"}),
        ("car_28", {"pedestrians.number": 5}),
    ],
)
def test_what_a_search_finds_replays_with_the_margin(name, overrides):
    scenario = load_scenario(name, overrides)
    (found,) = found_in(scenario, "val:3:4", (0.1,))
    assert found.means == SEARCH
    trace = played(scenario, found, "val")
    assert trace.outcome == [Outcome.SUCCESS]
    assert trace.steps == [len(found.commands)]
    assert smallest_gap(trace) == found.gap >= 0.1


@pytest.mark.slow
def test_a_certificate_is_the_same_alone_and_with_others(planners):
    planners("orca_margin")
    scenario = load_scenario("circle_crossing_10")
    together = found_in(scenario, "val:12:15", (0.1,))
    assert {each.means for each in together} == {"orca_margin", SEARCH}
    for each in together[1:]:
        (alone,) = found_in(scenario, f"val:{each.case}:{each.case + 1}", (0.1,))
        assert alone.means == each.means
        np.testing.assert_array_equal(alone.commands, each.commands)


@pytest.mark.slow
def test_a_search_finds_no_slower_way_on_a_free_plane():
    scenario = load_scenario("circle_crossing_5", {"pedestrians.number": 0, "crowdnav_cases": 0})
    world = scenario.worlds(Cases.parse("1"))
    crowd = Known([each.row(0) for each in known_steps(scenario, world)])
    found = search(Task.of(world, 0), crowd, 0.1, Effort(0.2, 500))
    distance = 8.0 - scenario.vehicle.radius
    assert len(found.commands) == np.ceil(distance / (scenario.vehicle.preferred_speed * scenario.rules.dt))


@pytest.mark.slow
def test_the_margin_is_that_of_walls_too(made, monkeypatch):
    margins = []
    monkeypatch.setattr("studies.certificates.search.expand", lambda *given: margins.append(given[2]) or expand(*given))
    # There are 0.07 m between the vehicle and the walls.
    made("wait", 1)
    (found,) = found_in(load_scenario("mine.toml", {"vehicle.radius": 0.38}))
    assert found.margin == 0.0
    assert set(margins) == {0.0}  # nothing is searched where the walls are too near
    assert 0.0 <= found.gap < 0.1


@pytest.mark.slow
def test_certify_and_run_of_a_scenario_of_ones_own(made):
    scenario = made("ring", 12)
    result = certify("mine.toml", "--cases", "test:4", "--out", "certified")
    assert result.exit_code == 0, result.output
    without_one = [each.case for each in found_in(scenario, "4") if not each.means]
    named = ", ".join(f"test/{case}" for case in without_one)
    assert f"no certificate exists on the grid of the search: {named}" in result.output
    assert "Traceback" not in result.output
    replay = CliRunner().invoke(app, ["score", "certified/test", "--layout", "mine.py:ring"])
    assert "All agree" in replay.output, replay.output
    # It lies in the folder that the last line names.
    assert Certified.read(Path("certified/mine.toml")).test.uncertified == without_one
    run = ["run", "--planner", "orca_margin", "--scenario", "mine.toml", "--record", "commands", "--cases"]
    driven = CliRunner().invoke(app, [*run, "4", "--out", "some"])
    lacking = f"crowdbench: {len(without_one)} of the cases test:0:4 of mine ha"
    assert (lacking in driven.stderr) == bool(without_one)
    assert ("certificate" in driven.stderr) == bool(without_one)
    again = CliRunner().invoke(app, ["score", "some", "--layout", "mine.py:ring"])
    assert "All agree" in again.output, again.output
    beyond = CliRunner().invoke(app, [*run, "5", "--out", "more"])
    assert "`python studies/certificates/run.py mine.toml --cases test:5` makes them" in beyond.stderr


@pytest.mark.slow
def test_an_interrupted_command_goes_on_with_what_is_missing(made, monkeypatch):
    scenario = made("ring", 12)
    monkeypatch.setattr("studies.certificates.certificate.PART", 1)
    done = []

    def stops(share):
        done.append(share)
        if sum(done) == 3:
            raise KeyboardInterrupt

    def make_all(progress):
        return make(scenario, Cases.parse("3"), 0.1, Path("out"), overrides={}, progress=progress)

    with pytest.raises(KeyboardInterrupt, match="2 of 3 cases are kept in"):
        make_all(stops)
    looked = []
    real = certificates
    monkeypatch.setattr(
        "studies.certificates.certificate.certificates", lambda *given: looked.append(given[1]) or real(*given)
    )
    rows = make_all(lambda share: None)
    assert looked == [Cases("test", 2, 3)]
    assert [row.case for row in rows] == [0, 1, 2]
    assert [row.means for row in rows] == [each.means for each in found_in(scenario, "3")]


STALE = {
    "maps": "",
}
"""Scenarios by folder that have changed since their cases were examined. `python studies/certificates/run.py NAME`
makes their certificates again; then the name comes off this list."""


@pytest.mark.parametrize("folder", STALE)
def test_certificates_are_of_the_scenarios_that_ship_but_for_those_to_be_made_again(folder):
    statuses = [load_scenario(file.stem).certificates for file in (SCENARIOS / folder / CERTIFICATES).glob("*.toml")]
    stale = {status.name for status in statuses if status.certified.scenario != status.digest}
    assert stale == set(STALE[folder].split())


@pytest.mark.parametrize("folder", STALE)
def test_at_least_95_percent_of_the_cases_of_a_scenario_that_ships_are_certified(folder):
    for file in (SCENARIOS / folder / CERTIFICATES).glob("*.toml"):
        certified = Certified.read(file)
        for examined in filter(None, (certified.val, certified.test)):
            assert len(examined.uncertified) <= 0.05 * examined.examined, file


@pytest.mark.slow
@pytest.mark.parametrize("name", ["door_10", "street_8", "blocks_12", "office_8"])
def test_in_the_empty_world_a_search_is_as_fast_as_the_least_time_but_never_faster(name):
    changes = {"pedestrians.number": 0, "vehicle.visible": False, "time_limit": 120.0}
    scenario = load_scenario(name, {**changes, "time_limit_factor": 1.0})
    world = load_scenario(name, {**changes, "time_limit_factor": 2.0}).worlds(Cases("val", 0, 1))
    least = int(scenario.worlds(Cases("val", 0, 1)).max_steps[0]) - 1
    crowd = Known([step.row(0) for step in known_steps(scenario, world)])
    found = search(Task.of(world, 0), crowd, 0.0, Effort(0.1, 4000))
    assert 0 <= len(found.commands) - least <= 1
