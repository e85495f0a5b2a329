import numpy as np
import pytest

from crowdbench.scenario.tracks.recorded_tracks import ETH_UCY_DT, FRAME_STEP, RecordedTracks
from crowdbench.utils.errors import InputError
from studies.social_gan.recordings import read_folder
from studies.social_gan.windows import resample, training_split, windows

PUBLISHED = {  # where validation starts, as the data's README has it
    "biwi_eth": 10240,
    "biwi_hotel": 14400,
    "crowds_zara01": 7110,
    "crowds_zara02": 8420,
    "crowds_zara03": 6030,
    "students001": 3550,
    "students003": 4320,
    "uni_examples": 5940,
}


def recording(pedestrians=20, length=40, share=0.9, name="some"):
    """Pedestrians who come and go at random."""
    generator = np.random.default_rng(1)
    pedestrian, time = np.nonzero(generator.random((pedestrians, length)) < share)
    return RecordedTracks(name, 20 + FRAME_STEP * time, pedestrian, generator.normal(size=(len(time), 2)))


def rows(tracks):
    return list(zip(tracks.frame.tolist(), tracks.pedestrian.tolist(), tracks.position.tolist(), strict=True))


def test_the_first_four_fifths_of_the_frames_are_for_training():
    whole = recording()
    (first,), (last,) = training_split([whole], None)
    assert rows(first) == [row for row in rows(whole) if row[0] < 20 + 10 * 32]
    assert rows(last) == [row for row in rows(whole) if row[0] >= 20 + 10 * 32]


def test_a_scene_held_out_is_neither_trained_nor_validated_on():
    names = ("students001", "students003", "uni_examples", "crowds_zara01", "mine")
    first, last = training_split([recording(name=name) for name in names], "univ")
    assert [tracks.name for tracks in first] == ["uni_examples", "crowds_zara01", "mine"]
    assert [tracks.name for tracks in last] == ["uni_examples", "crowds_zara01", "mine"]


def test_what_cannot_be_held_out_is_told():
    with pytest.raises(InputError, match="there is no scene 'eth' to hold out; there are zara1, mine"):
        training_split([recording(name="crowds_zara01"), recording(name="mine")], "eth")
    with pytest.raises(InputError, match="nothing is left to train on but the scene mine"):
        training_split([recording(name="mine")], "mine")


@pytest.mark.slow
def test_eth_ucy_is_cut_where_it_was_published(shared):
    _, last = training_split(read_folder(shared / "data" / "eth_ucy"), None)
    assert {tracks.name: tracks.frame.min() for tracks in last} == PUBLISHED


def resampled_slowly(tracks, dt):
    """Each pedestrian's stretches one by one, by `np.interp`."""
    found = []
    for who in np.unique(tracks.pedestrian):
        own = tracks.pedestrian == who
        time, position = tracks.frame[own] / FRAME_STEP * tracks.dt, tracks.position[own]
        for part in np.split(np.arange(len(time)), np.flatnonzero(np.diff(time) > 1.5 * tracks.dt) + 1):
            for step in range(int(time[-1] / dt) + 2):
                if time[part[0]] - 1e-9 <= step * dt <= time[part[-1]] + 1e-9:
                    xy = [np.interp(step * dt, time[part], position[part, axis]) for axis in range(2)]
                    found.append((step * FRAME_STEP, who, xy))
    return found


@pytest.mark.parametrize("dt", [0.25, 0.4, 0.1, 0.7, 0.8])
def test_resampled_tracks_are_interpolated_within_unbroken_stretches(dt):
    found, expected = rows(resample(recording(), dt)), resampled_slowly(recording(), dt)
    assert [row[:2] for row in found] == [row[:2] for row in expected]
    np.testing.assert_allclose([row[2] for row in found], [row[2] for row in expected], atol=1e-9)


def test_resampled_at_its_own_step_a_recording_stays_as_it_is():
    assert rows(resample(recording(), ETH_UCY_DT)) == rows(recording())


def test_windows_of_resampled_tracks_have_their_step():
    time = np.arange(30)
    pair = RecordedTracks(
        "pair", np.tile(time * 10, 2), np.repeat([1, 2], 30), np.tile(time[:, None] * [0.4, -0.2], (2, 1))
    )
    found = windows(resample(pair, 0.25), 16)
    assert len(found) == int(29 * 0.4 / 0.25) + 1 - 15
    obs = found.observation(8)
    assert obs.dt == 0.25
    np.testing.assert_allclose(obs.pedestrians.velocity, np.broadcast_to([1.0, -0.5], (len(found), 2, 2)))


def test_nobody_can_be_resample():
    none = np.zeros(0, np.int64)
    assert rows(resample(RecordedTracks("none", none, none, np.zeros((0, 2))), 0.25)) == []
