"""What an entrant can try against a board: each attempt is refused, or changes nothing."""

import json
import re

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from small_boards import card, write_board
from typer.testing import CliRunner

from crowdbench.cli.app import app
from crowdbench.plugins.new_planner import make_planner
from crowdbench.utils.errors import InputError
from crowdbench.utils.files import sha256
from crowdbench_leaderboards.board import read_board
from crowdbench_leaderboards.entry import read_entry
from crowdbench_leaderboards.submission import Submission, submit
from crowdbench_leaderboards.verdict import Verdict
from crowdbench_leaderboards.verification import verify

pytestmark = pytest.mark.slow


def forge(folder, **changes):
    """Change what an entry says, and write the digests of its files anew."""
    table = json.loads((folder / "entry.json").read_text()) | changes
    paths = [path for path in folder.rglob("*") if path.is_file() and path.name != "entry.json"]
    table["files"] = {path.relative_to(folder).as_posix(): sha256(path) for path in paths}
    (folder / "entry.json").write_text(json.dumps(table))


@pytest.mark.parametrize(
    "name",
    ["public/circle_crossing_5/notes.npy", "public/n.npy", "notes.py", "public/circle_crossing_5/result.json"],
)
def test_a_file_that_is_not_frozen_cannot_come_along(folder, name):
    (folder / name).parent.mkdir(parents=True, exist_ok=True)
    (folder / name).write_bytes(b"a table of commands")
    forge(folder)
    with pytest.raises(InputError, match="is none of the files that an entry may have: remove it"):
        read_entry(folder)


def test_a_folder_that_is_a_link_is_refused(folder, tmp_path):
    (folder / "planner" / "more").symlink_to(tmp_path)
    with pytest.raises(InputError, match="more is not a plain file"):
        read_entry(folder)


@pytest.mark.parametrize(
    "name", ["", " Ada", "a | b", "two\nlines", "<b>Ada</b>", "Ada\u202e", "a\x07", "[x](http://y)", "x" * 101]
)
def test_a_submitter_that_pages_could_not_show_is_refused(folder, name):
    forge(folder, submitted_by=name)
    with pytest.raises(InputError, match=r"submitted_by: |cannot submit an entry: a name has letters, digits"):
        read_entry(folder)


@pytest.mark.parametrize("name", ["Ada Lovelace", "J.-P. O'Neil_2", "Lukasz"])
def test_names_of_people_are_names(folder, name):
    forge(folder, submitted_by=name)
    assert read_entry(folder).spec.submitted_by == name


def test_nobody_else_submits_as_the_maintainers(folder, tmp_path):
    forge(folder, submitted_by="crowdbench")
    with pytest.raises(InputError, match="submitted by crowdbench must be of a planner that ships"):
        read_entry(folder)
    (tmp_path / "card.toml").write_text(card(authors='["CrowdBench"]'))
    arguments = ["orca", "--board", "five", "--card", str(tmp_path / "card.toml")]
    done = CliRunner().invoke(app, ["submit", *arguments])
    assert "give your name" in str(done.exception)


def test_the_digest_of_a_board_is_not_for_entries_to_say(folder, tmp_path):
    forge(folder, board_digest="0" * 64)
    with pytest.raises(InputError, match="was made for another simulator, other rules or scenarios of the board small"):
        verify(read_entry(folder), read_board(folder.parents[1]), work=tmp_path / "work")


def test_a_network_that_is_entered_twice_is_refused(folder):
    forge(folder, networks=[{"near": 1.0}, {"near": 1.0}])
    with pytest.raises(InputError, match="two networks of the entry are the same"):
        read_entry(folder)


def test_large_files_are_refused_where_an_entry_is_read(folder, monkeypatch):
    monkeypatch.setattr("crowdbench_leaderboards.planner_files.LARGEST", 1e5)
    (folder / "planner" / "large.bin").write_bytes(bytes(200_000))
    forge(folder)
    with pytest.raises(InputError, match=r"but an entry may have 0\.1 MB"):
        read_entry(folder)


def test_commands_that_would_unpack_to_more_than_a_run_has_are_not_unpacked(folder, tmp_path, monkeypatch):
    path = folder / "public" / "circle_crossing_5" / "commands.parquet"
    schema = pq.read_schema(path)
    bomb = pa.table([pa.array([0]), pa.array([np.zeros(40_000_000)], schema.field("command").type)], schema)
    pq.write_table(bomb, path, compression="zstd", use_dictionary=False)
    assert path.stat().st_size < 100_000
    forge(folder)
    monkeypatch.setattr(pq.ParquetFile, "read", None)
    found = verify(read_entry(folder), read_board(folder.parents[1]), work=tmp_path / "work")
    assert found.verdict == Verdict.NOT_REPRODUCED
    assert "holds 1 cases in 320 MB, but a run of 8 cases has as many in 1 MB at most" in found.reason


def zigzag(number, length=0):
    """A number as Thrift writes it, in so many bytes at least."""
    number, out = 2 * number, []
    while number > 127 or len(out) < length - 1:
        out.append(number & 127 | 128)
        number >>= 7
    return bytes([*out, number])


def test_commands_whose_size_is_a_lie_do_not_take_the_memory_of_the_verifier(folder, tmp_path, monkeypatch):
    monkeypatch.setattr("crowdbench_leaderboards.verification.MAX_MEMORY", 2e8)
    path = folder / "public" / "circle_crossing_5" / "commands.parquet"
    values = pa.array(np.zeros(60_000_000), pq.read_schema(path).field("command").type.value_type)
    cases = pq.read_table(path, columns=["case"])["case"].combine_chunks()
    lists = pa.ListArray.from_arrays(pa.array([0, *[len(values)] * len(cases)], pa.int32()), values)
    pq.write_table(pa.table([cases, lists], pq.read_schema(path)), path, compression="zstd", use_dictionary=False)
    column = pq.read_metadata(path).row_group(0).column(1)
    true = zigzag(column.total_uncompressed_size)
    content = path.read_bytes()
    assert content.count(true) >= 1
    path.write_bytes(content.replace(true, zigzag(1000, len(true))))
    forge(folder)
    found = verify(read_entry(folder), read_board(folder.parents[1]), work=tmp_path / "work")
    assert found.verdict == Verdict.NOT_REPRODUCED
    # Either reading them takes too much memory, or they are refused before they are padded to the longest case.
    assert re.search("memory|its steps differ", found.reason.lower())


LAZY = """
import crowdbench, numpy as np

class Lazy(crowdbench.Planner):
    def plan(self, obs):
        way = obs.vehicle.goal - obs.vehicle.position
        return way * (len(obs.row) > 1) / np.hypot(*way.T)[:, None]

def planner():
    return Lazy()
"""


@pytest.mark.parametrize(("cheats", "is_timed"), [(True, False), (False, True)])
def test_a_planner_is_timed_only_where_it_decides_as_in_the_ranked_cases(cheats, is_timed, tmp_path, monkeypatch):
    monkeypatch.setattr("crowdbench_leaderboards.calibrated_time.TIMED", 3)
    board = write_board(tmp_path / "boards")
    (tmp_path / "lazy.py").write_text(LAZY if cheats else LAZY.replace("len(obs.row) > 1", "1.0"))
    (tmp_path / "card.toml").write_text(card())
    submission = Submission(board, "lazy", str(tmp_path / "lazy.py"), {}, [], tmp_path / "card.toml", "Eve")
    entry, _ = submit(submission, tmp_path / "boards", tmp_path / "work")
    found = verify(entry, board, work=tmp_path / "work")
    assert (found.decision_time is not None) == is_timed
    assert ("of its decisions are within 0.00015 m/s of those in the ranked cases" in found.untimed) != is_timed


@pytest.mark.parametrize("name", ["class", "numpy", "json", "crowdbench"])
def test_a_planner_is_not_called_as_what_python_has_already(tmp_path, name):
    with pytest.raises(InputError, match=r"no word of Python|is a module that is installed"):
        make_planner(name, tmp_path)


def test_what_is_no_entry_is_told_so(tmp_path, monkeypatch):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    done = CliRunner().invoke(app, ["verify", ""])
    assert "here is no entry" in str(done.exception)
