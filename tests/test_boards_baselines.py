"""Entries of planners that ship, packed into one file of a board."""

import zipfile

import pytest

from crowdbench.boards.baselines import PACK, entry_folders, find_entry, pack
from crowdbench.boards.board import read_board
from crowdbench.boards.season import read_season
from crowdbench.boards.shipped import pack_entries
from crowdbench.boards.standings import read_entries, standings
from crowdbench.utils.errors import InputError

pytestmark = pytest.mark.slow


def found_in(root):
    board = read_board(root / "small")
    found = standings(board, read_entries(board, root), read_season(root))
    return [(one.entry.name, one.entry.digest, one.rank, one.figures, one.decision_time) for one in found.ranked]


def test_packed_entries_stand_as_they_did(root):
    before = found_in(root)
    pack_entries(read_board(root / "small"), root)
    assert [path.name for path in sorted((root / "small" / "entries").iterdir())] == ["careful"]
    assert [path.name for path in sorted((root / "small" / "verifications").iterdir())] == ["careful"]
    names = zipfile.ZipFile(root / "small" / PACK).namelist()
    assert {name.split("/")[1] for name in names} == {"orca"}
    assert {name.split("/")[0] for name in names} == {"entries", "verifications"}
    assert repr(found_in(root)) == repr(before)


def test_what_is_packed_later_is_added_and_the_same_entries_make_the_same_file(root):
    board = root / "small"
    pack(board, ["orca"])
    pack(board, ["careful"])
    one = (board / PACK).read_bytes()
    assert [folder.name for folder in entry_folders(board)] == ["careful", "orca"]
    with zipfile.ZipFile(board / PACK) as archive:
        archive.extractall(board)
    (board / PACK).unlink()
    pack(board, ["careful", "orca"])
    assert (board / PACK).read_bytes() == one


def test_a_packed_entry_is_found_by_the_folder_that_it_had(root):
    directory = root / "small" / "entries" / "orca"
    assert find_entry(directory) == directory
    pack(root / "small", ["orca"])
    assert find_entry(directory).name == "orca"
    assert (find_entry(directory) / "entry.json").exists()
    assert find_entry(root / "small" / "entries" / "careful") == root / "small" / "entries" / "careful"


def test_a_damaged_file_gets_one_sentence(root):
    (root / "small" / PACK).write_text("no zip")
    with pytest.raises(InputError, match=r"baselines\.zip is damaged: File is not a zip file$"):
        entry_folders(root / "small")
