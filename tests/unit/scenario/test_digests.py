"""Digests of scenarios: they stay, also when a key with a default comes later, and tell what differs."""

import json

import pytest

from crowdbench.catalog import PEDESTRIANS, load_recorded_scenario, load_scenario, scenarios, simulated_scenarios
from crowdbench.scenario import schema
from crowdbench.scenario.layouts import LAYOUTS
from crowdbench.scenario.layouts.crossings import circle_crossing
from crowdbench.scenario.population import GoalChange
from crowdbench.sim.pedestrians import ORCA
from crowdbench.utils.toml import number, table


def flat(table, prefix=""):
    """The values of a scenario's table by their dotted keys; a Gaussian is one value."""
    values = {}
    for key, value in table.items():
        is_table = isinstance(value, dict) and "mean" not in value and key != "policy"
        values |= flat(value, f"{prefix}{key}.") if is_table else {f"{prefix}{key}": value}
    return values


def all_defaults(changes):
    """A scenario in which every key but these has its default."""
    return load_scenario("circle_crossing_mixed", {"pedestrians.number": 5, **changes})


DEFAULTS = {key: value for key, value in flat(all_defaults({}).table).items() if key != "description"}

OTHERS = {
    "collision": "crowdnav",
    "dt": 0.2,
    "layout.generator": "square_crossing",
    "vehicle.visible": True,
    "vehicle.dynamics": "unicycle",
    "vehicle.goal_tolerance": 0.5,
    "vehicle.max_acceleration": 2.0,
    "sensor.range": 5.0,
    "sensor.field_of_view": 90.0,
    "sensor.occlusion": True,
    "sensor.missed": 0.5,
    "sensor.nearest": 7,
    "sensor.lidar": {"beams": 9, "range": 3.0},
    "pedestrians.number": [4, 6],
    "pedestrians.policy": {"orca": 0.5, "social_force": 0.5},
    "pedestrians.groups": {"1": 0.5, "2": 0.5},
    "pedestrians.arrival": "stop",
    "pedestrians.goal_change": {"period": 5.0, "chance": 0.5},
    "pedestrians.clear_space": {"distance": 1.5, "time": 1.5},
}


def other(key):
    """Another value than the default."""
    if key in OTHERS:
        return OTHERS[key]
    value = DEFAULTS[key]
    return {**value, "std": 1e-9, "high": value["high"] + 0.25} if isinstance(value, dict) else value + 1


@pytest.mark.parametrize("key", DEFAULTS)
def test_a_default_that_is_written_out_changes_no_digest(key):
    assert all_defaults({key: DEFAULTS[key]}).digest == all_defaults({}).digest


def test_every_other_value_than_a_default_has_a_digest_of_its_own():
    # A length belongs to vehicles on wheels, and attention to a visible vehicle.
    elsewhere = {"vehicle.length", "pedestrians.attention"}
    changes = [{}, *({key: other(key)} for key in DEFAULTS if key not in elsewhere)]
    changes += [{"vehicle.dynamics": "unicycle", key: 1.0} for key in ("vehicle.length", "vehicle.max_angular_speed")]
    changes.append({"layout.generator": "square_crossing", "layout.square_width": 9.0})
    changes += [{"vehicle.visible": True, "pedestrians.attention": {"ignores": share}} for share in (0.0, 0.1)]
    assert len(changes) == 44
    assert len({all_defaults(change).digest for change in changes}) == len(changes)


def test_a_results_table_makes_the_same_scenario_whatever_it_says_of_it():
    shares = {"orca": 2, "social_force": 1, "power_law": 4}
    for change in ({}, {"pedestrians.policy": shares}, {"pedestrians.number": [1, 3]}):
        scenario = load_scenario("circle_crossing_5", change)
        result = {"name": "mine", **scenario.table, "description": "another"}
        again = load_recorded_scenario(json.loads(json.dumps(result)), "result.json")
        assert (again.digest, again.crowd) == (scenario.digest, scenario.crowd)


def test_shares_have_no_unit():
    one, two = ({"orca": 1, "social_force": 2}, {"social_force": 6, "orca": 3})
    assert all_defaults({"pedestrians.policy": one}).digest == all_defaults({"pedestrians.policy": two}).digest


SCENARIOS = {
    "circle_crossing_10": "5797606ef84a",
    "circle_crossing_5": "bf4aad8ed6e3",
    "circle_crossing_5_gaussian": "8c5d05a665d1",
    "circle_crossing_5_social_force": "fc729547e168",
    "circle_crossing_5_visible": "e281c32af525",
    "crowdnav_plus_20": "79f553183bf9",
    "crowdnav_plus_20_random": "63aed5253b34",
    "square_crossing_5": "fe931113a459",
    "circle_crossing_20_far": "1692db55476e",
    "circle_crossing_6_near": "c15ef1d2538e",
    "power_law_16": "30904399328a",
    "sizes_speeds_12": "a45cb1f8999b",
    "office_8": "b12a95d0f5f2",
    "shop_10": "ad5442faaace",
    "dut_reactive": "a9aad5e68bd2",
    "dut_recorded": "1709cd62e8b8",
    "eth_reactive": "5797e5fed0cc",
    "eth_recorded": "0c36b4541812",
    "hotel_reactive": "a5b57a09534b",
    "hotel_recorded": "072add4f3c32",
    "univ_reactive": "f13ec7015312",
    "univ_recorded": "fb42835fd745",
    "zara1_reactive": "5d04b973f450",
    "zara1_recorded": "c0e0d53c162c",
    "zara2_reactive": "c3bf79e1dde7",
    "zara2_recorded": "4070a43d2e04",
    "blind_corner_3": "a0660099b9c3",
    "blocks_12": "f66faf3c0d5c",
    "blocks_12_perfect_sight": "9288d7667d46",
    "car_12": "5bc01d9f1bbf",
    "circle_crossing_20": "09ffba132bd8",
    "circle_crossing_20_seen": "6cf99c755f5d",
    "corridor_8": "357d232de79b",
    "doorway_8": "50d4687bae56",
    "groups_12": "ecc872b9a1c2",
    "half_half_20": "58796bb0f339",
    "intersection_16": "1aa4e4bc7a9f",
    "intersection_16_seen": "feb7ef9a6118",
    "noisy_10": "34baca57f567",
    "restless_20": "2441cc874de2",
    "unicycle_10": "c58f7c14f5f7",
    "thousand": "e36f380ce83f",
    "car": "0ffb32a6bd01",
    "circle_crossing_mixed": "d15147d2f474",
    "corner": "1d848f12007a",
    "stop_and_go": "d27a10a7b9c6",
    "corridor": "cebf88e02c14",
    "door": "852ed69974de",
    "door_narrow": "1afdc4039903",
    "far": "ac04c6b80e7b",
    "groups": "3742d262888e",
    "mixed": "959d723d8f3b",
    "near": "6242801fed00",
    "noise": "72578aa7c1c4",
    "noise_late": "5ed5e6774536",
    "replaced": "41a7e4929e21",
    "room": "132997e481f2",
    "room_open": "48d2face4790",
    "streams": "4187757bfe58",
    "streams_busy": "e4f82832b5dc",
    "streams_narrow": "bc430c986657",
    "street": "1b746bd6f773",
    "street_narrow": "8f1a71bae16b",
    "unicycle": "3a447d8bd0a9",
    "unicycle_slow": "b3c16e44fe20",
}
"""Those of the scenarios that ship; results have them."""


@pytest.fixture
def shipped(shared):
    """The digests of all scenarios that ship, as they are now."""
    folders = {"dut": shared / "data" / "dut", "eth": shared / "data" / "eth_ucy"}

    def find():
        simulated = set(simulated_scenarios())
        others = {name: folders["dut" if name.startswith("dut") else "eth"] for name, _ in scenarios()}
        return {
            name: load_scenario(name, data=None if name in simulated else folder).digest
            for name, folder in others.items()
        }

    return find


def test_the_digests_of_the_simulated_scenarios_stay():
    """Where this fails because a default is another one, `crowdbench.scenario.load.VERSION` must be raised."""
    digests = {name: load_scenario(name).digest for name in simulated_scenarios()}
    assert digests.items() <= SCENARIOS.items()
    assert len(digests) == 53


@pytest.mark.slow
def test_the_digests_of_all_scenarios_stay(shipped):
    assert shipped() == SCENARIOS


def later_defaults(monkeypatch):
    """Give every kind of table in a scenario's file a key that comes later, with a default."""

    class LaterTracks(schema.TracksSpec):
        speed: float = number(1.0, above=0.0, below=100.0)

    class LaterVehicle(schema.VehicleSpec):
        mass: float | None = number(None, above=0.0, below=1000.0)

    class LaterGoalChange(GoalChange):
        jump: float = number(0.5, least=0.0, below=1.0)

    class LaterPedestrians(schema.PedestriansSpec):
        hurry: float = number(0.5, least=0.0, below=1.0)
        goal_change: LaterGoalChange | None = None

    class Later(schema.ScenarioSpec):
        sight: float = number(10.0, above=0.0, below=100.0)
        pedestrians: LaterPedestrians = table("pedestrians")
        tracks: LaterTracks | None = None

    def later(rng, radius, preferred_speed, *, circle_radius=4.0, perturbation=0.0, walls=0.0):
        return circle_crossing(rng, radius, preferred_speed, circle_radius=circle_radius, perturbation=perturbation)

    for spec in (Later, LaterVehicle, LaterPedestrians):
        monkeypatch.setattr(schema, spec.__base__.__name__, spec)
    monkeypatch.setitem(LAYOUTS, "circle_crossing", later)
    monkeypatch.setattr(ORCA, "parameters", {**ORCA.parameters, "patience": 1.0})


@pytest.mark.slow
def test_a_new_key_with_a_default_changes_no_digest_of_a_scenario(monkeypatch):
    before = {name: load_scenario(name) for name in simulated_scenarios()}
    later_defaults(monkeypatch)
    after = {name: load_scenario(name) for name in simulated_scenarios()}
    new = {"sight", "vehicle.mass", "pedestrians.hurry", "layout.walls", "pedestrians.orca.patience"}
    assert new < set(flat(after["circle_crossing_5"].table))
    assert {name: scenario.digest for name, scenario in after.items()}.items() <= SCENARIOS.items()
    assert "pedestrians.goal_change.jump" in flat(after["restless_20"].table)
    # The tables of results that are there already.
    again = {name: load_recorded_scenario(scenario.table, "result.json") for name, scenario in before.items()}
    assert {name: scenario.digest for name, scenario in again.items()}.items() <= SCENARIOS.items()
    for key in sorted(new):
        assert load_scenario("circle_crossing_5", {key: 0.75}).digest != SCENARIOS["circle_crossing_5"]


@pytest.mark.slow
def test_a_new_key_with_a_default_changes_no_digest_with_recorded_people(monkeypatch, shipped):
    later_defaults(monkeypatch)
    assert shipped() == SCENARIOS


def test_the_digest_changes_with_a_policys_file(tmp_path):
    text = (PEDESTRIANS.folder / "orca.py").read_text()
    digest = {}
    for folder, comment in (("a", ""), ("b", ""), ("c", "# changed")):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "crowd.py").write_text(text + comment)
        (tmp_path / folder / "mine.toml").write_text("[pedestrians]\npolicy = 'crowd.py'\n")
        digest[folder] = load_scenario(str(tmp_path / folder / "mine.toml")).digest
    assert digest["a"] == digest["b"] != digest["c"]
