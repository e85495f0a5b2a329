"""Maps: obstacles from an occupancy grid of ROS, and the layout of regions among them."""

from pathlib import Path

import numpy as np
import pytest
import shapely
import shapely.affinity
from PIL import Image
from typer.testing import CliRunner

import crowdbench
from crowdbench.catalog import load_recorded_scenario, load_scenario
from crowdbench.cli.app import app
from crowdbench.scenario import occupancy_grid
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.layouts.floor_plan import floor_plan
from crowdbench.scenario.occupancy_grid import read_obstacles
from crowdbench.utils.errors import InputError

YAML = "image: map.pgm\nresolution: 0.1\norigin: [-1.0, 2.0, 0.0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.2\n"

SCENARIO = """
[layout]
generator = "floor_plan"
map = "map.yaml"
vehicle = ["a", "b"]
ways = [["a", "b"]]

[layout.regions]
a = [[0.0, 3.0], [2.0, 4.5]]
b = [[6.0, 3.0], [8.0, 4.5]]

[pedestrians]
number = 2
"""


MAPS = Path(crowdbench.__file__).parents[1] / "scenarios" / "maps"


def draw(folder, pixels, yaml=YAML, name="map.pgm"):
    """A map whose image has these pixels, the top row first."""
    pixels = np.asarray(pixels)
    Image.fromarray(pixels if pixels.dtype == np.uint16 else pixels.astype(np.uint8)).save(folder / name)
    (folder / "map.yaml").write_text(yaml)
    return folder / "map.yaml"


def room():
    """A room of 10 by 5 m with walls of 0.2 m, and a block in it; unknown pixels around the block."""
    pixels = np.full((50, 100), 254)
    pixels[[0, 1, -1, -2]] = pixels[:, [0, 1, -1, -2]] = 0
    pixels[18:32, 43:57] = 205
    pixels[20:30, 45:55] = 0
    return pixels


def area(polygons):
    return sum(shapely.Polygon(each).area for each in polygons)


def test_obstacles_are_where_pixels_are_dark(tmp_path):
    found = read_obstacles(draw(tmp_path, room()))
    shape = shapely.union_all([shapely.Polygon(each) for each in found])
    assert shape.bounds == (-1.0, 2.0, 9.0, 7.0)
    assert area(found) == pytest.approx(shape.area)  # pieces of the wall do not overlap
    assert shape.area == pytest.approx(2 * (10.0 + 4.6) * 0.2 + 1.0)
    assert shape.contains(shapely.Point(4.0, 4.5))
    assert not shape.intersects(shapely.Point(2.0, 4.5))


def test_the_image_stands_upright_and_the_origin_turns_it(tmp_path):
    pixels = np.full((10, 10), 254)
    pixels[0, 0:3] = 0  # on top, to the left
    upright, turned = (
        shapely.Polygon(*read_obstacles(draw(tmp_path, pixels, YAML.replace("0.0]", f"{angle}]"))))
        for angle in (0.0, np.pi / 2)
    )
    assert upright.bounds == pytest.approx((-1.0, 2.9, -0.7, 3.0))
    assert turned.bounds == pytest.approx((-2.0, 2.0, -1.9, 2.3), abs=1e-3)


def test_maps_of_nav2_in_raw_mode_hold_per_cent_and_255_for_unknown(tmp_path):
    raw = np.select([room() == 0, room() == 254], [100, 0], 255)
    trinary = read_obstacles(draw(tmp_path, room()))
    for negate in ("negate: 0", "negate: 1"):  # which nav2 ignores in raw mode
        yaml = YAML.replace("negate: 0", f"mode: raw\n{negate}")
        assert read_obstacles(draw(tmp_path, raw, yaml)) == trinary
    assert area(read_obstacles(draw(tmp_path, np.where(raw == 100, 66, raw), yaml))) == area(trinary)
    with pytest.raises(InputError, match="is occupied"):
        read_obstacles(draw(tmp_path, np.where(raw == 100, 65, raw), yaml))


@pytest.mark.parametrize("name", ["map.png", "map.pgm"])
def test_images_of_16_bits_are_scaled_by_their_maximum(tmp_path, name):
    pixels = np.full((20, 20), 0xFFFF, np.uint16)
    pixels[5:8], pixels[12:15] = 0, 0x3000
    yaml = YAML.replace("map.pgm", name)
    dark = area(read_obstacles(draw(tmp_path, pixels, yaml, name)))
    assert dark == pytest.approx(2 * 3 * 20 * 0.01)


def test_a_pgm_is_scaled_by_the_maximum_of_its_header(tmp_path):
    levels = np.full((20, 20), 1000, ">u2")
    levels[5:8], levels[12:15] = 0, 300
    path = draw(tmp_path, room())
    (tmp_path / "map.pgm").write_bytes(b"P5\n20 20\n1000\n" + levels.tobytes())
    assert area(read_obstacles(path)) == pytest.approx(2 * 3 * 20 * 0.01)


def test_opacity_counts_as_nav2_counts_it(tmp_path):
    pixels = np.full((20, 20, 4), 255, np.uint8)
    pixels[2:5] = 0, 0, 0, 255
    pixels[8:11] = 0, 0, 0, 0
    pixels[14:17, :, :3] = 90  # of an occupancy of 0.65 - 0.65 / 4 with the opacity as a fourth colour
    yaml = YAML.replace("map.pgm", "map.png")
    assert area(read_obstacles(draw(tmp_path, pixels, yaml, "map.png"))) == pytest.approx(2 * 0.6)
    yaml += "mode: scale\n"
    assert area(read_obstacles(draw(tmp_path, pixels, yaml.replace("0.65", "0.64"), "map.png"))) == pytest.approx(1.2)


@pytest.mark.parametrize(
    ("old", "new"),
    [("resolution: 0.1", "resolution: 1e-1"), ("negate: 0", "negate: false"), ("[-1.0, 2.0", "[-1e0, 2E+0")],
)
def test_numbers_are_read_as_ros_reads_them(tmp_path, old, new):
    assert read_obstacles(draw(tmp_path, room(), YAML.replace(old, new))) == read_obstacles(draw(tmp_path, room()))


def test_white_is_occupied_where_the_map_says_negate(tmp_path):
    dark = read_obstacles(draw(tmp_path, room()))
    light = read_obstacles(draw(tmp_path, 255 - room(), YAML.replace("negate: 0", "negate: 1")))
    assert dark == light


@pytest.mark.parametrize("seed", range(5))
def test_polygons_leave_any_pixels_by_the_resolution_at_most(tmp_path, seed):
    blocks = np.random.default_rng(seed).random((12, 12)) < 0.3
    path = draw(tmp_path, np.where(np.kron(blocks, np.ones((4, 4))), 0, 254))
    shape = shapely.union_all([shapely.Polygon(each) for each in read_obstacles(path)])
    row, column = np.nonzero(np.kron(blocks, np.ones((4, 4)))[::-1])
    pixels = shapely.union_all(shapely.box(column, row, column + 1, row + 1))
    true = shapely.affinity.translate(shapely.affinity.scale(pixels, 0.1, 0.1, origin=(0, 0)), -1.0, 2.0)
    assert shape.hausdorff_distance(true) <= 0.1


def blocks_of(height, width, *boxes):
    """Pixels that are occupied in boxes of rows and columns, each from first to last."""
    pixels = np.zeros((height, width), bool)
    for top, bottom, left, right in boxes:
        pixels[top:bottom, left:right] = True
    return pixels


EXACT = {
    **{f"rectangle {h} x {w}": blocks_of(h + 2, w + 2, (1, h + 1, 1, w + 1)) for h, w in [(10, 20), (1, 20), (7, 1)]},
    "single pixel": blocks_of(3, 3, (1, 2, 1, 2)),
    "L": blocks_of(30, 30, (2, 22, 2, 8), (16, 22, 2, 28)),
    "L of three pixels": blocks_of(4, 4, (1, 3, 1, 2), (2, 3, 1, 3)),
    "L with a leg of one pixel": blocks_of(30, 30, (2, 22, 2, 3), (21, 22, 2, 28)),
    "T and a bar": blocks_of(30, 30, (2, 5, 2, 20), (5, 15, 9, 12), (20, 21, 2, 28)),
    "ring": blocks_of(20, 30, (2, 18, 2, 28)) ^ blocks_of(20, 30, (5, 9, 4, 20)),
    "ring of one pixel": blocks_of(20, 30, (2, 18, 2, 28)) ^ blocks_of(20, 30, (3, 17, 3, 27)),
    "touching diagonally": blocks_of(20, 20, (2, 8, 2, 8), (8, 15, 8, 18)),
    "pixels in a diagonal": np.eye(8, dtype=bool),
    "step of one pixel": blocks_of(20, 60, (5, 15, 2, 30), (4, 15, 30, 58)),
    "room with desks": blocks_of(60, 90, (0, 60, 0, 90))
    ^ blocks_of(60, 90, (3, 57, 3, 87))
    ^ blocks_of(60, 90, (3, 12, 20, 32), (40, 57, 50, 55), (30, 31, 3, 40), (3, 4, 60, 80)),
}
"""Pixels whose outlines are exact."""


@pytest.mark.parametrize("pixels", EXACT.values(), ids=EXACT)
@pytest.mark.parametrize("turns", range(4))
def test_what_is_no_noise_is_exact(tmp_path, pixels, turns):
    pixels = np.rot90(pixels, turns)
    found = read_obstacles(draw(tmp_path, np.where(pixels, 0, 254)))
    row, column = np.nonzero(pixels[::-1])
    exact = shapely.union_all(shapely.box(0.1 * column - 1, 0.1 * row + 2, 0.1 * column - 0.9, 0.1 * row + 2.1))
    shape = shapely.union_all([shapely.Polygon(each) for each in found])
    assert shape.symmetric_difference(exact).area < 1e-9
    assert area(found) == pytest.approx(0.01 * pixels.sum())


def test_noise_and_slanted_walls_are_simplified(tmp_path):
    row, column = np.indices((60, 90))
    slanted = (abs(row - 10 - column // 7) < 2) & (column > 4) & (column < 80)
    (wall,) = read_obstacles(draw(tmp_path, np.where(slanted, 0, 254)))
    assert len(wall) <= 8
    assert area([wall]) == pytest.approx(0.01 * slanted.sum(), rel=0.05)
    rough = blocks_of(60, 90, (20, 30, 5, 85))
    rough[19, 10:80:7] = True
    rough[29, 11:80:9] = False
    (wall,) = read_obstacles(draw(tmp_path, np.where(rough, 0, 254)))
    assert len(wall) <= 8


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda folder: (folder / "map.yaml").unlink(), "map.yaml cannot be read"),
        (lambda folder: (folder / "map.yaml").write_text("{"), "is no YAML table"),
        (lambda folder: (folder / "map.yaml").write_text(YAML.replace("0.1\n", "x\n")), "map.yaml: resolution is 'x'"),
        (lambda folder: (folder / "map.yaml").write_text(YAML.replace("[-1.0, 2.0, 0.0]", "[1.0]")), "origin is"),
        (lambda folder: (folder / "map.pgm").unlink(), "map.pgm of the map map.yaml cannot be read"),
        (lambda folder: (folder / "map.pgm").write_text("P5 x"), "map.pgm of the map map.yaml cannot be read"),
        (lambda folder: draw(folder, np.full((5, 5), 254)), "is occupied"),
        (lambda folder: draw(folder, room(), YAML + "mode: weird"), "mode is 'weird', but must be one of"),
        (lambda folder: draw(folder, room(), YAML.replace("0.2", "0.7")), "free_thresh is 0.7, but must be below"),
        (lambda folder: draw(folder, room(), YAML.replace("negate: 0", "negate: 2")), "negate is 2, but must be 0, 1,"),
        (lambda folder: draw(folder, room(), "a: " + "[" * 5000), "is no YAML table"),
        (lambda folder: draw(folder, room(), "a: 2026-13-40"), "is no YAML table"),
        (lambda folder: (folder / "map.pgm").write_text("P5 100000 100000 255 x"), "is too large"),
        (lambda folder: (folder / "map.pgm").write_text("P5 20000 9000 255 x"), "is too large"),
        (lambda folder: draw(folder, np.indices((80, 80)).sum(0) % 2 * 255), "corners, but 2000 are possible"),
        (lambda folder: draw(folder, np.indices((200, 240)).sum(0) % 2 * 255), "has 96000 corners, but 30000 are"),
        (lambda folder: draw(folder, np.indices((4096, 4096)).sum(0) % 2 * 255), "corners, but 30000 are possible bef"),
        (lambda folder: draw(folder, np.random.default_rng(0).integers(0, 2, (999, 999)) * 255), "but 30000 are poss"),
    ],
)
def test_a_wrong_map_gets_one_sentence(tmp_path, change, says):
    draw(tmp_path, room())
    change(tmp_path)
    with pytest.raises(InputError, match=says):
        read_obstacles(tmp_path / "map.yaml")


def test_a_run_needs_its_map_no_more(tmp_path):
    (tmp_path / "mine.toml").write_text(SCENARIO)
    path = draw(tmp_path, room())
    scenario = load_scenario(str(tmp_path / "mine.toml"))
    path.unlink()
    again = load_recorded_scenario(scenario.table, "result.json")
    assert again.digest == scenario.digest
    one, other = (each.worlds(Cases("val", 0, 3)) for each in (scenario, again))
    assert (one.position == other.position).all()
    low, high = np.array([[0.0, 3.0], [2.0, 4.5]])
    assert ((one.position[:, 0] >= low) & (one.position[:, 0] <= high)).all()


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('["a", "b"]\nways', '["a", "c"]\nways', "layout.vehicle is ['a', 'c'], but must be a pair of regions"),
        ('ways = [["a", "b"]]', "ways = []", "layout.ways must be a list of pairs"),
        ("[[0.0, 3.0], [2.0, 4.5]]", "[[2.0, 3.0], [0.0, 4.5]]", "layout.regions.a is"),
        ("[[0.0, 3.0], [2.0, 4.5]]", "[[0.0, 3.0], [0.2, 3.2]]", "finds no room"),
        ('map = "map.yaml"', 'map = "map.yaml"\nobstacles = []', "leave out one of them"),
    ],
)
def test_wrong_regions_get_one_sentence(tmp_path, old, new, says):
    draw(tmp_path, room())
    (tmp_path / "mine.toml").write_text(SCENARIO.replace(old, new))
    failed = CliRunner().invoke(app, ["run", "--planner", "orca", "--scenario", str(tmp_path / "mine.toml")])
    assert failed.exit_code
    assert says in str(failed.exception)


def test_obstacles_can_be_given_without_a_map():
    square = [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]
    regions = {"left": [[-4.0, -1.0], [-2.0, 1.0]], "right": [[2.0, -1.0], [4.0, 1.0]]}
    placed = floor_plan(
        np.random.default_rng(0),
        np.full(3, 0.3),
        np.ones(3),
        obstacles=[square],
        regions=regions,
        vehicle=["left", "right"],
        ways=[["left", "right"]],
    )
    assert placed.obstacles.shape == (1, 4, 2)
    assert placed.start[0, 0] < -2.0 < 2.0 < placed.goal[0, 0]
    assert (np.sign(placed.start[1:, 0]) == -np.sign(placed.goal[1:, 0])).all()


def test_the_maps_that_ship_are_of_rooms_and_of_shelves():
    office, shop = (load_scenario(name).table["layout"]["obstacles"] for name in ("office_8", "shop_10"))
    assert 6 <= len(office) <= 30
    assert 6 <= len(shop) <= 30


@pytest.mark.parametrize(("scenario", "file"), [("office_8", "office.yaml"), ("shop_10", "shop.yaml")])
def test_the_scenarios_of_maps_have_the_obstacles_of_their_maps_within_a_pixel(scenario, file):
    shapes = [
        shapely.union_all([shapely.Polygon(each) for each in polygons])
        for polygons in (load_scenario(scenario).table["layout"]["obstacles"], read_obstacles(MAPS / file))
    ]
    assert shapes[0].hausdorff_distance(shapes[1]) <= 0.071  # the diagonal of a pixel


@pytest.mark.parametrize("occupied", [0.1, 0.5, 0.9])
def test_the_corners_of_an_outline_are_those_of_the_union_of_its_pixels(occupied):
    pixels = np.random.default_rng(0).random((30, 40)) < occupied
    union = shapely.union_all(occupancy_grid._boxes(pixels))
    rings = [ring for part in occupancy_grid._polygons(union) for ring in (part.exterior, *part.interiors)]
    assert occupancy_grid._count_turns(pixels) == sum(len(ring.normalize().simplify(0.0).coords) - 1 for ring in rings)
