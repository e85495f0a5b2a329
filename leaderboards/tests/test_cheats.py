"""What an entrant can try against a board: each attempt is refused, or changes nothing."""

import json
import re

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from board_entries import seal
from small_boards import verify
from typer.testing import CliRunner

from crowdbench.cli.app import app
from crowdbench.plugins.new_planner import make_planner
from crowdbench.utils.errors import InputError
from crowdbench_leaderboards.board import read_board
from crowdbench_leaderboards.entry import read_entry
from crowdbench_leaderboards.verdict import Verdict

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    "name",
    ["public/circle_crossing_5/notes.npy", "notes.npy", "notes.py", "result.json", "season.json"],
)
def test_a_file_that_is_not_frozen_cannot_come_along(folder, name):
    (folder / name).parent.mkdir(parents=True, exist_ok=True)
    (folder / name).write_bytes(b"a table of commands")
    with pytest.raises(InputError, match="is none of the files that an entry may have: remove it"):
        read_entry(folder)


def test_a_folder_that_is_a_link_is_refused(folder, tmp_path):
    (folder / "planner" / "more").symlink_to(tmp_path)
    with pytest.raises(InputError, match="more is not a plain file"):
        read_entry(folder)


def test_the_digest_of_a_board_is_not_for_entries_to_say(folder, tmp_path):
    seal(folder, board_digest="0" * 64)
    with pytest.raises(InputError, match="was made for another simulator, other rules or scenarios of the board small"):
        verify(read_entry(folder), read_board(folder.parents[1]), work=tmp_path / "work")


def test_a_network_that_is_entered_twice_is_refused(folder):
    seal(folder, networks=[{"near": 1.0}, {"near": 1.0}])
    with pytest.raises(InputError, match="two networks of the entry are the same"):
        read_entry(folder)


def test_large_and_many_files_are_refused_where_an_entry_is_read(folder, monkeypatch):
    (folder / "planner" / "large.txt").write_text("#" * 200_000)
    with monkeypatch.context() as patch:
        patch.setattr("crowdbench_leaderboards.planner_files.LARGEST", 1e5)
        with pytest.raises(InputError, match=r"but an entry may have 0\.1 MB"):
            read_entry(folder)
    for number in range(100):
        (folder / "planner" / f"{number}.txt").write_text("")
    with pytest.raises(InputError, match="but an entry may have 100"):
        read_entry(folder)


def test_an_entry_json_is_short(folder):
    table = json.loads((folder / "entry.json").read_text())
    (folder / "entry.json").write_text(json.dumps(table, indent=1) + "\n" * 40)
    with pytest.raises(InputError, match="has more than 40 lines"):
        read_entry(folder)
    seal(folder, options={"table": "x" * 30_000})
    with pytest.raises(InputError, match=r"entry\.json has more than 20 kB"):
        read_entry(folder)
    seal(folder, options={})
    with (folder / "card.toml").open("a") as file:
        file.write("#" * 30_000)
    with pytest.raises(InputError, match=r"card\.toml has more than 20 kB"):
        read_entry(folder)


def test_an_entry_that_was_privileged_when_it_was_verified_does_not_rank_by_a_later_change(folder):
    before = read_entry(folder).digest
    for key in ("privileged", "raw"):
        seal(folder, **{key: True})
        assert read_entry(folder).digest != before
        seal(folder, **{key: False})
    assert read_entry(folder).digest == before


def with_commands(path, commands, **how):
    """Write the public cases with other commands: a list for each case."""
    table = pq.read_table(path)
    column = table.column_names.index("command")
    pq.write_table(table.set_column(column, "command", commands), path, compression="zstd", use_dictionary=False)


def test_commands_that_would_unpack_to_more_than_a_run_has_are_not_unpacked(folder, tmp_path, monkeypatch):
    path = folder / "public.parquet"
    long = [np.zeros(40_000_000), *[np.zeros(2)] * 7]
    with_commands(path, pa.array(long, pa.list_(pa.float64())))
    assert path.stat().st_size < 100_000
    monkeypatch.setattr(pq.ParquetFile, "read", None)
    found = verify(read_entry(folder), read_board(folder.parents[1]), work=tmp_path / "work")
    assert found.verdict == Verdict.NOT_REPRODUCED
    assert "holds 8 cases in 320 MB, but there are 8 cases in 1 MB at most" in found.reason


def zigzag(number, length=0):
    """A number as Thrift writes it, in so many bytes at least."""
    number, out = 2 * number, []
    while number > 127 or len(out) < length - 1:
        out.append(number & 127 | 128)
        number >>= 7
    return bytes([*out, number])


def test_commands_whose_size_is_a_lie_do_not_take_the_memory_of_the_verifier(folder, tmp_path, monkeypatch):
    monkeypatch.setattr("crowdbench_leaderboards.episode_table.MAX_MEMORY", 2e8)
    path = folder / "public.parquet"
    values = pa.array(np.zeros(60_000_000))
    with_commands(path, pa.ListArray.from_arrays(pa.array([0, *[len(values)] * 8], pa.int32()), values))
    group = pq.read_metadata(path).row_group(0)
    column = group.column(group.num_columns - 1)
    true = zigzag(column.total_uncompressed_size)
    content = path.read_bytes()
    assert content.count(true) >= 1
    path.write_bytes(content.replace(true, zigzag(1000, len(true))))
    found = verify(read_entry(folder), read_board(folder.parents[1]), work=tmp_path / "work")
    assert found.verdict == Verdict.NOT_REPRODUCED
    # Either reading them takes too much memory, or they are refused before they are padded to the longest case.
    assert re.search("memory|its steps differ", found.reason.lower())


@pytest.mark.parametrize("name", ["class", "numpy", "json", "crowdbench"])
def test_a_planner_is_not_called_as_what_python_has_already(tmp_path, name):
    with pytest.raises(InputError, match=r"no word of Python|is a module that is installed"):
        make_planner(name, tmp_path)


def test_what_is_no_entry_is_told_so(tmp_path, monkeypatch):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    done = CliRunner().invoke(app, ["verify", ""])
    assert "here is no entry" in str(done.exception)
