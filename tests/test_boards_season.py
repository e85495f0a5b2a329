import datetime
import json
import shutil

import pytest
from boards import SEASON, card

from crowdbench.boards.board import read_board
from crowdbench.boards.entry import read_entry
from crowdbench.boards.run_entry import InUse, Unfinished
from crowdbench.boards.season import TooEarly, freeze, read_season
from crowdbench.boards.shipped import Job
from crowdbench.boards.submission import Submission, submit
from crowdbench.boards.verdict import Verdict, read_verification
from crowdbench.boards.verification import verify
from crowdbench.cli import app
from crowdbench.cli.leaderboard import do_all
from crowdbench.runs.shards import Shard
from crowdbench.utils.errors import InputError

pytestmark = pytest.mark.slow


def entry_of(root, name="careful"):
    return read_entry(root / "small" / "entries" / name)


def found_of(root, name="careful"):
    return read_verification(entry_of(root, name), read_board(root / "small"), read_season(root))


def unverified(root, name="careful"):
    """An entry without what a season has found."""
    shutil.rmtree(root / "small" / "verifications" / name)
    return entry_of(root, name)


@pytest.fixture
def season(root, made):
    """What a verification in the season takes."""
    return {"season": read_season(root), "key": made / "key_of_tester"}


def test_a_verification_without_a_season_records_nothing(root, tmp_path, monkeypatch):
    monkeypatch.setattr("crowdbench.boards.run_entry.EntryRun.time_decisions", lambda *_: "")
    before = (root / "small" / "entries" / "careful" / "entry.json").read_bytes()
    found = verify(entry_of(root), read_board(root / "small"), work=tmp_path / "work")
    assert found.verdict == Verdict.RERUN
    assert (root / "small" / "entries" / "careful" / "entry.json").read_bytes() == before


def test_an_interrupted_verification_without_a_season_leaves_nothing(root, tmp_path, monkeypatch):
    monkeypatch.setattr("crowdbench.boards.run_entry.EntryRun.time_decisions", interrupted)
    with pytest.raises(KeyboardInterrupt):
        verify(entry_of(root), read_board(root / "small"), work=tmp_path / "work")
    assert not list((tmp_path / "work").iterdir())


def interrupted(*_):
    raise KeyboardInterrupt


def test_a_verification_that_was_killed_before_its_verdict_goes_on(root, season, tmp_path, monkeypatch):
    monkeypatch.setattr("crowdbench.boards.decision_time.TIMED", 2)
    entry = unverified(root)
    command = {"board": read_board(root / "small"), "work": tmp_path, **season}
    with monkeypatch.context() as patch:
        patch.setattr("crowdbench.boards.verdict.sign", interrupted)
        with pytest.raises(KeyboardInterrupt):
            verify(entry, **command)
    assert not list((root / "small" / "verifications" / "careful").iterdir())
    assert verify(entry, **command).verdict == Verdict.RERUN
    assert found_of(root).season == "first"


def test_shards_share_a_season_and_the_last_one_comes_to_the_verdict(root, season, tmp_path, monkeypatch):
    monkeypatch.setattr("crowdbench.boards.decision_time.TIMED", 2)
    monkeypatch.setattr("crowdbench.boards.run_entry.BATCH", 5)
    before = found_of(root)
    entry = unverified(root)
    command = {"board": read_board(root / "small"), "work": tmp_path / "work", **season}
    with pytest.raises(Unfinished, match="batches of circle_crossing_5 are missing, which other shards make"):
        verify(entry, **command, shard=Shard(2, 2))
    assert len(list((tmp_path / "work").glob("verify-*/*.parts-*/test-*"))) == 1
    found = verify(entry, **command, shard=Shard(1, 2))
    assert found.figures == before.figures
    assert not list((tmp_path / "work").glob("verify-*"))
    with pytest.raises(InUse, match="was verified in the season first before"):
        verify(entry_of(root), **command, shard=Shard(2, 2))


def test_a_shard_that_leaves_the_rest_to_others_exits_with_0(root, made, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("crowdbench.boards.run_entry.BATCH", 5)
    files = [f"--key={made / 'key_of_tester'}", f"--work={tmp_path / 'work'}"]
    arguments = ["verify", str(unverified(root).directory), "--season", "--shard=2/2", *files]
    assert app(arguments, standalone_mode=False) == 0
    assert "the last shard goes on" in capsys.readouterr().err


def test_shards_share_a_submission(root, tmp_path, monkeypatch):
    monkeypatch.setattr("crowdbench.boards.run_entry.BATCH", 4)
    (tmp_path / "card.toml").write_text(card())
    wanted = Submission(read_board(root / "small"), "mine", "orca", {}, [], tmp_path / "card.toml", "Ada")
    with pytest.raises(Unfinished, match="the last shard goes on"):
        submit(wanted, root, tmp_path / "work", shard=Shard(1, 2))
    assert not (root / "small" / "entries" / "mine").exists()
    made, _ = submit(wanted, root, tmp_path / "work", shard=Shard(2, 2))
    assert made.spec.reported == entry_of(root, "orca").spec.reported
    with pytest.raises(InUse, match="exists already"):
        submit(wanted, root, tmp_path / "work", shard=Shard(1, 2))


def test_an_entry_is_verified_once_in_a_season(root, season, tmp_path):
    with pytest.raises(InputError, match="was verified in the season first before, which is done once"):
        verify(entry_of(root), read_board(root / "small"), work=tmp_path, **season)


def test_an_entry_that_came_later_takes_no_part(root, made, tmp_path):
    (root / "frozen.json").write_text(json.dumps({"season": "first", "entries": {"small": {"orca": "0" * 64}}}))
    with pytest.raises(InputError, match="takes no part in the season first"):
        verify(
            entry_of(root),
            read_board(root / "small"),
            work=tmp_path,
            season=read_season(root),
            key=made / "key_of_tester",
        )


def test_entries_are_frozen_after_the_season_closes_and_before_anybody_knows_the_round(tmp_path):
    today = datetime.datetime.now(datetime.UTC).date()
    season = SEASON.replace("rehearsal = true", "")

    def write(days, text=season):
        (tmp_path / "season.toml").write_text(text.replace("2027-01-31", str(today + datetime.timedelta(days))))

    write(1, season.replace("ab" * 32, ""))
    with pytest.raises(TooEarly, match=r"the season first is open until .*: its entries are frozen on a later day"):
        freeze(tmp_path, "small", {"a": "0" * 64})
    write(-2)
    with pytest.raises(InputError, match="has the randomness of round 5000000 already, but the entries of small must"):
        freeze(tmp_path, "small", {"a": "0" * 64})
    write(-2, season.replace("ab" * 32, ""))
    with pytest.raises(TooEarly, match="fetch it from drand and write it there, now that entries are frozen"):
        freeze(tmp_path, "small", {"a": "0" * 64}).seed("small")
    write(-2)
    assert read_season(tmp_path).seed("small")


def test_the_seed_of_a_season_needs_frozen_entries_and_the_round(root):
    season = read_season(root)
    seed = season.seed("small")
    assert 0 <= seed < 2**63
    frozen = json.loads((root / "frozen.json").read_text())
    frozen["entries"]["small"]["orca"] = "0" * 64
    (root / "frozen.json").write_text(json.dumps(frozen))
    assert read_season(root).seed("small") != seed
    freeze(root, "small", {"a": "0" * 64})  # too late
    assert json.loads((root / "frozen.json").read_text()) == frozen
    with pytest.raises(InputError, match="has no entries to freeze"):
        freeze(root, "other", {})
    (root / "season.toml").write_text((root / "season.toml").read_text().replace("ab" * 32, ""))
    with pytest.raises(InputError, match="does not say the randomness of round 5000000"):
        read_season(root).seed("small")
    (root / "frozen.json").unlink()
    with pytest.raises(InputError, match="the entries of small are not frozen yet"):
        read_season(root).seed("small")


def test_a_filling_process_goes_on_when_the_others_are_done_too():
    missing = ["one", "two"]

    def make(name, in_use):
        if in_use:
            missing.remove("one")  # by another process, in the meantime
            raise InUse("one is in use")
        missing.remove(name)

    def wanted():
        return [Job(name, 1, lambda progress, name=name: make(name, name == "one")) for name in missing]

    assert do_all(wanted, "entry")
