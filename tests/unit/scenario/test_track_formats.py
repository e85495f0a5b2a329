"""Recordings in other formats than that of ETH/UCY, and in other units than metres and seconds."""

import json

import numpy as np
import pytest
import recordings

from crowdbench.catalog import load_scenario
from crowdbench.scenario.digest import scenario_digest
from crowdbench.scenario.tracks.formats import FORMATS
from crowdbench.utils.errors import InputError

PIXELS = 30.0
"""Pixels of a metre."""

ROWS = recordings.rows()


def load(folder, **tracks):
    """The scenario of the recording in a folder, and its recorded crowd."""
    (folder / "mine.toml").write_text(recordings.TOML)
    overrides = {f"tracks.{key}": value for key, value in tracks.items()}
    return load_scenario(str(folder / "mine.toml"), overrides, data=folder)


def same_crowd(found, folder):
    """Whether a scenario has the crowd of the recording in metres, up to the place of its origin."""
    windows, expected = (
        [window for split in ("train", "val", "test") for window in it.tracks.windows[split]]
        for it in (found, recordings.scenario(folder))
    )
    return len(windows) == len(expected) and all(
        np.allclose(a.track, b.track, atol=1e-3, equal_nan=True) for a, b in zip(windows, expected, strict=True)
    )


def write_csv(folder, rows, header="t,id,x,y", separator=",", end="\n", encoding="utf-8"):
    lines = [header, *(separator.join(map(str, row)) for row in rows)]
    (folder / "mine.csv").write_bytes((end.join(lines) + end).encode(encoding))


def seconds():
    return [(round(0.04 * frame, 3), person, x, y) for frame, person, x, y in ROWS]


def write_eth(folder, rows):
    (folder / "mine.txt").write_text("".join(f"{f}\t{p}\t{x}\t{y}\n" for f, p, x, y in rows))


IN_PIXELS = [(frame, person, PIXELS * x, PIXELS * y) for frame, person, x, y in ROWS]


def test_pixels_read_as_metres_are_named_and_a_scale_helps(tmp_path):
    write_eth(tmp_path, IN_PIXELS)
    sentence = r"mine.toml: in tracks, mine: pedestrians typically move at 45.3 m/s, which is impossible, so these are "
    with pytest.raises(InputError, match=sentence + r"no metres: set tracks\.scale, .* or tracks\.frame_rate"):
        load(tmp_path)
    assert same_crowd(load(tmp_path, scale=1.0 / PIXELS), tmp_path)


@pytest.mark.parametrize(
    ("rows", "keys"),
    [
        ([(f, p, 1000.0 * x, 1000.0 * y) for f, p, x, y in ROWS], {"scale": 0.001}),
        ([(f // 10, p, x, y) for f, p, x, y in ROWS], {"frame_rate": 2.5}),
        ([(40 * f, p, x, y) for f, p, x, y in ROWS], {"frame_rate": 1000.0}),
    ],
    ids=["millimetres", "frames of 0.4 s", "milliseconds"],
)
def test_other_units_are_refused_without_the_key_and_read_with_it(rows, keys, tmp_path):
    write_eth(tmp_path, rows)
    with pytest.raises(InputError, match=f"tracks.{next(iter(keys))}"):
        load(tmp_path)
    assert same_crowd(load(tmp_path, **keys), tmp_path)


def test_feet_are_warned_about(tmp_path, caplog):
    write_eth(tmp_path, [(f, p, x / 0.3048, y / 0.3048) for f, p, x, y in ROWS])
    load(tmp_path)
    assert "mine: pedestrians typically move at 5 m/s, which is unusual; if these are no metres" in caplog.text
    caplog.clear()
    load(tmp_path, scale=0.3048)
    assert not caplog.messages


def test_a_frame_rate_that_is_ten_times_too_low_is_warned_about(tmp_path, caplog):
    write_eth(tmp_path, ROWS)
    load(tmp_path, frame_rate=2.5)
    assert "mine: pedestrians typically move at 0.15 m/s, which is unusual" in caplog.text


def test_one_wrong_jump_among_good_tracks_is_split_and_counted(tmp_path, caplog):
    rows = [(f, p, x + 50.0 * (i == 200), y) for i, (f, p, x, y) in enumerate(sorted(ROWS, key=lambda row: row[1]))]
    write_eth(tmp_path, rows)
    load(tmp_path)
    assert caplog.messages == [
        "mine: 2 tracks were split: 0 where a pedestrian was absent for more than 4 s, 2 where one was faster than "
        "10 m/s"
    ]


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"header": "Time, Track_ID ,pos_x,pos_y"},
        {"separator": ";", "header": "t;id;x;y"},
        {"separator": "\t", "header": "t\tid\tx\ty", "end": "\r\n"},
        {"encoding": "utf-8-sig"},
    ],
    ids=["commas", "other names", "semicolons", "tabs and Windows", "byte-order mark"],
)
def test_a_csv_file_has_times_in_seconds(options, tmp_path):
    write_csv(tmp_path, np.random.default_rng(0).permutation(seconds()).tolist(), **options)
    assert same_crowd(load(tmp_path, format="csv"), tmp_path)


def test_a_csv_file_may_have_decimal_commas_text_ids_and_other_columns(tmp_path):
    rows = [
        (*(f"{value:.3f}".rstrip("0").rstrip(".").replace(".", ",") for value in (t, x, y)), f"person {p}")
        for t, p, x, y in seconds()
    ]
    write_csv(tmp_path, [("?", *row) for row in rows], header='"kind";"t";"x";"y";"id"', separator=";")
    assert same_crowd(load(tmp_path, format="csv"), tmp_path)


def test_a_csv_file_may_have_frames_or_milliseconds(tmp_path):
    write_csv(tmp_path, ROWS, header="frame,id,x,y")
    with pytest.raises(InputError, match=r"mine.csv has a column frame and no times: set tracks.frame_rate"):
        load(tmp_path, format="csv")
    assert same_crowd(load(tmp_path, format="csv", frame_rate=25.0), tmp_path)
    write_csv(tmp_path, [(1000.0 * t, *rest) for t, *rest in seconds()])
    with pytest.raises(InputError, match=r"typically 400 s apart, so these are no seconds: set tracks.frame_rate"):
        load(tmp_path, format="csv")
    assert same_crowd(load(tmp_path, format="csv", frame_rate=1000.0), tmp_path)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (
            "",
            "mine.csv begins with '', but must begin with the names of its columns, time: t, time, .*; id: id, .*",
        ),
        ("0.0,1,2.0,3.0\n", "mine.csv begins with '0.0,1,2.0,3.0', but must begin with the names of its columns"),
        ("t,id,x\n0,1,2\n", "begins with 't,id,x', but must"),
        ("t,id,x,y\n", "mine.csv is empty"),
        ("t,id,x,y\n0,1,nan,3\n", "mine.csv: x of row 1 is nan, but must be a finite number"),
        ("t,id,x,y\n0,1,2,3\n,1,2,3\n", "mine.csv: t of row 2 is nan"),
        ("t,id,x,y\n0,1,2,3\n0.4,1,north,3\n", "mine.csv is no table with .* column #2: Row #3: .* 'north'"),
        ("t,id,x,y\n0,1,2,3\n0,4,1,2,0,3,0\n", "mine.csv is no table with .* Expected 4 columns, got 7"),
        ("t,id,x,y\n0,,2,3\n", "mine.csv: a row has no id"),
        ("t,id,x,y\n0,1,2,3\n0,1,2,3\n", "mine.csv: a pedestrian has two positions at 0 s"),
        (
            "t,id,x,y\n0,1,1e9,3\n",
            "mine.csv: a coordinate is 1e.09 m, but must be 1e.07 m at most: .* set tracks.scale",
        ),
        ("t,id,x,y\n1e300,1,1,3\n", "mine.csv: a time is 1e.300 s, but must be below .* set tracks.frame_rate"),
        ("t,id,x,y\n0,1,2,3\n", "no recording of the scene mine holds people for the 9.25 s"),
    ],
)
def test_a_wrong_csv_file_gets_one_sentence(text, sentence, tmp_path):
    (tmp_path / "mine.csv").write_text(text)
    with pytest.raises(InputError, match=sentence) as error:
        load(tmp_path, format="csv")
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 600


def test_a_binary_csv_file_gets_one_sentence(tmp_path):
    (tmp_path / "mine.csv").write_bytes(b"\xff\xfe\x00\x00")
    with pytest.raises(InputError, match=r"mine.csv is not a text file in UTF-8"):
        load(tmp_path, format="csv")


def write_sdd(folder):
    """Write boxes of 20 x 30 pixels around pedestrians, and others: a car, and a box that is out of sight."""
    lines = []
    for frame, person, x, y in ROWS:
        middle = np.array([PIXELS * x, -PIXELS * y]) + 500.0  # y of an image points down
        half = np.array([10.0, 15.0])
        low, high = middle - half, middle + half
        lines.append(f'{person} {low[0]} {low[1]} {high[0]} {high[1]} {frame * 6 // 5} 0 0 1 "Pedestrian"')
    lines += ['500 0 0 9 9 0 0 0 0 "Car"', '500 0 0 9 9 12 0 0 0 "Car"', '501 0 0 9 9 0 1 0 0 "Pedestrian"']
    (folder / "mine").mkdir()
    (folder / "mine" / "annotations.txt").write_text("\n".join(lines) + "\n")


def test_sdd_is_read_in_metres_with_y_upwards_without_others_and_without_the_lost(tmp_path, caplog):
    write_sdd(tmp_path)
    with pytest.raises(InputError, match=r"annotations.txt has positions in pixels: set tracks.scale"):
        load(tmp_path, format="sdd")
    found = load(tmp_path, format="sdd", scale=1.0 / PIXELS)
    assert caplog.messages[-1].endswith("tracks that are no pedestrians are left out: 1 Car")
    moved = [np.nanmin(window.track, axis=(0, 1)) for window in found.tracks.windows["train"]]
    assert np.allclose(np.min(moved, axis=0), [500.0 / PIXELS, -500.0 / PIXELS + 0.2], atol=0.2)
    assert list(found.table["tracks"]["files"]) == ["mine/annotations.txt"]


def test_ind_is_read_by_its_three_files(tmp_path, caplog):
    rows = [f"7,{person},{frame},{x},{y},0.0" for frame, person, x, y in ROWS]
    car = ["7,900,0,1.0,1.0,0.0", "7,900,1,2.0,1.0,0.0"]
    (tmp_path / "mine_tracks.csv").write_text("\n".join(["recordingId,trackId,frame,xCenter,yCenter,h", *rows, *car]))
    people = sorted({person for _, person, _, _ in ROWS})
    classes = ["7,900,car", *(f"7,{person},pedestrian" for person in people)]
    (tmp_path / "mine_tracksMeta.csv").write_text("\n".join(["recordingId,trackId,class", *classes]))
    (tmp_path / "mine_recordingMeta.csv").write_text("recordingId,frameRate,weekday\n7,25.0,monday\n")
    assert same_crowd(load(tmp_path, format="ind"), tmp_path)
    assert caplog.messages[0].endswith("tracks that are no pedestrians are left out: 1 car")
    (tmp_path / "mine_recordingMeta.csv").write_text("recordingId,frameRate\n7,0\n")
    with pytest.raises(InputError, match=r"mine_recordingMeta.csv: frameRate is 0, but must be above 0"):
        load(tmp_path, format="ind")
    (tmp_path / "mine_tracksMeta.csv").unlink()
    with pytest.raises(InputError, match=r"has no file mine_tracksMeta.csv, which the scene mine needs"):
        load(tmp_path, format="ind")


def test_jrdb_is_read_in_the_frame_of_its_robot_and_this_is_said(tmp_path, caplog):
    boxes = {}
    for frame, person, x, y in ROWS:  # 15 frames per second, six of them in 0.4 s
        box = {"cx": x, "cy": y, "cz": 0.0, "l": 0.5, "w": 0.5, "h": 1.7, "rot_z": 0.0}
        here = boxes.setdefault(f"{frame * 6 // 10:06d}.pcd", [])
        here.append({"label_id": f"pedestrian:{person}", "box": box, "attributes": {}})
    (tmp_path / "mine.json").write_text(json.dumps({"labels": boxes}))
    assert same_crowd(load(tmp_path, format="jrdb"), tmp_path)
    assert "these are tracks only where the robot stands still" in caplog.text


@pytest.mark.parametrize(
    "content", ["{", "[1]", '{"labels": 1}', '{"labels": {"a": 1}}', '{"labels": {"1.pcd": [{}]}}']
)
def test_a_wrong_file_of_jrdb_gets_one_sentence(content, tmp_path):
    (tmp_path / "mine.json").write_text(content)
    with pytest.raises(InputError, match=r"mine.json.* (must be|is not valid JSON)"):
        load(tmp_path, format="jrdb")


@pytest.mark.parametrize("name", FORMATS)
def test_a_folder_in_place_of_a_file_and_a_missing_file_get_one_sentence(name, tmp_path):
    with pytest.raises(InputError, match=r"has no file .*, which the scene mine needs"):
        load(tmp_path, format=name, scale=0.1)
    for file in FORMATS[name].files:
        (tmp_path / file.format("mine")).mkdir(parents=True)
    with pytest.raises(InputError, match="cannot be read: Is a directory"):
        load(tmp_path, format=name, scale=0.1)


def test_a_file_of_another_format_is_named(tmp_path):
    write_csv(tmp_path, seconds())
    with pytest.raises(InputError, match=r"no file mine.txt, .*; its files are of tracks.format csv$"):
        load(tmp_path)


def test_an_unknown_format_and_keys_that_do_not_fit_get_one_sentence(tmp_path):
    write_eth(tmp_path, ROWS)
    with pytest.raises(InputError, match="in tracks, format is 'cvs', but must be one of eth_ucy, csv, sdd, ind, jrdb"):
        load(tmp_path, format="cvs")
    with pytest.raises(InputError, match=r"tracks\.scale is 0\.0, but must be a number above 0"):
        load(tmp_path, scale=0.0)


def test_keys_that_are_left_out_change_no_digest(tmp_path):
    table = recordings.scenario(tmp_path).table
    assert {table["tracks"][key] for key in ("format", "scale", "frame_rate")} == {None}
    kept = {key: value for key, value in table["tracks"].items() if value is not None}
    assert scenario_digest({**table, "tracks": kept}) == scenario_digest(table)


def test_one_far_position_costs_no_memory(tmp_path):
    far = [(0, 500, 9e6, 9e6), (10, 500, 9e6, 9e6)]
    write_eth(tmp_path, ROWS + far)
    assert len(load(tmp_path).tracks.free_space["mine"].free) < 10_000


def test_one_wrong_time_costs_no_memory(tmp_path):
    write_eth(tmp_path, [*ROWS, (10**13, 500, 1.0, 1.0)])
    assert 12 <= sum(map(len, load(tmp_path).tracks.windows.values())) <= 14


def test_a_number_in_pythons_notation_and_a_blank_line_are_read(tmp_path):
    write_eth(tmp_path, ROWS)
    text = (tmp_path / "mine.txt").read_text()
    (tmp_path / "mine.txt").write_text("\n" + text.replace("0\t99\t", "0_0\t99\t", 1).replace("\n", "\r\n"))
    assert same_crowd(load(tmp_path), tmp_path)
