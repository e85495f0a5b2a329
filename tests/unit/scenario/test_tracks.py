import os

import numpy as np
import pytest

from crowdbench.scenario.tracks.eth_ucy import read_tracks
from crowdbench.scenario.tracks.recorded_tracks import ETH_UCY_DT, FRAME_STEP, RecordedTracks
from crowdbench.utils.errors import InputError
from studies.social_gan.recordings import read_folder, scenes
from studies.social_gan.windows import windows

GOOD = "780\t1.0\t8.46\t3.59\n790\t1.0\t9.57\t3.79\n"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "tracks.txt is empty"),
        ("\n  \n", "tracks.txt is empty"),
        (GOOD + "800 1 2\n", "line 3: found 3 columns, but there must be 4: frame, pedestrian, x, y"),
        ("\n\n780,1,2,3\n", "line 3: found 1 columns"),
        (GOOD + "\n800 1 2 north\n", "line 4: 'north' is not a number"),
        (GOOD + "800 1 nan 2\n", "line 3: x is nan, but must be in metres"),
        (GOOD + "800 1 2 -inf\n", "line 3: y is -inf, but must be in metres"),
        (GOOD + "800 1 2 1e300\n", "line 3: y is 1e.300, but must be in metres, from -1e.07 to 1e.07"),
        (GOOD + "800 1.5 2 3\n", "line 3: pedestrian is 1.5, but must be a whole number"),
        (GOOD + "1e300 1 2 3\n", "line 3: frame is 1e.300, but must be a whole number"),
        (GOOD + "805 1 2 3\n", "line 3: frame 805 is not on the grid of the first one, 780: .* multiples of 10 apart"),
        (GOOD + "\n780 2 0 0\n790 1 2 3\n", "line 5: pedestrian 1 is in frame 790 a second time, after line 2"),
    ],
)
def test_a_bad_file_is_told_in_one_sentence(tmp_path, text, expected):
    path = tmp_path / "tracks.txt"
    path.write_text(text)
    with pytest.raises(InputError, match=expected) as error:
        read_tracks(path)
    assert str(error.value).startswith(str(path))
    assert "\n" not in str(error.value)


def walk(number, first, frames, start):
    """Lines of a pedestrian who walks along x at 1 m/s."""
    return [f"{FRAME_STEP * (first + t)} {number} {start + ETH_UCY_DT * t:.3f} {number}.0\n" for t in range(frames)]


def test_a_number_that_comes_again_is_another_pedestrian(tmp_path, caplog):
    lines = [line for i in range(250) for line in walk(i % 60, 30 * (i // 60), 10, -float(i))]
    (tmp_path / "tracks.txt").write_text("".join(lines))
    tracks = read_tracks(tmp_path / "tracks.txt")
    assert caplog.messages == [
        "tracks: 190 tracks were split: 190 where a pedestrian was absent for more than 4 s, 0 where one was faster "
        "than 10 m/s"
    ]
    assert len(set(tracks.pedestrian.tolist())) == 250
    is_same = np.diff(tracks.pedestrian) == 0
    speed = np.hypot(*np.diff(tracks.position, axis=0)[is_same].T) / (
        np.diff(tracks.frame)[is_same] / FRAME_STEP * ETH_UCY_DT
    )
    assert speed == pytest.approx(1.0)


def test_a_pedestrian_is_split_after_a_jump_but_not_after_a_short_absence(tmp_path, caplog):
    (tmp_path / "tracks.txt").write_text("".join(walk(1, 0, 5, 0.0) + walk(1, 5, 5, 50.0) + walk(1, 19, 5, 53.0)))
    assert read_tracks(tmp_path / "tracks.txt").pedestrian.tolist() == [1] * 5 + [2] * 10
    caplog.clear()
    (tmp_path / "tracks.txt").write_text("".join(walk(1, 0, 5, 0.0) + walk(1, 14, 5, 6.0)))  # 4 s
    assert read_tracks(tmp_path / "tracks.txt").pedestrian.tolist() == [1] * 10
    assert not caplog.messages


def test_a_byte_order_mark_is_ignored(tmp_path):
    (tmp_path / "tracks.txt").write_text("\ufeff" + GOOD, encoding="utf-8")
    assert read_tracks(tmp_path / "tracks.txt").frame.tolist() == [780, 790]


def test_what_cannot_be_read_is_told(tmp_path):
    with pytest.raises(InputError, match=r"there is no folder .*nowhere"):
        read_folder(tmp_path / "nowhere")
    (tmp_path / "README.md").write_text("none here")
    with pytest.raises(InputError, match=r"has no files \*.txt"):
        read_folder(tmp_path)
    (tmp_path / "binary.txt").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match=r"binary\.txt is not a text file"):
        read_folder(tmp_path)
    (tmp_path / "binary.txt").unlink()
    (tmp_path / "a.txt").mkdir()
    with pytest.raises(InputError, match=r"a\.txt cannot be read"):
        read_folder(tmp_path)


def recording():
    """Pedestrians who come and go at random, some more than once: frame, pedestrian, x, y, in random order."""
    generator = np.random.default_rng(1)
    rows = []
    for pedestrian in range(20):
        there = generator.random(40) < 0.9
        rows += [(20 + FRAME_STEP * t, pedestrian, *generator.normal(scale=0.3, size=2)) for t in np.flatnonzero(there)]
    return generator.permutation(rows)


def tracks_of(rows, tmp_path):
    path = tmp_path / "some.txt"
    path.write_text("\n".join(" ".join(repr(float(value)) for value in row) for row in rows))
    return read_tracks(path)


@pytest.mark.parametrize("make", [os.mkfifo, lambda path: path.symlink_to("/dev/zero")], ids=["pipe", "device"])
def test_what_may_never_end_is_not_read(make, tmp_path):
    make(tmp_path / "mine.txt")
    with pytest.raises(InputError, match=r"mine\.txt cannot be read: it is not a regular file"):
        read_folder(tmp_path)


def test_windows_hold_those_who_are_there_in_every_frame(tmp_path):
    rows, length = recording(), 6
    where = {(int(frame), int(pedestrian)): xy for frame, pedestrian, *xy in rows.tolist()}
    expected = {}
    for frame in sorted({frame for frame, _ in where}):
        frames = range(frame, frame + length * FRAME_STEP, FRAME_STEP)
        complete = [p for p in range(20) if all((f, p) in where for f in frames)]
        if len(complete) >= 2:
            expected[frame] = {p: [where[f, p] for f in frames] for p in complete}
    found = windows(tracks_of(rows, tmp_path), length)
    assert found.frame.tolist() == list(expected)
    for w, frame in enumerate(expected):
        assert found.pedestrian[w, found.present[w]].tolist() == list(expected[frame])
        np.testing.assert_array_equal(
            found.position[w][:, found.present[w]].swapaxes(0, 1), list(expected[frame].values())
        )
    assert not found.position.swapaxes(1, 2)[~found.present].any()
    assert (~found.present).any()


def test_windows_of_one_pedestrian_and_of_short_recordings_are_left_out(tmp_path):
    alone = [(10 * t, 1, t, 0.0) for t in range(9)]
    assert len(windows(tracks_of(alone, tmp_path), 5)) == 0
    pair = alone + [(10 * t, 2, t, 1.0) for t in range(3, 9)]
    assert windows(tracks_of(pair, tmp_path), 5).frame.tolist() == [30, 40]
    assert len(windows(tracks_of(pair, tmp_path), 20)) == 0


def test_one_pedestrian_does_not_go_on_as_the_next(tmp_path):
    relay = [(10 * t, p + (t >= 3), t, p) for t in range(7) for p in (1, 3)]
    assert windows(tracks_of(relay, tmp_path), 4).frame.tolist() == [30]


def test_a_window_shows_a_predictor_what_was_seen(tmp_path):
    found = windows(tracks_of(recording(), tmp_path), 8)
    obs = found.observation(5)
    np.testing.assert_array_equal(obs.pedestrians.history, found.position[:, :5])
    np.testing.assert_array_equal(obs.pedestrians.position, found.position[:, 4])
    np.testing.assert_allclose(obs.pedestrians.velocity * ETH_UCY_DT, found.position[:, 4] - found.position[:, 3])
    assert (obs.pedestrians.observed == np.where(found.present, 5, 0)).all()
    assert obs.dt == 0.4
    part = found.take(slice(3, 6)).observation(5)
    np.testing.assert_array_equal(part.noise("x", (2, 3)), obs.noise("x", (2, 3))[3:6])
    obs.pedestrians.history[:] = 0.0
    assert found.position[:, :5].any()


def test_scenes_are_those_that_are_complete_and_other_files_by_themselves():
    none = np.zeros(0, np.int64)
    files = {name: RecordedTracks(name, none, none, np.zeros((0, 2))) for name in ("students001", "biwi_eth", "mine")}
    found = scenes(files.values())
    assert {scene: [tracks.name for tracks in parts] for scene, parts in found.items()} == {
        "eth": ["biwi_eth"],
        "students001": ["students001"],
        "mine": ["mine"],
    }
    others = [
        RecordedTracks(name, none, none, np.zeros((0, 2))) for name in ("students003", "uni_examples", "crowds_zara03")
    ]
    found = scenes([*files.values(), *others])
    assert list(found) == ["eth", "univ", "mine"]
    assert [tracks.name for tracks in found["univ"]] == ["students001", "students003"]


@pytest.mark.slow
def test_the_data_set_is_read_whole(shared):
    found = {tracks.name: tracks for tracks in read_folder(shared / "data" / "eth_ucy")}
    sizes = {
        name: (len(tracks.frame), len(np.unique(tracks.pedestrian)), len(np.unique(tracks.frame)))
        for name, tracks in found.items()
    }
    assert sizes == {  # as its README has them
        "biwi_eth": (5492, 360, 876),
        "biwi_hotel": (6543, 389, 1168),
        "crowds_zara01": (5153, 148, 872),
        "crowds_zara02": (9722, 204, 1052),
        "crowds_zara03": (5005, 137, 754),
        "students001": (21813, 415, 444),
        "students003": (17953, 434, 541),
        "uni_examples": (2747, 118, 734),
    }
    assert list(scenes(found.values())) == ["eth", "hotel", "univ", "zara1", "zara2"]
