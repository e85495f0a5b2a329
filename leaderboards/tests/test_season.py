import dataclasses
import datetime
import json

import pytest
from small_boards import SEASON, card, verifier, verify

from crowdbench.utils.errors import InputError
from crowdbench_leaderboards.board import read_board
from crowdbench_leaderboards.board_runs import CaseSet, InUse
from crowdbench_leaderboards.entry import read_entry
from crowdbench_leaderboards.fill import Job, do_all
from crowdbench_leaderboards.ranked_run import drive_ranked, read_ranked
from crowdbench_leaderboards.season import TooEarly, freeze, read_season
from crowdbench_leaderboards.submission import Submission, submit
from crowdbench_leaderboards.verdict import Verdict, read_verification

pytestmark = pytest.mark.slow


def entry_of(root, name="careful"):
    return read_entry(root / "small" / "entries" / name)


def found_of(root, name="careful"):
    return read_verification(entry_of(root, name), read_board(root / "small"), read_season(root))[0]


def unverified(root, name="careful"):
    """An entry without what a season has found."""
    for file in ("verdict.json", "season.parquet"):
        (root / "small" / "entries" / name / file).unlink()
    return entry_of(root, name)


@pytest.fixture
def season(root, made):
    """What a verification in the season takes."""
    return {"season": read_season(root), "key": made / "key_of_tester"}


def test_a_verification_without_a_season_records_nothing(root, tmp_path):
    before = (root / "small" / "entries" / "careful" / "entry.json").read_bytes()
    found = verify(entry_of(root), read_board(root / "small"), work=tmp_path / "work")
    assert found.verdict == Verdict.RERUN
    assert (root / "small" / "entries" / "careful" / "entry.json").read_bytes() == before


def test_an_interrupted_verification_without_a_season_leaves_nothing(root, tmp_path, monkeypatch):
    monkeypatch.setattr("crowdbench_leaderboards.verification.read_ranked", interrupted)
    with pytest.raises(KeyboardInterrupt):
        verify(entry_of(root), read_board(root / "small"), work=tmp_path / "work")
    assert not list((tmp_path / "work").iterdir())


def interrupted(*_):
    raise KeyboardInterrupt


def test_a_verification_that_was_killed_before_its_verdict_goes_on(root, season, tmp_path, monkeypatch):
    entry = unverified(root)
    with monkeypatch.context() as patch:
        patch.setattr("crowdbench_leaderboards.verdict.sign", interrupted)
        with pytest.raises(KeyboardInterrupt):
            verifier(root, tmp_path).verify_in_season(entry, **season)
    assert not (entry.directory / "verdict.json").exists()
    monkeypatch.setattr("crowdbench_leaderboards.ranked_run._drive", None)  # all cases are in the logs
    assert verifier(root, tmp_path).verify_in_season(entry, **season).verdict == Verdict.RERUN
    assert found_of(root).season == "first"


def test_a_ranked_run_that_was_killed_goes_on_with_the_same_cases(root, season, tmp_path):
    entry = unverified(root)
    setting = verifier(root, tmp_path)
    case_set = CaseSet(setting.board, setting.board.cases, season["season"].seed("small"))
    (task,) = setting.tasks(entry, case_set, setting.runs(entry))
    drive_ranked(task)
    whole = read_ranked(task).episodes
    lines = task.log.read_text().splitlines(keepends=True)
    task.log.write_text("".join(lines[:6]) + lines[6][:20])  # a kill has cut a line
    assert task.count() == 4
    driven = []
    drive_ranked(task, driven.append)
    assert sum(driven) == 10
    again = read_ranked(task).episodes
    assert again.to_arrow().equals(whole.to_arrow())
    # A log of another entry is not continued.
    assert dataclasses.replace(task, entry="0" * 64).count() == 0


def test_an_interrupted_submission_goes_on_with_its_own_runs_and_with_no_others(root, tmp_path, monkeypatch):
    (tmp_path / "card.toml").write_text(card())
    board, work = read_board(root / "small"), tmp_path / "work"
    result = work / "submit-small-mine" / "circle_crossing_5" / "result.json"

    def submission(space):
        return Submission(board, "mine", "orca", {"safety_space": space}, [], tmp_path / "card.toml")

    def interrupt(space):
        with monkeypatch.context() as patch:
            patch.setattr("crowdbench_leaderboards.submission.write_record", interrupted)
            with pytest.raises(KeyboardInterrupt):
                submit(submission(space), root, work)
        assert not (root / "small" / "entries" / "mine").exists()
        return json.loads(result.read_text())["id"], result.stat().st_mtime_ns

    first = interrupt(0.05)
    assert interrupt(0.05) == first
    assert interrupt(0.1)[0] != first[0]
    entry, _ = submit(submission(0.1), root, work)
    assert entry.spec.options == {"safety_space": 0.1}
    assert not result.exists()
    with pytest.raises(InUse, match="exists already"):
        submit(submission(0.1), root, work)


def test_an_entry_is_verified_once_in_a_season(root, season, tmp_path):
    with pytest.raises(InUse, match="was verified in the season first before, which is done once"):
        verifier(root, tmp_path).verify_in_season(entry_of(root), **season)


def test_an_entry_that_came_later_takes_no_part(root, made, tmp_path):
    frozen = {"orca": {"digest": "0" * 64, "account": "", "ranked": True}}
    (root / "frozen.json").write_text(json.dumps({"season": "first", "entries": {"small": frozen}}))
    with pytest.raises(InputError, match="takes no part in the season first"):
        verifier(root, tmp_path).verify_in_season(entry_of(root), read_season(root), made / "key_of_tester")


def test_entries_are_frozen_after_the_season_closes_and_before_anybody_knows_the_round(root, tmp_path):
    entries = [entry_of(root)]
    today = datetime.datetime.now(datetime.UTC).date()
    season = SEASON.replace("rehearsal = true", "")

    def write(days, text=season):
        (tmp_path / "season.toml").write_text(text.replace("2027-01-31", str(today + datetime.timedelta(days))))

    write(1, season.replace("ab" * 32, ""))
    with pytest.raises(TooEarly, match=r"the season first is open until .*: its entries are frozen on a later day"):
        freeze(tmp_path, "small", entries)
    write(-2)
    with pytest.raises(InputError, match="has the randomness of round 5000000 already, but the entries of small must"):
        freeze(tmp_path, "small", entries)
    write(-2, season.replace("ab" * 32, ""))
    with pytest.raises(TooEarly, match="fetch it from drand, and write it there"):
        freeze(tmp_path, "small", entries).seed("small")
    write(-2)
    assert read_season(tmp_path).seed("small")


def test_the_seed_of_a_season_needs_frozen_entries_and_the_round(root):
    season = read_season(root)
    seed = season.seed("small")
    assert 0 <= seed < 2**63
    frozen = json.loads((root / "frozen.json").read_text())
    frozen["entries"]["small"]["orca"]["digest"] = "0" * 64
    (root / "frozen.json").write_text(json.dumps(frozen))
    assert read_season(root).seed("small") != seed
    freeze(root, "small", [entry_of(root)])  # too late
    assert json.loads((root / "frozen.json").read_text()) == frozen
    with pytest.raises(InputError, match="has no entries to freeze"):
        freeze(root, "other", [])
    (root / "season.toml").write_text((root / "season.toml").read_text().replace("ab" * 32, ""))
    with pytest.raises(InputError, match="lacks the randomness of round 5000000"):
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
