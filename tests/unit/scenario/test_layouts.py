"""Layouts in files of one's own, what they may return, and what a scenario makes of it."""

import json
import shutil

import numpy as np
import pytest
from typer.testing import CliRunner

from crowdbench.catalog import load_recorded_scenario, load_scenario
from crowdbench.cli.app import app
from crowdbench.scenario.cases import Cases
from crowdbench.utils.errors import InputError

DOOR = '''"""Two people and a door."""

import numpy as np
from crowdbench.scenario.placement import Placement


def layout(rng, radius, preferred_speed, *, width=1.2, walls=True, people=2, side="left", at=[0.0], more={"a": 1}):
    """A wall with a door.

    Args:
        rng: The random stream.
        radius: Radii.
        preferred_speed: Speeds.
        width: Width of the door [m].
    """
    start = np.array([[2.0 + k, -3.0] for k in range(len(radius))])
    wall = np.array([[[-9.0, 0.0], [-width / 2, 0.0]], [[width / 2, 0.0], [9.0, 0.0]]])
    return Placement(start, -start, obstacles=wall if walls else None)


def open_plane(rng, radius, preferred_speed):
    return layout(rng, radius, preferred_speed, walls=False)
'''


@pytest.fixture
def door(tmp_path, monkeypatch):
    """A folder with a layout and a scenario that names it."""
    (tmp_path / "door.py").write_text(DOOR)
    (tmp_path / "mine.toml").write_text('[layout]\ngenerator = "./door.py"\nwidth = 1.5\n')
    monkeypatch.chdir(tmp_path)
    return tmp_path


def scenario(**options):
    return load_scenario("mine.toml", {f"layout.{name}": value for name, value in options.items()})


def test_a_layout_of_ones_own_is_a_file_that_the_scenario_names(door):
    start = scenario().worlds(Cases.parse("2"))
    assert start.obstacles.shape == (2, 2, 2, 2)
    assert start.obstacles[0, 0, 1].tolist() == [-0.75, 0.0]
    for agent in range(start.route.shape[1]):
        way = np.concatenate([start.position[0, agent, None], start.route[0, agent], start.goal[0, agent, None]])
        (x, y), (dx, dy) = way[np.isfinite(way[:, 0])].T, np.diff(way[np.isfinite(way[:, 0])], axis=0).T
        (crossed,) = np.flatnonzero((y[:-1] > 0.0) != (y[1:] > 0.0))
        assert abs(x[crossed] - y[crossed] / dy[crossed] * dx[crossed]) < 0.75


def test_a_function_of_the_file_can_be_named_also_on_the_command_line(door):
    (door / "mine.toml").write_text("")
    (door / "there").mkdir()
    shutil.copy("mine.toml", "there/mine.toml")
    start = load_scenario("there/mine.toml", {"layout.generator": "./door.py:open_plane"}).worlds(Cases.parse("2"))
    assert start.obstacles.shape == (2, 0, 0, 2)


def test_options_have_the_types_of_their_defaults(door):
    for options in ({"walls": False}, {"people": 3}, {"width": 2}, {"side": "right"}, {"at": [1, "x"]}, {"more": {}}):
        assert scenario(**options).layout.keywords.items() >= options.items()
    for option, value, right in (
        ("walls", 1, "true or false"),
        ("people", 1.5, "a whole number"),
        ("people", True, "a whole number"),
        ("width", "wide", "a number"),
        ("side", 3, "a text in quotes"),
        ("at", 3.0, "a list"),
        ("more", [], "a table"),
    ):
        with pytest.raises(InputError, match=rf"^mine.toml: layout.{option} is .*, but must be {right}$"):
            scenario(**{option: value})
    with pytest.raises(
        InputError, match=r"unknown key layout.wide .*the keys here are generator, generator_file, width, walls"
    ):
        scenario(wide=1.0)


def test_the_digest_changes_with_the_file_of_the_layout_and_its_options(door):
    digest = scenario().digest
    assert scenario(width=1.4).digest != digest
    assert scenario(width=1.5).digest == digest
    (door / "circle_crossing.py").write_text(DOOR)
    assert scenario(generator="./circle_crossing.py").digest != digest
    (door / "door.py").write_text(DOOR + "# changed\n")
    assert scenario().digest != digest


def test_a_recorded_scenario_has_the_layout_only_if_the_user_gives_its_file(door):
    table = json.loads(json.dumps(scenario().table))
    again = load_recorded_scenario(table, "result.json", layout="door.py")
    assert again.digest == scenario().digest
    assert np.array_equal(again.worlds(Cases.parse("2")).obstacles, scenario().worlds(Cases.parse("2")).obstacles)
    with pytest.raises(InputError, match=r"give it with --layout \./door\.py"):
        load_recorded_scenario(table, "result.json")
    shutil.copy("door.py", "other.py")
    with pytest.raises(InputError, match="no layout of the run is a file called other"):
        load_recorded_scenario(table, "result.json", layout="other.py")
    (door / "door.py").write_text(DOOR + "# changed\n")
    with pytest.raises(
        InputError, match=r"layout.generator_file is \w+, but must be the digest of the file that is given"
    ):
        load_recorded_scenario(table, "result.json", layout="door.py")


@pytest.mark.slow
def test_check_and_list_know_layouts_in_files(door):
    checked = CliRunner().invoke(app, ["check", "./door.py", "--option", "width=2.0", "--cases", "val:2"])
    assert checked.exit_code == 0, checked.output
    assert "independent" in checked.output
    listed = CliRunner().invoke(app, ["list", "layouts", "./door.py"]).output
    assert "layout.width" in listed
    assert "radius" not in listed
    assert "circle_crossing" in CliRunner().invoke(app, ["list", "layouts"]).output


PARTS = {
    "one corner": ("[[[1, 1], N]]", "obstacles[0] has one corner"),
    "no length": ("[[[1, 1], [1, 1]]]", "obstacles[0] has no length: both its corners are [1.0, 1.0]"),
    "twice": ("[[[1, 1], [1, 1], [2, 2]]]", "obstacles[0] has twice in a row the corner [1.0, 1.0]"),
    "no area": ("[[[0, 1], [1, 1], [2, 1]]]", "obstacles[0] has no area"),
    "a bow": (
        "[[[0, 1], [1, 2], [1, 1], [0, 2]]]",
        "crosses or touches itself: Self-intersection[0.5 1.5]",
    ),
    "a cross": ("[[[0, 1], [1, 2]], [[0, 2], [1, 1]]]", "obstacles[0] and obstacles[1] cross or overlap"),
    "infinite": ("[[[0, 1], [1, np.inf]]]", "obstacles[0] with the point [1.0, inf]"),
    "a hole": ("[[[0, 1], N, [1, 1]]]", "obstacles[0] with the point [nan, nan]"),
    "far": ("[[[0, 1], [0, 2e6]]]", "must be numbers from -1e+06 to 1e+06"),
    "a start": ("[[[-9, -3.1], [9, -3.1]]]", "the start of the vehicle, [2.0, -3.0], is 0.1 m from obstacles[0]"),
    "a goal": (
        "[[[-9, 2], [9, 2], [9, 4], [-9, 4]]]",
        "the goal of the vehicle, [-2.0, 3.0], is 0 m from",
    ),
    "no way": (
        "[[[-9, 2], [9, 2]], [[9, 2], [9, 9]], [[9, 9], [-9, 9]], [[-9, 9], [-9, 2]]]",
        "no way leads the vehicle",
    ),
    "flat": ("[[1, 1], [2, 2]]", "obstacles of shape [2, 2] instead of [any number, any number, 2]"),
}


@pytest.mark.parametrize("name", PARTS)
def test_what_cannot_be_is_told_with_the_file_and_the_case(name, door):
    obstacles, sentence = PARTS[name]
    text = DOOR.replace("wall = np", f"N = [np.nan, np.nan]\n    wall = np.array({obstacles}, float)\n    unused = np")
    text = text.replace("Placement(start", "_free(start")
    text += "\n\ndef _free(start, goal, obstacles):\n    placement = object.__new__(Placement)\n"
    text += (
        "    vars(placement).update(start=start, goal=goal, route=None, obstacles=obstacles)\n    return placement\n"
    )
    (door / "door.py").write_text(text)
    with pytest.raises(InputError) as error:
        scenario().worlds(Cases.parse("3:5"))
    assert str(error.value).startswith("mine.toml: in case test/3, ")
    assert sentence in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("body", "sentence"),
    [
        ("return 1 / 0", "the layout raised ZeroDivisionError"),
        ("return radius, radius", "the layout returned a tuple instead of a Placement"),
        ("raise InputError('nobody finds room')", "nobody finds room"),
    ],
)
def test_a_layout_that_fails_is_told_with_the_file_and_the_case(body, sentence, door):
    head = "from crowdbench import InputError\ndef layout(rng, radius, preferred_speed, *, width=1.0): "
    (door / "door.py").write_text(head + body)
    with pytest.raises(InputError, match=f"^mine.toml: in case test/0, {sentence}"):
        scenario().worlds(Cases.parse("1"))


@pytest.mark.parametrize(
    ("option", "sentence"),
    [
        ("width", "the option width has no default"),
        ("width=None", "the option width has the default None"),
        ("generator=1.0", "no option of a layout can be called generator"),
    ],
)
def test_an_option_that_no_file_could_set_is_refused(option, sentence, door):
    (door / "door.py").write_text(f"def layout(rng, radius, preferred_speed, *, {option}): ...")
    with pytest.raises(InputError, match=f"^mine.toml: in layout.generator, {sentence}"):
        scenario()


def test_a_route_of_the_layouts_own_is_kept(door):
    route = "np.array([[[5.0, 5.0], [np.nan] * 2] for each in start])"
    (door / "door.py").write_text(DOOR.replace("obstacles=wall", f"route={route}, obstacles=wall"))
    start = scenario().worlds(Cases.parse("1"))
    assert np.nan_to_num(start.route[0, 0], nan=-1.0).tolist() == [[5.0, 5.0], [-1.0, -1.0]]


def test_obstacles_in_single_precision_and_none_at_all_have_routes(door):
    text = (door / "door.py").read_text()
    found = []
    for kind in ("obstacles=wall", "obstacles=wall.astype(np.float32)", "obstacles=wall[:0]"):
        (door / "door.py").write_text(text.replace("obstacles=wall", kind))
        found.append(scenario().worlds(Cases.parse("1")))
    around, single, straight = found
    np.testing.assert_allclose(single.route, around.route, atol=1e-5)
    way, goal = straight.route[0, 0] - straight.position[0, 0], straight.goal[0, 0] - straight.position[0, 0]
    assert np.isfinite(way[:, 0]).any()
    assert np.nanmax(np.abs(way[:, 0] * goal[1] - way[:, 1] * goal[0])) < 1e-9


def test_solid_polygons_of_a_world_are_counter_clockwise(door):
    clockwise = "wall = np.array([[[0.0, 0.0], [0.0, 1.0], [1.0, 1.0], [1.0, 0.0]]]); unused = np"
    (door / "door.py").write_text(DOOR.replace("wall = np", clockwise))
    assert scenario().worlds(Cases.parse("1")).obstacles[0, 0].tolist() == [[1, 0], [1, 1], [0, 1], [0, 0]]


def turns(**changes):
    """By how many degrees the goals of pedestrians are turned from the point opposite of the start, and the world."""
    world = load_scenario("circle_20_blind", {f"layout.{key}": value for key, value in changes.items()}).worlds(
        Cases.parse("val:30")
    )
    start, goal = (array[:, 1:] @ np.array([1.0, 1.0j]) for array in (world.position, world.goal))
    return np.degrees(np.angle(goal / -start)), world


@pytest.mark.slow
def test_goals_on_a_circle_are_turned_by_up_to_an_angle():
    turned, world = turns(goal_angle=60.0)
    assert 55.0 < turned.max() <= 60.0
    assert -60.0 <= turned.min() < -55.0
    assert abs(turned.mean()) < 5.0
    assert np.linalg.norm(world.goal, axis=2) == pytest.approx(np.linalg.norm(world.position, axis=2))
    apart = np.linalg.norm(world.goal[:, :, None] - world.goal[:, None], axis=3) + 9.0 * np.eye(21)
    assert apart.min() >= 0.8
    assert np.array_equal(world.goal[:, 0], -world.position[:, 0])
    _, start = turns(goal_angle=0.0)
    assert np.array_equal(start.goal, -start.position)
