"""Best known times: known optima are found, and only commands that the simulator replays replace others."""

import numpy as np
import pytest
from typer.testing import CliRunner

from crowdbench import InputError
from crowdbench.catalog import load_scenario, read_suite
from crowdbench.cli.app import build_script
from crowdbench.metrics.registry import METRICS
from crowdbench.planners.driver import Driver
from crowdbench.runs.replay import Playback
from crowdbench.runs.rollout import rollout
from crowdbench.scenario.cases import Cases
from studies.best_times import search as command
from studies.best_times.beam import QUANTUM, Shape, as_stored, search_case, select
from studies.best_times.entries import BestTimes, Entry, check_replays, replace_by_planner, replay
from studies.best_times.successors import Successors

pytestmark = pytest.mark.slow  # the kernel of the search takes seconds to compile

LAYOUTS = '''"""Places by hand."""

import numpy as np
from crowdbench.scenario.placement import Placement


def far(rng, radius, preferred_speed):
    """Somebody stands far away."""
    return Placement(np.array([[0.0, -2.0], [30.0, 0.0]]), np.array([[0.0, 2.0], [30.0, 0.0]]))


def between(rng, radius, preferred_speed):
    """Somebody stands on the straight line to the goal."""
    return Placement(np.array([[0.0, -3.0], [0.0, 0.0]]), np.array([[0.0, 3.0], [0.0, 0.0]]))


def wait(rng, radius, preferred_speed):
    """Somebody comes along a corridor of 0.9 m; the vehicle stands in a niche."""
    walls = [[-9, -0.45, 9, -0.45], [-9, 0.45, -0.5, 0.45], [0.5, 0.45, 9, 0.45], [-0.5, 0.45, -0.5, 2],
             [0.5, 0.45, 0.5, 2], [-0.5, 2, 0.5, 2], [9, -0.45, 9, 0.45], [-9, -0.45, -9, 0.45]]
    walls = np.array(walls, float).reshape(-1, 2, 2)
    return Placement(np.array([[0.0, 1.4], [4.0, 0.0]]), np.array([[4.0, 0.0], [-8.0, 0.0]]), obstacles=walls)


def ring(rng, radius, preferred_speed):
    """People stand around the vehicle."""
    angle = np.arange(len(radius) - 1) * (2.0 * np.pi / (len(radius) - 1))
    people = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return Placement(np.concatenate([[[0.0, 0.0]], people]), np.concatenate([[[0.0, 4.0]], people]))
'''

SCENARIO = """collision = "swept"
time_limit = 15.0

[layout]
generator = "mine.py:LAYOUT"

[vehicle]
VEHICLE
visible = true

[pedestrians]
number = NUMBER
policy = "straight"
"""


@pytest.fixture
def made(tmp_path, monkeypatch):
    """Makes the scenario of one of the layouts in a file ./mine.toml."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text(LAYOUTS)

    def make(layout, vehicle="", number=1):
        text = SCENARIO.replace("LAYOUT", layout).replace("VEHICLE", vehicle).replace("NUMBER", str(number))
        (tmp_path / "mine.toml").write_text(text)
        return load_scenario("mine.toml")

    return make


def found_in(scenario, seconds=0.0):
    return replay(scenario, 0, search_case(scenario, 0, seconds).commands, "search", "2026-01-02")


def least_time(scenario):
    standing = Playback(np.zeros((1, scenario.rules.max_steps, 2)))
    return float(METRICS["t_empty"](rollout(Driver(standing, "x"), scenario, Cases("val", 0, 1)))[0])


@pytest.mark.parametrize("vehicle", ["", 'dynamics = "unicycle"', 'dynamics = "bicycle"\nwheelbase = 0.5'])
def test_without_people_the_least_time_is_found_but_for_a_step(made, vehicle):
    scenario = made("far", vehicle)
    entry = found_in(scenario)
    assert least_time(scenario) <= entry.time <= least_time(scenario) + scenario.rules.dt
    assert entry.close == 0.0


def test_a_standing_pedestrian_is_passed_at_a_distance(made):
    scenario = made("between")
    entry = found_in(scenario, seconds=1.0)
    # Tangents and an arc at a gap of 0.6 m, from the start to the goal's tolerance.
    length = 2.0 * np.sqrt(3.0**2 - 1.2**2) + 1.2 * 2.0 * np.arcsin(1.2 / 3.0) - 0.3
    assert least_time(scenario) < entry.time
    assert entry.time + entry.close < length + 2 * scenario.rules.dt
    assert entry.close < 0.1
    assert entry.score == pytest.approx(least_time(scenario) / (entry.time + entry.close))


def test_a_vehicle_waits_for_somebody_who_comes_along_a_corridor(made):
    entry = found_in(made("wait"))
    # Somebody comes for 3.6 s to the niche, and the path from there to the goal takes 4 s.
    assert 7.0 < entry.time < 10.0


@pytest.mark.parametrize("name", ["door_10", "street_8", "blocks_12", "office_8"])
def test_in_the_empty_world_a_search_is_as_fast_as_the_least_time_but_never_faster(name):
    changes = {"pedestrians.number": 0, "vehicle.visible": False, "time_limit": 120.0}
    least = load_scenario(name, {**changes, "time_limit_factor": 1.0}).worlds(Cases("val", 0, 1)).max_steps[0] - 1
    found = search_case(load_scenario(name, {**changes, "time_limit_factor": 2.0}), 0, 0.0)
    assert 0 <= len(found.commands) - least <= 1


def test_no_commands_are_found_for_a_vehicle_in_a_closed_ring(made):
    assert not len(search_case(made("ring", number=12), 0, 0.0).commands)


def test_the_estimated_cost_is_that_of_the_replay(made):
    scenario = made("between")
    found = search_case(scenario, 0, 0.0)
    entry = replay(scenario, 0, found.commands, "search", "2026-01-02")
    assert found.cost == pytest.approx(entry.time + entry.close, abs=1e-9)
    assert len(found.commands) == entry.time / scenario.rules.dt


def test_commands_that_do_not_succeed_are_refused(made):
    scenario = made("between")
    with pytest.raises(InputError, match=r"^the commands by me for mine, case val/0, end with a timeout$"):
        replay(scenario, 0, np.zeros((3, 2)), "me", "2026-01-02")
    with pytest.raises(InputError, match=r"end with a collision$"):
        replay(scenario, 0, np.tile([0.0, 1.0], (30, 1)), "me", "2026-01-02")


def test_stored_commands_are_rounded_towards_zero_and_stay_the_same():
    commands = np.array([[0.99999, -0.99999], [0.3, -2.00004]])
    stored = as_stored(commands)
    assert stored.tolist() == [[9999, -9999], [3000, -20000]]
    np.testing.assert_array_equal(as_stored(stored * QUANTUM), stored)


def entry_of(score, case=0):
    return Entry(case=case, score=score, time=5.0, holder="search", date="2026-01-02", commands="AAAA")


def test_a_better_entry_replaces_and_a_worse_one_does_not():
    best = BestTimes(scenario="mine", digest="0")
    assert best.put(entry_of(0.5, 3))
    assert best.put(entry_of(0.4, 1))
    assert not best.put(entry_of(0.5, 3))
    assert not best.put(entry_of(0.3, 3))
    assert best.put(entry_of(0.6, 3))
    assert [(each.case, each.score) for each in best.entries] == [(1, 0.4), (3, 0.6)]


def test_a_planner_replaces_an_entry_only_if_it_is_better_and_succeeds(made):
    scenario = made("between")
    good = found_in(scenario)
    slow = good.model_copy(update={"score": 0.1})
    best = BestTimes(scenario="mine", digest=scenario.digest, entries=[slow])
    standing, commands = np.zeros((3, 2)), good.decoded()
    assert not replace_by_planner(scenario, best, 0, 0.05, commands, "mppi", "2026-01-03")
    assert not replace_by_planner(scenario, best, 0, 0.9, standing, "mppi", "2026-01-03")
    assert not replace_by_planner(scenario, best, 1, 0.9, commands, "mppi", "2026-01-03")
    assert best.entries == [slow]
    assert replace_by_planner(scenario, best, 0, good.score, commands, "mppi", "2026-01-03")
    assert best.entries == [good.model_copy(update={"holder": "mppi", "date": "2026-01-03"})]


def test_stored_scores_are_checked_by_a_replay(made, tmp_path):
    scenario = made("between")
    entry = found_in(scenario)
    best = BestTimes(scenario="mine", digest=scenario.digest, entries=[entry])
    best.write(tmp_path)
    assert BestTimes.read(scenario, tmp_path) == best
    check_replays(scenario, best)
    false = BestTimes(scenario="mine", digest="0", entries=[entry.model_copy(update={"score": 0.99})])
    with pytest.raises(InputError, match=r"has the score 0\.\d+ when it is replayed, but 0\.990000 is stored"):
        check_replays(scenario, false)
    false.write(tmp_path)
    with pytest.raises(InputError, match="is for another mine or simulator: remove it, and search again"):
        BestTimes.read(scenario, tmp_path)
    with pytest.raises(InputError, match="case val/0 are damaged"):
        entry.model_copy(update={"commands": "?"}).decoded()


def test_states_are_spread_over_cells_beside_the_best_ones():
    new = Successors.empty(1, 6)
    new.state[0] = [[0.5 + 0.15 * k, 0.5, 0, 0, 0, 0] for k in range(5)] + [[9, 9, 0, 0, 0, 0]]
    new.left[0] = [1, 2, 3, 4, 5, 99]
    parent, action = select(new, Shape(width=4), np.inf)
    assert parent.tolist() == [0] * 4
    assert action[:2].tolist() == [0, 1]
    assert 5 in action.tolist()


def test_the_command_continues_with_cases_that_are_left(made, tmp_path):
    made("between")

    def call(*options):
        return CliRunner().invoke(build_script(command.search), ["mine.toml", "--out", str(tmp_path / "x"), *options])

    first = call("--cases", "val:1", "--seconds", "0")
    assert "mine val/0: score 0." in first.stdout
    second = call("--cases", "val:2", "--seconds", "0")
    assert "val/0" not in second.stdout
    assert "mine val/1: score 0." in second.stdout
    assert [each.case for each in BestTimes.read(load_scenario("mine.toml"), tmp_path / "x").entries] == [0, 1]
    refused = call("--cases", "test:2")
    assert isinstance(refused.exception, InputError)  # `main` prints it
    assert str(refused.exception) == "cases test:2 are not validation cases: commands of other cases are not published"


def test_shipped_commands_are_of_the_scenarios_that_ship():
    for name in read_suite().ranked:
        assert all(0.0 <= each.score <= 1.0 for each in BestTimes.read(load_scenario(name)).entries)
