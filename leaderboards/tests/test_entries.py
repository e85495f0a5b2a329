import errno
import json
import re
import shutil

import numpy as np
import pyarrow.parquet as pq
import pytest
from board_entries import change_rows, seal
from small_boards import BOARD, SEASON, card, verify, write_board

from crowdbench import catalog
from crowdbench.isolation import sandbox
from crowdbench.scenario.cases import Cases
from crowdbench.utils.errors import InputError, MachineFault
from crowdbench_leaderboards.board import find_board, read_board, read_boards
from crowdbench_leaderboards.entries import read_entries
from crowdbench_leaderboards.entry import read_entry
from crowdbench_leaderboards.pages.readme import section, write_readme
from crowdbench_leaderboards.pages.standings import standings
from crowdbench_leaderboards.planner_files import copy_named_files
from crowdbench_leaderboards.season import read_season
from crowdbench_leaderboards.submission import Submission, submit
from crowdbench_leaderboards.verdict import Verdict

pytestmark = pytest.mark.slow


CHEAT = """
import crowdbench, numpy as np

class Cheat(crowdbench.Planner):
    seen = None
    def plan(self, obs):
        if self.seen is None:
            self.seen = known(obs)
        way = obs.vehicle.goal - obs.vehicle.position
        distance = np.linalg.norm(obs.pedestrians.position - obs.vehicle.position[:, None], axis=2)
        slow = (distance < 1.5).any(axis=1) & self.seen[obs.row]
        return way * (np.where(slow, 0.3, 1.0) / np.hypot(*way.T))[:, None]

def planner():
    return Cheat()
"""
"""Careful in the worlds that it knows, which takes it to the goal in a third of all cases, and to no goal elsewhere."""


def entry_of(root, name="careful"):
    return read_entry(root / "small" / "entries" / name)


def test_entries_are_verified_in_a_season_and_ranked(root):
    board = read_board(root / "small")
    found = standings(board, read_entries(board, root), read_season(root))
    assert [one.verification.verdict for one in found.ranked] == [Verdict.RERUN, Verdict.RERUN]
    assert not found.others
    assert all(len(one.episodes["circle_crossing_5"]) == 10 for one in found.ranked)
    assert {one.block for one in found.ranked} <= {"A", "B"}


def test_an_entry_is_a_folder_of_five_files_and_its_planner(root):
    entry = entry_of(root)
    assert entry.spec.planner == "planner/careful.py"
    files = sorted(path.relative_to(entry.directory).as_posix() for path in entry.directory.rglob("*.*"))
    assert files == [
        "card.toml", "entry.json", "planner/careful.py", "public.parquet", "season.parquet", "verdict.json",
    ]  # fmt: skip
    assert len((entry.directory / "entry.json").read_text().splitlines()) <= 40


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda folder: (folder / "planner" / "careful.py").write_text("#"), "a file of its planner was changed"),
        (lambda folder: (folder / "planner" / "more.py").write_text("#"), "a file of its planner was changed"),
        (lambda folder: (folder / "planner" / "link.py").symlink_to("careful.py"), "link.py is not a plain file"),
        (lambda folder: (folder / "card.toml").unlink(), "its card or a file of its planner was changed"),
        (lambda folder: (folder / "entry.json").unlink(), "is no entry: .* cannot be read"),
        (lambda folder: (folder / "entry.json").write_text("{"), "is not valid JSON"),
        (lambda folder: (folder / "entry.json").write_text('{"format": 7}'), "has the format 7"),
        (lambda folder: (folder / "entry.json").write_text('{"format": 2}'), "is no entry of crowdbench: board: "),
    ],
)
def test_an_entry_with_other_files_is_refused(root, change, sentence):
    folder = root / "small" / "entries" / "careful"
    change(folder)
    with pytest.raises(InputError, match=sentence):
        read_entry(folder)


def test_the_digest_is_of_the_planner_and_not_of_its_runs(root):
    folder = root / "small" / "entries" / "careful"
    before = entry_of(root).digest
    change_rows(folder / "public.parquet", "steps", lambda steps: [each + 1 for each in steps])
    assert entry_of(root).digest == before
    (folder / "card.toml").write_text(card(title='"Other"'))
    seal(folder)
    assert entry_of(root).digest != before


def succeed(folder):
    ends = pq.read_table(folder / "public.parquet")["outcome"].to_pylist()
    assert "collision" in ends
    change_rows(folder / "public.parquet", "outcome", lambda ends: ["success"] * len(ends))


def fewer_steps(folder):
    change_rows(folder / "public.parquet", "steps", lambda steps: [each - 1 for each in steps])


def better_scores(folder):
    change_rows(folder / "public.parquet", "score", lambda scores: [1.0] * len(scores))


def other_commands(folder):
    change_rows(folder / "public.parquet", "command", lambda lists: [[0.5] * len(each) for each in lists])


def fast_commands(folder):
    change_rows(folder / "public.parquet", "command", lambda lists: [[1e3] * len(each) for each in lists])


def undefined_commands(folder):
    change_rows(folder / "public.parquet", "command", lambda lists: [[np.nan] * len(each) for each in lists])


def other_cases(folder):
    change_rows(folder / "public.parquet", "case", lambda cases: [each + 1 for each in cases])


def another_scenario(folder):
    change_rows(folder / "public.parquet", "scenario", lambda names: ["square_crossing_5"] * len(names))


def no_cases(folder):
    path = folder / "public.parquet"
    pq.write_table(pq.read_table(path).slice(0, 0), path)


@pytest.mark.parametrize(
    "forge",
    [succeed, fewer_steps, better_scores, other_commands, fast_commands, undefined_commands, other_cases,
     another_scenario, no_cases],
)  # fmt: skip
def test_a_forged_public_case_is_not_reproduced(forge, root, tmp_path):
    folder = root / "small" / "entries" / "careful"
    forge(folder)
    found = verify(read_entry(folder), read_board(root / "small"), work=tmp_path / "work")
    assert found.verdict == Verdict.NOT_REPRODUCED
    assert "circle_crossing_5" in found.reason or "public.parquet" in found.reason


@pytest.mark.parametrize(
    ("key", "value"),
    [("privileged", True), ("raw", True), ("facts", {"circle_crossing_5": {"weights": "other"}}), ("facts", {})],
)
def test_an_entry_that_says_what_its_planner_does_not_is_refused(root, tmp_path, key, value):
    folder = root / "small" / "entries" / "careful"
    table = json.loads((folder / "entry.json").read_text())
    (folder / "entry.json").write_text(json.dumps(table | {key: value}))
    found = verify(read_entry(folder), read_board(root / "small"), work=tmp_path / "work")
    assert found.verdict == Verdict.REFUSED
    assert found.reason == "circle_crossing_5: the planner's facts differ from the facts of the entry"


@pytest.mark.parametrize("key", ["planner", "options", "networks"])
@pytest.mark.parametrize(
    "path", ["{}/evil.py", "planner/../evil.py", "planner/../evil.py:planner", "evil.py/../evil.py"]
)
def test_a_file_that_is_not_frozen_with_its_entry_is_refused(root, tmp_path, key, path):
    folder = root / "small" / "entries" / "careful"
    for place in (tmp_path, folder):
        (place / "evil.py").write_text("")
    value = path.format(tmp_path)
    table = json.loads((folder / "entry.json").read_text())
    changed = {"planner": value, "options": {"file": [value]}, "networks": [{"file": {"one": value}}]}
    (folder / "entry.json").write_text(json.dumps(table | {key: changed[key]}))
    with pytest.raises(
        InputError,
        match=r"names the file .*, which does not lie in planner/|none of the files that an|no planner that ships",
    ):
        read_entry(folder)


@pytest.mark.parametrize("planner", ["nonesuch", "planner", "package.module:planner"])
def test_a_planner_neither_ships_nor_is_a_file_of_the_entry(planner, root):
    folder = root / "small" / "entries" / "careful"
    seal(folder, planner=planner)
    with pytest.raises(InputError, match=f"no planner that ships is called '{planner}'"):
        read_entry(folder)


def test_files_of_the_same_name_are_kept_apart(tmp_path):
    (tmp_path / "mine.py").write_text(CHEAT + "def known(obs):\n    return np.ones(8, bool)\n")
    for name, text in {"a": "1", "b": "2", "c": "1"}.items():
        (tmp_path / name).mkdir()
        (tmp_path / name / "speed.txt").write_text(text)
    (tmp_path / "link.py").symlink_to("mine.py")
    folder = tmp_path / "entry"
    given = [str(tmp_path / name / "speed.txt") for name in "abc"]
    assert copy_named_files({"paths": given, "near": 2.0}, folder) == {
        "paths": ["planner/speed.txt", "planner/other_2/speed.txt", "planner/speed.txt"],
        "near": 2.0,
    }
    assert (folder / "planner" / "other_2" / "speed.txt").read_text() == "2"
    assert copy_named_files(f"{tmp_path}/link.py:planner", folder) == "planner/mine.py:planner"
    with pytest.raises(InputError, match="is a folder: an entry takes files that are named one by one"):
        copy_named_files(str(tmp_path / "a"), folder)


TWO_SCENARIOS = BOARD.replace('"circle_crossing_5"', '"circle_crossing_10", "circle_crossing_5"')


def test_a_scenario_that_a_planner_cannot_drive_is_told_and_counts_nothing(tmp_path):
    board = write_board(tmp_path / "boards", text=TWO_SCENARIOS)
    (tmp_path / "cheat.py").write_text(
        CHEAT
        + "def known(obs):\n    return np.ones(len(obs.row), bool) if obs.pedestrians.seen.shape[1] == 5 else None\n"
    )
    (tmp_path / "card.toml").write_text(card())
    wanted = Submission(board, "cheat", str(tmp_path / "cheat.py"), {}, [], tmp_path / "card.toml")
    entry, failed = submit(wanted, tmp_path / "boards", tmp_path / "work")
    assert list(failed) == ["circle_crossing_10"]
    assert "raised TypeError" in failed["circle_crossing_10"]
    assert list(entry.spec.facts) == ["circle_crossing_5"]
    found = verify(entry, board, work=tmp_path / "work")
    assert found.verdict == Verdict.RERUN
    assert found.decision_time is not None
    (one,) = standings(board, read_entries(board, tmp_path / "boards"), None).entries
    assert list(one.episodes) == ["circle_crossing_5"]
    assert one.values(board, "score")[0].tolist() == [0.0] * 8


def test_a_full_disk_is_not_the_planners_fault(root, tmp_path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("crowdbench_leaderboards.ranked_run._write_log", full)
    with pytest.raises(MachineFault, match="cannot be written: No space left on device"):
        pytest.fail(verify(entry_of(root), read_board(root / "small"), work=tmp_path / "work").reason)


def test_a_network_is_entered_once(root, tmp_path):
    (tmp_path / "card.toml").write_text(card())
    board = read_board(root / "small")
    for networks in ([{}], [{"weights": "cadrl-seed1"}, {"weights": "cadrl-seed1"}]):
        wanted = Submission(board, "mine", "cadrl", {}, networks, tmp_path / "card.toml")
        with pytest.raises(InputError, match="two networks of the entry are the same"):
            submit(wanted, root, tmp_path / "work")


def test_a_method_is_measured_on_the_cases_that_all_its_networks_drove(root, tmp_path):
    (tmp_path / "card.toml").write_text(card())
    board = read_board(root / "small")
    others = [{"safety_space": space} for space in (0.05, 0.1, 0.15, 0.2)]
    wanted = Submission(board, "margins", "orca", {}, others, tmp_path / "card.toml")
    entry, _ = submit(wanted, tmp_path / "boards", tmp_path / "work")
    found = verify(entry, board, work=tmp_path / "work", cases=Cases("test", 0, 3))
    assert found.method is not None
    assert (found.method.networks, found.method.cases) == (5, 3)


def change_scenario(root, monkeypatch):
    shutil.copytree(catalog.SCENARIOS, root.parent / "scenarios")
    path = next((root.parent / "scenarios").rglob("circle_crossing_5.toml"))
    path.write_text(path.read_text().replace("[vehicle]", "[vehicle]\nradius = 0.31"))
    monkeypatch.setattr("crowdbench.catalog.SCENARIOS", root.parent / "scenarios")


def change_cases(root, monkeypatch):
    write_board(root, text=BOARD.replace("\ncases = 10", "\ncases = 5"))


def change_public_cases(root, monkeypatch):
    write_board(root, text=BOARD.replace("public_cases = 8", "public_cases = 7"))


def change_collision(root, monkeypatch):
    write_board(root, text=BOARD.replace("version = 1", 'version = 1\ncollision = "crowdnav"'))


def change_simulator(root, monkeypatch):
    monkeypatch.setattr("crowdbench_leaderboards.board.SIMULATOR", 10**6)


@pytest.mark.parametrize(
    "change", [change_scenario, change_cases, change_public_cases, change_collision, change_simulator]
)
def test_an_entry_of_another_board_is_pending_and_neither_verified_nor_ranked(root, tmp_path, monkeypatch, change):
    change(root, monkeypatch)
    board = read_board(root / "small")
    with pytest.raises(
        InputError,
        match=r"another simulator, other rules or scenarios of the board small \(\w{12}\) than these \(\w{12}\)",
    ):
        verify(entry_of(root), board, work=tmp_path)
    found = standings(board, read_entries(board, root), read_season(root))
    assert [one.reason for one in found.others] == ["pending", "pending"]
    assert not found.ranked
    assert all(np.isnan(one.figures["score"].mean) for one in found.others)
    assert "| careful, ada | - |" in section(found)


def test_a_verification_of_another_board_does_not_count_for_an_entry_that_was_submitted_again(root, monkeypatch):
    change_cases(root, monkeypatch)
    board = read_board(root / "small")
    for path in (root / "small" / "entries").glob("*/entry.json"):
        path.write_text(json.dumps(json.loads(path.read_text()) | {"board_digest": board.digest}))
    found = standings(board, read_entries(board, root), read_season(root))
    assert [one.reason for one in found.others] == ["reported only", "reported only"]
    assert "another digest of the board" in found.others[0].explanation


def test_who_costs_pedestrians_time_has_it_in_a_column(tmp_path):
    text = BOARD.replace("circle_crossing_5", "circle_crossing_5_visible")
    board = write_board(tmp_path, text=text)
    (tmp_path / "card.toml").write_text(card())
    submit(Submission(board, "orca", "orca", {}, [], tmp_path / "card.toml"), tmp_path, tmp_path / "work")
    (found,) = standings(board, read_entries(board, tmp_path), None).others
    assert 0.0001 < found.figures["imposed_delay"].mean < found.figures["imposed_delay_positive"].mean < 1.0
    assert "| imposed delay, % | positive imposed delay, % |" in section(
        standings(board, read_entries(board, tmp_path), None)
    )


def submit_cheat(root, tmp_path, known, board):
    (tmp_path / "cheat.py").write_text(CHEAT + known)
    (tmp_path / "card.toml").write_text(card())
    wanted = Submission(board, "cheat", str(tmp_path / "cheat.py"), {}, [], tmp_path / "card.toml")
    return submit(wanted, root, tmp_path)[0]


def test_a_planner_that_knows_the_public_cases_alone_is_lower_than_claimed(tmp_path, monkeypatch):
    monkeypatch.setattr("secrets.randbits", lambda bits: 7)  # with some seeds chance alone would explain it
    text = BOARD.replace("public_cases = 8", "public_cases = 40").replace("cases = 10", "cases = 60")
    board = write_board(tmp_path / "boards", text=text)
    known = "def known(obs):\n    return np.full(len(obs.row), len(obs.row) == 40)"
    entry = submit_cheat(tmp_path / "boards", tmp_path, known, board)
    found = verify(entry, board, work=tmp_path / "work")
    assert found.verdict == Verdict.LOWER
    assert "success in circle_crossing_5 was 0.4 as reported and is 0." in found.reason


def test_a_planner_that_fails_on_unknown_cases_is_refused(tmp_path):
    board = write_board(tmp_path / "boards")
    known = "def known(obs):\n    return np.ones(len(obs.row), bool) if len(obs.row) == 8 else None"
    entry = submit_cheat(tmp_path / "boards", tmp_path, known, board)
    found = verify(entry, board, work=tmp_path / "work")
    assert found.verdict == Verdict.REFUSED
    assert "raised TypeError" in found.reason


@pytest.mark.skipif(sandbox.level() != sandbox.BUBBLEWRAP, reason="needs bubblewrap, and the right to use it")
def test_a_planner_cannot_read_the_season_but_its_own_files(tmp_path):
    root = tmp_path / "boards"
    board = write_board(root)
    (root / "season.toml").write_text(SEASON)
    looks = f"""
import os
def known(obs):
    hidden = len(obs.row) == 8 or not os.path.exists({str(root / "season.toml")!r})
    return np.full(len(obs.row), hidden and os.path.exists(__file__)) if hidden else None
"""
    entry = submit_cheat(root, tmp_path, looks, board)
    found = verify(entry, board, work=tmp_path / "work")
    assert found.verdict == Verdict.RERUN, found.reason


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"name": "My Planner"}, "'My Planner' cannot be an entry: its name must be 2 to 50 lower-case letters"),
        ({"name": "orca"}, "exists already: choose another name"),
        ({"planner": "nonesuch"}, "no planner that ships is called 'nonesuch'"),
        ({"account": ""}, "the card of 'mine' names no account"),
        ({"card": "missing.toml"}, "there is no card .*missing.toml, which says what the planner is"),
    ],
)
def test_what_cannot_be_submitted_is_refused_and_leaves_nothing(root, tmp_path, changes, sentence):
    wanted = {"name": "mine", "planner": "orca", "account": "ada", "card": "card.toml"} | changes
    (tmp_path / "card.toml").write_text(card(title='"Mine"', account=f'"{wanted["account"]}"'))
    before = sorted((root / "small" / "entries").iterdir())
    with pytest.raises(InputError, match=sentence):
        submit(
            Submission(
                read_board(root / "small"),
                wanted["name"],
                wanted["planner"],
                {},
                [],
                tmp_path / wanted["card"],
            ),
            root,
            tmp_path / "work",
        )
    assert sorted((root / "small" / "entries").iterdir()) == before


def test_the_readme_has_the_standings(root):
    text = write_readme(root).read_text()
    assert "## Small" in text
    assert re.search(r"\| [AB] \| (1st|2nd|tied, 1st to 2nd) \| orca, baseline \| 0\.\d+ \(", text)
    assert re.search(r"\| [AB] \| (1st|2nd|tied, 1st to 2nd) \| careful, ada \|", text)


def test_the_boards_that_ship_are_in_order_and_have_all_their_scenarios():
    assert [board.name for board in read_boards()][:3] == ["five", "ten", "eight_at_once"]
    with pytest.raises(InputError, match="no board is called 'six'; there are five, ten, "):
        find_board("six")
