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
    # A length belongs to vehicles on wheels, and attention to a visible vehicle.
    elsewhere = {"vehicle.length", "pedestrians.attention"}
    changes = [{}, *({key: other(key)} for key in DEFAULTS if key not in elsewhere)]
    changes += [{"vehicle.dynamics": "unicycle", key: 1.0} for key in ("vehicle.length", "vehicle.max_angular_speed")]
    changes.append({"layout.generator": "square_crossing", "layout.square_width": 9.0})
    changes += [{"vehicle.visible": True, "pedestrians.attention": {"ignores": share}} for share in (0.0, 0.1)]
    assert len(changes) == 46
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
    "circle_crossing_20_far": "2b1b2b957ccd",
    "circle_crossing_6_near": "8abdf438f674",
    "power_law_16": "f4180158b8a4",
    "sizes_speeds_12": "1ac2d6c728da",
    "office_8": "7071b47b80f1",
    "shop_10": "5603fe27bb17",
    "dut_reactive": "6f68af72aa79",
    "dut_recorded": "1709cd62e8b8",
    "eth_reactive": "ed5df798d05e",
    "eth_recorded": "0c36b4541812",
    "hotel_reactive": "63c33d89082a",
    "hotel_recorded": "072add4f3c32",
    "univ_reactive": "f000e0752b92",
    "univ_recorded": "fb42835fd745",
    "zara1_reactive": "00e9583bcadb",
    "zara1_recorded": "c0e0d53c162c",
    "zara2_reactive": "1d60a7fe8e2b",
    "zara2_recorded": "4070a43d2e04",
    "blind_corner_5": "07acc60b5e5b",
    "blocks_12": "d05084809060",
    "blocks_12_perfect_sight": "53f57ed274cc",
    "car_12": "b7c4e0ac5e12",
    "circle_crossing_20": "a3de03edb483",
    "circle_crossing_20_seen": "981db8afa2ad",
    "corridor_8": "a752f18a394e",
    "doorway_10": "881bcb2fd589",
    "groups_12": "285fc6313530",
    "half_half_20": "a5b0a85acf98",
    "intersection_16": "ecbafe71effc",
    "intersection_16_seen": "cb96ad8713c1",
    "noisy_10": "45747f729449",
    "restless_20": "03dfa9411dfc",
    "unicycle_10": "29ce012c025d",
    "thousand": "e36f380ce83f",
    "car": "4fac2a947a41",
    "car_crowd": "f7483ae99d62",
    "circle_crossing_mixed": "d15147d2f474",
    "corner": "45107cecc00a",
    "stop_and_go": "786994e91001",
    "corridor": "2c72d4518668",
    "door": "c64aafa6f9fb",
    "door_narrow": "8b241ebdd687",
    "far": "9f729c82f3ee",
    "groups": "3d4b782cf501",
    "mixed": "86b97a3fd4c7",
    "near": "8d734edda095",
    "noise": "937f213ce514",
    "noise_late": "752f7be03695",
    "replaced": "c49013a14565",
    "room": "d93048479025",
    "room_open": "06067646f2bf",
    "streams": "abc579c34ad5",
    "streams_busy": "85d3e2b77ea8",
    "streams_narrow": "3f940a5c659b",
    "street": "b3f75db67751",
    "street_narrow": "a4095d2ae845",
    "unicycle": "785776854a49",
    "unicycle_crowd": "c6112e478ab3",
    "corner_crowd": "e69699bb2b7d",
    "door_crowd": "e0f2c7612edc",
    "room_crowd": "4f6767b10557",
    "streams_crowd": "ea699e4b6066",
    "street_crowd": "569c4150a74e",
    "unicycle_slow": "f29ddec95660",
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
    """Where this fails because a default is another one, `crowdbench.scenario.scenario_file.VERSION` must be raised."""
    digests = {name: load_scenario(name).digest for name in simulated_scenarios()}
    assert digests.items() <= SCENARIOS.items()
    assert len(digests) == 60


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

    def later(rng, radius, preferred_speed, *, circle_radius=4.0, perturbation=0.0, goal_angle=0.0, walls=0.0):
        options = {"circle_radius": circle_radius, "perturbation": perturbation, "goal_angle": goal_angle}
        return circle_crossing(rng, radius, preferred_speed, **options)

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
