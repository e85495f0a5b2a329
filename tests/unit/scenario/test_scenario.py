from pathlib import Path

import numpy as np
import pytest

from crowdbench.catalog import PEDESTRIANS, load_scenario
from crowdbench.core.types import World
from crowdbench.scenario.cases import Cases, parse_case
from crowdbench.utils.errors import InputError

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
    "time_limit_factor = 0": ["time_limit_factor is 0", "number above 0"],
    "time_limit_factor = '4 T'": ["time_limit_factor is '4 T'", "number above 0"],
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
    "[vehicle]\nwheelbase = 2.0": ["unknown key vehicle.wheelbase", "command_delay, lag, number, max_acceleration"],
    "[vehicle]\ndynamics = 'unicycle'\nmax_steering = 0.5": ["unknown key vehicle.max_steering", "max_angular_speed"],
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
    file = Path(__file__).parents[3] / "studies" / "scenarios" / "half_half_20.toml"
    scenario = load_scenario(str(file), {"pedestrians.clear_space": None})
    start = scenario.draw("train", np.array([1447966886])).position[0]
    gaps = np.linalg.norm(start[:, None] - start, axis=2)[~np.eye(len(start), dtype=bool)] - 0.6
    assert gaps.min() >= 0.2


def test_a_missing_scenario_is_told_with_what_there_is():
    with pytest.raises(InputError, match=r"circle_crossing_5, .*square_crossing_5"):
        load_scenario("nothing_like_it")
    with pytest.raises(InputError, match=r"give circle_crossing_5 with --set pedestrians.number=7"):
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
    assert parse_case("val/37") == ("val", 37)
    assert parse_case("37", "val") == ("val", 37)
    assert Cases.parse("val/37") == Cases("val", 37, 38)
    assert Cases.parse("test:37") == Cases("test", 0, 37)
    for text in ("37", "test/-1", "dev/1", "test/1/2", "test/"):
        with pytest.raises(InputError, match="write test/37"):
            parse_case(text)
    with pytest.raises(InputError, match="case 'val:3' is not the name of a case: write val/3 "):
        parse_case("val:3")
