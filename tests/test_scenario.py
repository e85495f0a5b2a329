import json

import numpy as np
import pytest

from crowdbench.catalog import PEDESTRIANS, load_policy, load_scenario, simulated_scenarios
from crowdbench.errors import InputError
from crowdbench.scenario import schema
from crowdbench.scenario.cases import Cases, parse_case
from crowdbench.scenario.digest import BUILT_IN, digest_of
from crowdbench.scenario.layouts import LAYOUTS
from crowdbench.scenario.layouts.crossings import circle_crossing
from crowdbench.sim.pedestrians import ORCA
from crowdbench.toml_file import number
from crowdbench.types import World

ARRAYS = ("key", "position", "goal", "radius", "preferred_speed", "present", "policy")


def arrays(world: World):
    return [getattr(world, name) for name in ARRAYS] + [
        values for table in world.parameters.values() for values in table.values()
    ]


def equal(one, two):
    return all(np.array_equal(a, b) for a, b in zip(arrays(one), arrays(two), strict=True))


@pytest.mark.parametrize("scenario", ["circle_crossing_5", "circle_crossing_5_gaussian", "square_crossing_5"])
def test_a_case_does_not_depend_on_its_batch(scenario):
    place = load_scenario(scenario)
    together = place.draw("test", np.array([3, 700, 12, 4]))
    for row, case in enumerate((3, 700, 12, 4)):
        assert equal(together.take(np.array([row])), place.draw("test", np.array([case])))


@pytest.mark.slow
def test_cases_outside_crowdnavs_500_are_all_different():
    place = load_scenario("circle_crossing_5")
    ranges = (("test", 480, 700), ("val", 0, 200), ("train", 0, 400))
    drawn = [place.draw(split, np.arange(start, stop)) for split, start, stop in ranges]
    starts = np.concatenate([world.position[:, 1] for world in drawn])
    assert len(np.unique(starts, axis=0)) == len(starts)


@pytest.mark.slow
def test_nobody_starts_too_close_to_anybody():
    for scenario in ("circle_crossing_10", "square_crossing_5", "circle_crossing_5_gaussian"):
        world = load_scenario(scenario).draw("val", np.arange(200))
        distance = np.linalg.norm(world.position[:, :, None] - world.position[:, None], axis=-1)
        reach = world.radius[:, :, None] + world.radius[:, None] + 0.2
        agents = np.arange(distance.shape[1])
        distance[:, agents, agents] = np.inf
        assert (distance >= reach - 1e-12).all()


def test_gaussian_parameters_vary_within_their_bounds():
    world = load_scenario("circle_crossing_5_gaussian").draw("val", np.arange(400))
    speed = world.preferred_speed[:, 1:]
    assert 0.5 <= speed.min() < 0.6
    assert 1.4 < speed.max() <= 1.5
    assert abs(speed.mean() - 1.0) < 0.02
    horizon = world.parameters["orca"]["time_horizon"][:, 1:]
    assert 2.0 <= horizon.min() < horizon.max() <= 8.0
    assert (world.preferred_speed[:, 0] == 1.0).all()
    assert world.position[:, 0].std(axis=0).min() > 0.1
    assert world.goal[:, 0].std(axis=0).min() > 0.1


def test_a_number_range_gives_worlds_of_every_size():
    world = load_scenario("circle_crossing_5", {"pedestrians.number": [1, 4]}).draw("val", np.arange(100))
    numbers = world.present[:, 1:].sum(axis=1)
    assert set(numbers) == {1, 2, 3, 4}
    assert world.present[:, 0].all()
    assert (np.diff(world.present.astype(int), axis=1) <= 0).all()


def test_no_pedestrians_is_a_crowd_too():
    world = load_scenario("circle_crossing_5", {"pedestrians.number": 0}).draw("test", np.arange(3))
    assert world.position.shape == (3, 1, 2)


@pytest.mark.slow
def test_policies_share_a_crowd_as_asked():
    place = load_scenario("circle_crossing_5", {"pedestrians.policy": {"orca": 3, "social_force": 1}})
    assert list(place.policies) == ["orca", "social_force"]
    assert place.draw("val", np.arange(400)).policy.mean() == pytest.approx(0.25, abs=0.04)


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
    assert len(changes) == 42
    assert len({all_defaults(change).digest for change in changes}) == len(changes)


def test_a_new_key_with_a_default_changes_no_digest(monkeypatch):
    class Later(schema.ScenarioSpec):
        sight: float = number(10.0, above=0.0, below=100.0)

    def later(rng, radius, preferred_speed, *, circle_radius=4.0, perturbation=0.0, walls=0.0):
        return circle_crossing(rng, radius, preferred_speed, circle_radius=circle_radius, perturbation=perturbation)

    scenarios = ("circle_crossing_5", "circle_crossing_5_gaussian", "circle_crossing_5_social_force")
    before = [load_scenario(name) for name in scenarios]
    digests = [scenario.digest for scenario in before]
    monkeypatch.setattr("crowdbench.scenario.file.ScenarioSpec", Later)
    monkeypatch.setattr("crowdbench.scenario.digest.ScenarioSpec", Later)
    monkeypatch.setitem(LAYOUTS, "circle_crossing", later)
    monkeypatch.setattr(ORCA, "parameters", {**ORCA.parameters, "patience": 1.0})
    after = [load_scenario(name) for name in scenarios]
    assert {"sight", "layout.walls", "pedestrians.orca.patience"} < set(flat(after[0].table))
    assert [scenario.digest for scenario in after] == digests
    assert [digest_of(scenario.table) for scenario in before] == digests
    for change in ({"sight": 9.0}, {"layout.walls": 1.0}, {"pedestrians.orca.patience": 2.0}):
        assert load_scenario("circle_crossing_5", change).digest != digests[0]


def test_a_results_table_has_the_digest_of_its_scenario_whatever_it_says_of_it():
    for change in ({}, {"pedestrians.policy": {"orca": 2, "social_force": 1}}, {"pedestrians.number": [1, 3]}):
        scenario = load_scenario("circle_crossing_5", change)
        result = {"name": "mine", "digest": "of version 1", **scenario.table, "description": "another"}
        assert digest_of(json.loads(json.dumps(result))) == scenario.digest


DIGESTS = {
    "blind_corner": "c037ed08131e",
    "blind_corner_3": "6e63caff4d9b",
    "blocks_12": "0978c361837f",
    "car_12": "a94b74653774",
    "circle_crossing_10": "99db7ad6d68a",
    "circle_crossing_20": "e2a5890198b7",
    "circle_crossing_20_wide": "e5da681cd148",
    "circle_crossing_5": "62b37e5ddf61",
    "circle_crossing_5_car": "b047cd55b71e",
    "circle_crossing_5_gaussian": "158d2409960c",
    "circle_crossing_5_social_force": "bb7bd7ef9d67",
    "circle_crossing_5_unicycle": "87916ba303c1",
    "circle_crossing_5_visible": "95bdfee2e846",
    "circle_crossing_limited_sight": "dba52d1a2617",
    "circle_crossing_mixed": "ba5dc8813c51",
    "companions": "6eab92864111",
    "corridor": "593019e6d69a",
    "corridor_8": "a596b6ac844f",
    "crowdnav_plus_20": "2f87b295e48b",
    "crowdnav_plus_20_random": "a2c4d2eaa318",
    "doorway": "117ab1cf4b4f",
    "doorway_8": "90e07422567f",
    "groups_12": "5f38bbc05cbe",
    "half_half_20": "0a43f27b8b0a",
    "intersection": "a6c6c1a6c0a8",
    "intersection_16": "3c1546c1e1c3",
    "noisy_10": "e975b4dc20c9",
    "power_law_10": "f51afeb816b3",
    "restless": "990aab580523",
    "restless_20": "7f450e91e165",
    "room": "c10cd0679e5e",
    "square_crossing_5": "53f7c8ebd351",
    "thousand": "c3a456a54a8b",
    "traffic": "5c3615765887",
    "unicycle_10": "039b6697c8c9",
}


def test_the_digests_of_the_built_in_scenarios_stay():
    """Where this fails because a default is another one, `crowdbench.scenario.digest.VERSION` must be raised."""
    assert {name: load_scenario(name).digest for name in simulated_scenarios()} == DIGESTS


def test_the_digest_knows_all_built_in_policies():
    built_in = {path.stem: load_policy(path.stem)[1].parameters for path in PEDESTRIANS.folder.glob("*.py")}
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


def test_the_order_of_shares_changes_nothing():
    one, two = (
        load_scenario("circle_crossing_5", {"pedestrians.policy": shares})
        for shares in ({"orca": 0.7, "social_force": 0.3}, {"social_force": 0.3, "orca": 0.7})
    )
    assert one.digest == two.digest
    assert equal(one.draw("val", np.arange(20)), two.draw("val", np.arange(20)))


def test_whole_parameters_stay_whole():
    gaussian = {"mean": 3, "std": 2.0, "low": 1, "high": 6}
    world = load_scenario("circle_crossing_5", {"pedestrians.orca.max_neighbors": gaussian}).draw("val", np.arange(50))
    assert set(world.parameters["orca"]["max_neighbors"][:, 1:].ravel()) == {1, 2, 3, 4, 5, 6}


BROKEN = {
    "colision = 'swept'": ["colision", "unknown key", "collision"],
    "collision = 'sweep'": ["collision", "swept", "crowdnav"],
    "dt = '0.25'": ["dt", "number"],
    "dt = 1e-9": ["dt", "100000 steps"],
    "[pedestrians]\npolicy = {orca = inf}": ["pedestrians.policy", "shares"],
    "[pedestrians]\npolicy = {orca = 1, 'ORCA_FILE' = 1}": ["pedestrians.policy", "both called orca"],
    "dt = -1": ["dt", "-1", "above 0"],
    "[pedestrians]\nnumber = 60": ["no room", "pedestrians.number", "circle_radius"],
    "[pedestrians]\nnumber = -1": ["pedestrians.number", "whole number"],
    "[pedestrians]\nnumber = [5, 2]": ["pedestrians.number", "least, most"],
    "[pedestrians]\npolicy = 'orka'": ["orka", "orca"],
    "[pedestrians]\nradius = {mean = 0.3, std = 0.1}": ["pedestrians.radius", "Gaussian"],
    "[pedestrians.orca]\ntime_horison = 3": ["pedestrians.orca.time_horison", "time_horizon"],
    "[pedestrians.social_force]\nx = 3": ["pedestrians.social_force", "unknown key"],
    "[layout]\ngenerator = 'circle'": ["layout.generator", "circle_crossing"],
    "[layout]\ncircle_radius = 'wide'": ["layout.circle_radius", "number"],
    "[layout]\nsquare_width = 3": ["layout.square_width", "circle_radius"],
    "[vehicle]\nvisible = 1": ["vehicle.visible", "true or false"],
    "vehicle = 3": ["vehicle", "table"],
    "time_limit = ": ["TOML"],
    "seed = 1.0": ["seed is 1.0", "whole number from 0"],
    "dt = true": ["dt is True", "number above 0"],
    "time_limit = nan": ["time_limit is nan", "number above 1"],
    "description = 3": ["description is 3", "text in quotes"],
    "[pedestrians]\nnumber = true": ["pedestrians.number is True", "whole number"],
    "[pedestrians]\nnumber = [1, 2, 3]": ["pedestrians.number is [1, 2, 3]", "least, most"],
    "[pedestrians]\nradius = 0": ["pedestrians.radius is 0", "at least 0.001"],
    "[pedestrians]\nradius = {men = 1, std = 0, low = 1, high = 1}": [
        "unknown key pedestrians.radius.men",
        "mean, std",
    ],
    "[pedestrians]\nradius = {mean = 1, std = 1, low = 1, high = 1}": ["pedestrians.radius is {'mean'", "tenth of std"],
    "[pedestrians.orca]\ntime_horizon = -3": ["pedestrians.orca.time_horizon is -3", "at least 0"],
    "[pedestrians]\norca = 3": ["pedestrians.orca is 3", "a table [pedestrians.orca]"],
    "[sensor]\nfield_of_view = 400": ["sensor.field_of_view is 400", "above 0 and up to 360"],
    "[sensor]\nmissed = 1.0": ["sensor.missed is 1.0", "of at least 0 and below 1"],
    "[sensor.noise]\nspeed = 0.1": ["unknown key sensor.noise.speed", "position, velocity"],
    "[sensor]\nlidar = { beams = 9 }": ["sensor.lidar.range is missing", "above 0"],
    "[sensor]\nlidar = 9": ["sensor.lidar is 9", "a table [sensor.lidar] with beams and range"],
    "[vehicle]\nradus = 1\nradius = 'x'": ["unknown key vehicle.radus", "visible, radius, preferred_speed"],
    "[vehicle]\ndynamics = 'tank'": ["vehicle.dynamics is 'tank'", '"holonomic", "unicycle", "bicycle"'],
    "[vehicle]\nwheelbase = 2.0": ["vehicle.wheelbase is given", "left out where dynamics is holonomic", "bicycle"],
    "[vehicle]\ndynamics = 'unicycle'\nmax_steering = 0.5": ["vehicle.max_steering is given", "dynamics is unicycle"],
    "[vehicle]\ndynamics = 'unicycle'\nmax_angular_speed = 20": ["vehicle.max_angular_speed is 20", "12.5664 rad/s"],
    "[vehicle]\ndynamics = 'bicycle'\nmax_steering = 2": ["in vehicle, max_steering is 2.0", "1.5 at most"],
    "[vehicle]\nlength = 2.0": ["vehicle.length is 2", "holonomic"],
    "[vehicle]\ndynamics = 'unicycle'\nlength = 0.5": ["vehicle.length is 0.5", "twice the radius"],
    "[vehicle]\ndynamics = 'bicycle'\nlength = 2.5": ["vehicle.length is 2.5", "2.7 or more, the wheelbase"],
    "[vehicle]\ngoal_tolerance = 0": ["vehicle.goal_tolerance is 0", "a number above 0"],
}


@pytest.mark.parametrize("text", BROKEN)
def test_a_broken_file_gets_one_sentence(tmp_path, text):
    path = tmp_path / "mine.toml"
    path.write_text(text.replace("ORCA_FILE", str(PEDESTRIANS.folder / "orca.py")))
    with pytest.raises(InputError) as error:
        load_scenario(str(path)).worlds(Cases.parse("1"))
    message = str(error.value)
    assert "\n" not in message
    for part in BROKEN[text]:
        assert part in message
    if "policy" not in text:
        assert "mine.toml" in message


def test_people_are_placed_anew_where_the_last_one_finds_no_room():
    # In one of these attempts the first 19 stand so that nobody else finds room.
    start = load_scenario("half_half_20").draw("train", np.array([1447966886])).position[0]
    gaps = np.linalg.norm(start[:, None] - start, axis=2)[~np.eye(len(start), dtype=bool)] - 0.6
    assert gaps.min() >= 0.2


def test_a_missing_scenario_is_told_with_what_there_is():
    with pytest.raises(InputError, match=r"circle_crossing_5, .*square_crossing_5"):
        load_scenario("circle_crossing_7")
    with pytest.raises(InputError, match=r"nowhere.toml cannot be read"):
        load_scenario("nowhere.toml")


@pytest.mark.parametrize(
    ("text", "expected"),
    [("500", "test:0:500"), ("2000:2500", "test:2000:2500"), ("val:100", "val:0:100"), ("train:5:6", "train:5:6")],
)
def test_cases_are_read(text, expected):
    assert str(Cases.parse(text)) == expected


@pytest.mark.parametrize("text", ["0", "5:5", "dev:3", "-1", "", "a", "1:2:3", "test:", "5.5"])
def test_cases_that_are_none_are_refused(text):
    with pytest.raises(InputError, match="2000:2500"):
        Cases.parse(text)


def test_a_case_is_named_by_split_and_number():
    assert parse_case("test:37") == ("test", 37)
    for text in ("37", "test:-1", "dev:1", "test:1:2"):
        with pytest.raises(InputError, match="test:37"):
            parse_case(text)
