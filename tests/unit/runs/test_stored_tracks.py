"""Tracks in a file: read back to the last bit, and refused in a sentence if they are damaged."""

import dataclasses

import numpy as np
import pytest
from helpers import drive, fixture, same, trace

from crowdbench.core.types import Outcome
from crowdbench.results import stored_tracks
from crowdbench.results.stored_tracks import read_tracks, write_tracks
from crowdbench.utils.errors import InputError


@pytest.mark.parametrize("scenario", ["circle_crossing_5_visible", fixture("noise_late"), "groups_12", "mixed_tracks"])
def test_tracks_are_read_back_bit_for_bit(scenario, tmp_path):
    driven = drive("straight", "3", scenario)
    write_tracks(driven, tmp_path / "tracks.parquet")
    found = read_tracks(tmp_path / "tracks.parquet")
    assert same(found, driven)
    assert (found.split, found.rules) == (driven.split, driven.rules)


def test_tracks_without_pedestrians_are_read_back(tmp_path):
    alone = trace(np.zeros((3, 1, 2)), Outcome.TIMEOUT, gap=[np.inf] * 2)
    write_tracks(alone, tmp_path / "tracks.parquet")
    assert same(read_tracks(tmp_path / "tracks.parquet"), alone)


def test_damaged_tracks_are_refused_in_a_sentence(tmp_path, monkeypatch):
    path = tmp_path / "tracks.parquet"
    with pytest.raises(InputError, match="there is no"):
        read_tracks(path)
    one = dataclasses.replace(trace(np.zeros((3, 1, 2)), Outcome.TIMEOUT, gap=[np.inf] * 2), logs={})
    write_tracks(one, path)
    whole = path.read_bytes()
    for content in (b"", whole[:-100], b"PAR1" + bytes(1000) + b"PAR1"):
        path.write_bytes(content)
        with pytest.raises(InputError, match="is not a table of tracks as crowdbench writes it"):
            read_tracks(path)
    path.write_bytes(whole)
    monkeypatch.setattr(stored_tracks, "FORMAT", 2)
    with pytest.raises(InputError, match="it has the format 1, and this version reads format 2"):
        read_tracks(path)
