"""Digests of scenarios: they stay, also when a key with a default comes later, and tell what differs."""

import json

import pytest

from crowdbench.catalog import PEDESTRIANS, load_scenario, scenarios, simulated_scenarios
from crowdbench.scenario import schema
from crowdbench.scenario.digest import BUILT_IN, compute_digest
from crowdbench.scenario.layouts import LAYOUTS
from crowdbench.scenario.layouts.crossings import circle_crossing
from crowdbench.sim.pedestrians import ORCA, StopAndGo
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
    # A length belongs to vehicles on wheels, and a share of those who see the vehicle to a visible one.
    elsewhere = {"vehicle.length", "pedestrians.sees_vehicle"}
    changes = [{}, *({key: other(key)} for key in DEFAULTS if key not in elsewhere)]
    changes += [{"vehicle.dynamics": "unicycle", key: 1.0} for key in ("vehicle.length", "vehicle.max_angular_speed")]
    changes.append({"layout.generator": "square_crossing", "layout.square_width": 9.0})
    changes.append({"vehicle.visible": True, "pedestrians.sees_vehicle": 0.5})
    assert len(changes) == 43
    assert len({all_defaults(change).digest for change in changes}) == len(changes)


def test_a_results_table_has_the_digest_of_its_scenario_whatever_it_says_of_it():
    for change in ({}, {"pedestrians.policy": {"orca": 2, "social_force": 1}}, {"pedestrians.number": [1, 3]}):
        scenario = load_scenario("circle_crossing_5", change)
        result = {"name": "mine", "digest": "of version 1", **scenario.table, "description": "another"}
        assert compute_digest(json.loads(json.dumps(result))) == scenario.digest


SCENARIOS = {
    "circle_crossing_10": "99db7ad6d68a",
    "circle_crossing_5": "62b37e5ddf61",
    "circle_crossing_5_gaussian": "158d2409960c",
    "circle_crossing_5_social_force": "bb7bd7ef9d67",
    "circle_crossing_5_visible": "95bdfee2e846",
    "crowdnav_plus_20": "2f87b295e48b",
    "crowdnav_plus_20_random": "a2c4d2eaa318",
    "square_crossing_5": "53f7c8ebd351",
    "circle_crossing_20_far": "e6a7a4baf971",
    "circle_crossing_6_near": "374634a73e3c",
    "power_law_16": "bde89d0bb688",
    "sizes_speeds_12": "79886f7b9cf7",
    "office_8": "583946043f2c",
    "shop_10": "b3138229799e",
    "dut_reactive": "06d9b7aea276",
    "dut_recorded": "598d0df1efcd",
    "eth_reactive": "916015641165",
    "eth_recorded": "d0a2398f0b72",
    "hotel_reactive": "4aa4fa621557",
    "hotel_recorded": "22b48a28b1b6",
    "univ_reactive": "0e75aedc15a2",
    "univ_recorded": "7e065089a0e2",
    "zara1_reactive": "f966496675c2",
    "zara1_recorded": "e932bb521f07",
    "zara2_reactive": "91df46104631",
    "zara2_recorded": "2573d9f6e021",
    "blind_corner_3": "6e63caff4d9b",
    "blocks_12": "0978c361837f",
    "blocks_12_perfect_sight": "32c7dd08d514",
    "car_12": "a94b74653774",
    "circle_crossing_20": "7ef6ce5a66ce",
    "circle_crossing_20_seen": "29faad8776ee",
    "corridor_8": "b996e5e9479b",
    "doorway_8": "05c961226fb1",
    "groups_12": "5f38bbc05cbe",
    "half_half_20": "bd2ad987c705",
    "intersection_16": "579ec4e6a5a1",
    "intersection_16_seen": "4b2af4009150",
    "noisy_10": "e975b4dc20c9",
    "restless_20": "7f450e91e165",
    "unicycle_10": "b3d24b1baf79",
    "thousand": "c3a456a54a8b",
    "car": "273572b68c17",
    "circle_crossing_mixed": "ba5dc8813c51",
    "corner": "1325cc79920d",
    "corridor": "d8a646f1aad3",
    "distracted": "8c319ae32ef6",
    "door": "0f5ac85bca73",
    "door_narrow": "6a914a6f1f41",
    "far": "28017f5bd912",
    "groups": "932687619594",
    "mixed": "0ed3e3484c8f",
    "near": "3984be0dff7b",
    "noise": "dbf6d541f90f",
    "noise_late": "5e9496d6f8c0",
    "replaced": "550a8ddbf6eb",
    "room": "858c6594570b",
    "room_open": "006aa3e68bd5",
    "streams": "c62a398fcf0a",
    "streams_busy": "c9b748ce07ed",
    "streams_narrow": "c69c2789c0b4",
    "street": "deffc12467b7",
    "street_narrow": "e2f51726dd1c",
    "unicycle": "e97ef2050376",
    "unicycle_slow": "275eb8729187",
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
    """Where this fails because a default is another one, `crowdbench.scenario.digest.VERSION` must be raised."""
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

    class LaterGoalChange(schema.GoalChangeSpec):
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

    for module in ("load", "digest"):
        monkeypatch.setattr(f"crowdbench.scenario.{module}.ScenarioSpec", Later)
    monkeypatch.setattr("crowdbench.scenario.digest.GoalChangeSpec", LaterGoalChange)
    for module in ("load", "schema"):
        monkeypatch.setattr(f"crowdbench.scenario.{module}.VehicleSpec", LaterVehicle)
        monkeypatch.setattr(f"crowdbench.scenario.{module}.PedestriansSpec", LaterPedestrians)
    monkeypatch.setitem(LAYOUTS, "circle_crossing", later)
    monkeypatch.setattr(ORCA, "parameters", {**ORCA.parameters, "patience": 1.0})
    monkeypatch.setitem(BUILT_IN, "distracted", StopAndGo(ORCA()))  # which has the parameters of ORCA too


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
    assert {name: compute_digest(scenario.table) for name, scenario in before.items()}.items() <= SCENARIOS.items()
    for key in sorted(new):
        assert load_scenario("circle_crossing_5", {key: 0.75}).digest != SCENARIOS["circle_crossing_5"]


@pytest.mark.slow
def test_a_new_key_with_a_default_changes_no_digest_with_recorded_people(monkeypatch, shipped):
    later_defaults(monkeypatch)
    assert shipped() == SCENARIOS


def test_the_digest_knows_all_built_in_policies():
    built_in = {path.stem: PEDESTRIANS.load(path.stem)[1].parameters for path in PEDESTRIANS.folder.glob("*.py")}
    assert {name: policy.parameters for name, policy in BUILT_IN.items()} == built_in


def test_the_digest_changes_with_a_policys_file(tmp_path):
    text = (PEDESTRIANS.folder / "orca.py").read_text()
    digest = {}
    for folder, comment in (("a", ""), ("b", ""), ("c", "# changed")):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "crowd.py").write_text(text + comment)
        (tmp_path / folder / "mine.toml").write_text("[pedestrians]\npolicy = 'crowd.py'\n")
        digest[folder] = load_scenario(str(tmp_path / folder / "mine.toml")).digest
    assert digest["a"] == digest["b"] != digest["c"]
