"""Digests of scenarios: they stay, and tell what differs."""

import json

import pytest

from crowdbench.catalog import PEDESTRIANS, load_recorded_scenario, load_scenario, scenarios, simulated_scenarios
from crowdbench.scenario import schema
from crowdbench.utils.toml import number


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
    "vehicle.command_delay": 0.5,
    "vehicle.lag": 0.5,
    "vehicle.number": 2,
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
    "pedestrians.limits": {"acceleration": 1.5, "braking": 3.0, "sideways": 2.0},
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
    # A length belongs to vehicles on wheels, attention to a visible vehicle, and a digest to a file.
    elsewhere = {"vehicle.length", "pedestrians.attention", "layout.generator_file"}
    changes = [{}, *({key: other(key)} for key in DEFAULTS if key not in elsewhere)]
    changes += [{"vehicle.dynamics": "unicycle", key: 1.0} for key in ("vehicle.length", "vehicle.max_angular_speed")]
    changes.append({"layout.generator": "square_crossing", "layout.square_width": 9.0})
    changes += [{"vehicle.visible": True, "pedestrians.attention": {"ignores": share}} for share in (0.0, 0.1)]
    assert len(changes) == 49
    assert len({all_defaults(change).digest for change in changes}) == len(changes)


def test_a_results_table_makes_the_same_scenario_whatever_it_says_of_it():
    shares = {"orca": 2, "social_force": 1, "power_law": 4}
    for change in ({}, {"pedestrians.policy": shares}, {"pedestrians.number": [1, 3]}):
        scenario = load_scenario("circle_crossing_5", change)
        result = {"name": "mine", **scenario.table, "description": "another"}
        result = json.loads(json.dumps(result))
        again = load_recorded_scenario(result, "result.json")
        assert (again.digest, again.crowd) == (scenario.digest, scenario.crowd)


SCENARIOS = {
    "circle_crossing_10": "fbcf8d430379",
    "circle_crossing_5": "e088f39a0db4",
    "circle_crossing_5_gaussian": "25fff81d10f0",
    "circle_crossing_5_social_force": "cdd5029f26b9",
    "circle_crossing_5_visible": "eb98d2c5b14d",
    "crowdnav_plus_20": "c7251e455f9a",
    "crowdnav_plus_20_random": "dcf3a52782f8",
    "square_crossing_5": "26a20b23407b",
    "power_law_16": "dd54f2f079a4",
    "office_8": "cd2493053e29",
    "shop_10": "b6e5489e0f77",
    "dut_reactive": "aceb6e97cc81",
    "dut_recorded": "387ceb9714e2",
    "eth_reactive": "1329b41764d4",
    "eth_recorded": "1d227233ec01",
    "hotel_reactive": "11b934eba7f8",
    "hotel_recorded": "5a6527558fb7",
    "univ_reactive": "6faf1264a4ed",
    "univ_recorded": "e4f27fdc491c",
    "zara1_reactive": "9f39af4c4046",
    "zara1_recorded": "4aef98a250c4",
    "zara2_reactive": "8ef55688c63e",
    "zara2_recorded": "d877a162b237",
    "blocks_12": "70d12a72044e",
    "car_28": "a721b09b69f8",
    "groups_12": "c783f44a58a4",
    "thousand": "923d5bab2100",
    "car": "6df1412ffe68",
    "car_crowd": "def1216136c2",
    "circle_crossing_mixed": "b693ea2fc7e9",
    "corner": "3c6870fd3757",
    "stop_and_go": "d12323aea65d",
    "corridor": "2b8a73b3e5d4",
    "door": "62b642b273a1",
    "door_narrow": "c79bdba9817e",
    "far": "2a982313178e",
    "groups": "b5f9cf0c782c",
    "mixed": "aed752215ac4",
    "near": "6fa75dd40ffb",
    "replaced": "e06c551f36d9",
    "room": "2c17809cda00",
    "room_open": "0b9d29a08fe9",
    "streams": "587be427898a",
    "streams_busy": "8d6a0db9adc6",
    "streams_narrow": "786f2aca71ad",
    "street": "fc5a8249173a",
    "street_narrow": "7c5256b730c4",
    "unicycle": "b7e3de9a7748",
    "unicycle_crowd": "5ddc5829d7ac",
    "corner_crowd": "da5c3d2d98d9",
    "door_crowd": "990d8a088d21",
    "room_crowd": "aaad57a93d01",
    "legs": "04a820af168b",
    "streams_crowd": "79b608a711ff",
    "street_crowd": "47b4d56c5cb4",
    "unicycle_slow": "cd2ed60dba7a",
    "far_20": "fc08e554599b",
    "circle_20_blind": "469d901bc742",
    "streets_16_blind": "3de0a7cc335f",
    "circle_20": "c9a9a020dcb5",
    "corner_5": "97dc3ab83580",
    "door_10": "e41fa42fedb8",
    "mixed_20": "87890c8bacd0",
    "street_8": "4427298460e8",
    "streets_16": "03c8a768c215",
    "car_crowd_tracks": "65dcaaf9a3a6",
    "corner_crowd_tracks": "fa2ecf297224",
    "door_crowd_tracks": "81b43eff06a0",
    "mixed_tracks": "90cbb902e180",
    "room_crowd_tracks": "c4902cf4517d",
    "streams_busy_tracks": "8627f617d00c",
    "streams_crowd_tracks": "dc0698495ed1",
    "street_crowd_tracks": "762c96a4a160",
    "unicycle_crowd_tracks": "dda4926fbf1d",
    "fleet_4": "fa0f98d5661b",
    "fleet_door_3": "d58d89fd8995",
}
"""Those of the scenarios that ship; results have them."""


def test_the_digests_of_the_simulated_scenarios_stay():
    digests = {name: load_scenario(name).digest for name in simulated_scenarios()}
    assert digests.items() <= SCENARIOS.items()
    assert len(digests) == 64


@pytest.mark.slow
def test_the_digests_of_recorded_scenarios_stay(shared):
    recorded = {name for name, _ in scenarios()} - set(simulated_scenarios())
    folders = {name: shared / "data" / ("dut" if name.startswith("dut") else "eth_ucy") for name in recorded}
    digests = {name: load_scenario(name, data=folder).digest for name, folder in folders.items()}
    assert digests == {name: SCENARIOS[name] for name in recorded}


def test_a_new_key_without_a_value_changes_no_digest(monkeypatch):
    class LaterVehicle(schema.VehicleSpec):
        mass: float | None = number(None, above=0.0, below=1000.0)

    monkeypatch.setattr(schema, "VehicleSpec", LaterVehicle)
    later = load_scenario("circle_crossing_5")
    assert later.table["vehicle"]["mass"] is None
    assert later.digest == SCENARIOS["circle_crossing_5"]
    assert load_scenario("circle_crossing_5", {"vehicle.mass": 80.0}).digest != later.digest


def test_the_digest_changes_with_a_policys_file(tmp_path):
    text = (PEDESTRIANS.folder / "orca.py").read_text()
    digest = {}
    for folder, comment in (("a", ""), ("b", ""), ("c", "# changed")):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "crowd.py").write_text(text + comment)
        (tmp_path / folder / "mine.toml").write_text("[pedestrians]\npolicy = 'crowd.py'\n")
        digest[folder] = load_scenario(str(tmp_path / folder / "mine.toml")).digest
    assert digest["a"] == digest["b"] != digest["c"]
