"""Names of entries and submitters that look like others, and copies of oneself, are refused or gain nothing."""

import dataclasses
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from board_entries import PLANNER, change_rows, entered, seal
from small_boards import card, verify
from typer.testing import CliRunner

from crowdbench.cli.app import app
from crowdbench.isolation import sandbox
from crowdbench.utils.errors import InputError
from crowdbench_leaderboards.board import read_board
from crowdbench_leaderboards.entries import merge_order, read_entries
from crowdbench_leaderboards.entry import read_card, read_entry
from crowdbench_leaderboards.pages.ranking import Candidate, rank_all
from crowdbench_leaderboards.pages.readme import write_readme
from crowdbench_leaderboards.pages.standings import standings
from crowdbench_leaderboards.season import freeze, read_season
from crowdbench_leaderboards.submission import rehearse, submit

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sandbox.level() != sandbox.BUBBLEWRAP, reason="needs bubblewrap, and the right to use it"),
]


ROOT = Path(__file__).parents[1]


# A6: names


@pytest.mark.parametrize(
    ("name", "title"),
    [
        ("sarl_cvm", "Mine"),
        ("or_ca", "Mine"),
        ("orca_", "Mine"),
        ("mine", "O R C A"),
        ("mine", "sarl-lin"),
        ("0rca", "Mine"),
        ("mine", "SAR1"),
    ],
)
def test_an_entry_is_not_called_as_a_planner_that_ships(name, title, tmp_path):
    wanted = entered(tmp_path, PLANNER, name=name, title=f'"{title}"')
    for make in (rehearse, lambda *given: submit(*given, tmp_path / "work")):
        with pytest.raises(InputError, match="is the name of a planner that ships, or looks like it"):
            make(wanted, tmp_path / "boards")


TITLES = [
    "\u041eRCA",
    "Mine\u202e",
    "a\\nb",
    "<b>Mine</b>",
    "`x`",
    "[x](http://y)",
    " Mine",
    "x" * 61,
    "Mine\u200b",
    "a|b",
]
LOGINS = ["\u0410da", "\uff21da", "ada\u200b", "Ada", "ada_l", "-ada", "ada-", "a--b", "ada ", "a\\nb", "a" * 40, "a.b"]


@pytest.mark.parametrize("title", TITLES)
def test_titles_are_plain_text(title, tmp_path):
    with pytest.raises(InputError, match=r"title is .*, but must be a text of up to 60 letters of ASCII"):
        rehearse(entered(tmp_path, PLANNER, title=f'"{title}"'), tmp_path / "boards")


def test_every_card_that_ships_has_a_plain_title():
    for path in (ROOT / "cards").glob("*.toml"):
        assert read_card(path).account == ""


def test_a_name_of_a_card_that_ships_and_of_another_entry_is_taken(root, tmp_path):
    (root / "cards").mkdir()
    (root / "cards" / "strange.toml").write_text("")
    with pytest.raises(InputError, match=r"'strange', .* is the name of a planner that ships"):
        rehearse(entered(tmp_path, PLANNER, root=root, name="strange", title='"Mine"'), root)
    (root / "cards" / "social_force.toml").write_text("")
    baseline = entered(tmp_path, PLANNER, root=root, name="social_force", title='"Mine"')
    with pytest.raises(InputError, match=r"'social_force', .* is the name of a planner that ships"):
        rehearse(dataclasses.replace(baseline, planner="social_force"), root)
    for name, title in (("care_ful", "Mine"), ("mine", "Careful"), ("mine", "A plain planner."), ("mine", "Careful")):
        with pytest.raises(InputError, match="is the name of the entry careful"):
            rehearse(entered(tmp_path, PLANNER, root=root, name=name, title=f'"{title}"'), root)


def copy_entry(root, name, **changes):
    """Copy the entry `careful` under another name, with another card."""
    folder = root / "small" / "entries" / name
    shutil.copytree(root / "small" / "entries" / "careful", folder)
    (folder / "card.toml").write_text(card(**{"title": f'"{name}"', **changes}))
    seal(folder)
    return folder


def test_a_forged_name_is_refused_by_who_verifies_it_and_left_out_by_who_shows_it(root, tmp_path):
    copy_entry(root, "sarl_cvm")
    board = read_board(root / "small")
    with pytest.raises(InputError, match=r"'sarl_cvm', .* is the name of a planner that ships"):
        verify(read_entry(root / "small" / "entries" / "sarl_cvm"), board, work=tmp_path / "work")
    found = read_entries(board, root)
    assert [entry.name for entry in found.good] == ["careful", "orca"]
    assert "is the name of a planner that ships" in found.bad["sarl_cvm"]


# B3: baselines follow from shipped.toml


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"account": '""'}, "names no account"),
        ({"account": '"crowdbench"'}, ""),
    ],
)
def test_an_entry_is_a_baseline_only_where_shipped_toml_lists_it(changes, why, root):
    copy_entry(root, "mine", **changes)
    board = read_board(root / "small")
    found = read_entries(board, root)
    table = standings(board, found, read_season(root))
    assert {one.name for one in table.entries if one.is_baseline} == {"orca"}
    assert why in found.bad.get("mine", "")
    assert ("mine" in found.bad) == bool(why)


def test_a_baseline_is_the_planner_that_shipped_toml_lists(root):
    folder = root / "small" / "entries" / "orca"
    seal(folder, options={"safety_space": 0.2})
    found = read_entries(read_board(root / "small"), root)
    assert "shipped.toml lists orca with another planner or other options" in found.bad["orca"]
    seal(folder, options={})
    (folder / "card.toml").write_text(card())
    seal(folder)
    found = read_entries(read_board(root / "small"), root)
    assert "is the name of a planner that ships" in found.bad["orca"]


# A10, B4, B10: accounts are compared as the forge does


@pytest.mark.parametrize("account", [*LOGINS, "ada\\n"])
def test_accounts_are_logins_of_the_forge(account, tmp_path):
    (tmp_path / "card.toml").write_text(card(account=f'"{account}"'))
    with pytest.raises(InputError, match=r"account is .*, but must be the login of an account of the forge"):
        read_card(tmp_path / "card.toml")


def test_accounts_that_look_alike_are_two(root):
    board, season = read_board(root / "small"), read_season(root)
    copy_entry(root, "second", account='"ad-a"')
    copy_entry(root, "third", account='"ad4"')
    found = read_entries(board, root)
    assert {entry.name: entry.account for entry in found.good}["second"] == "ad-a"
    assert not found.bad
    candidates = [
        Candidate(name, owner, np.full((1, 9), score), np.zeros((1, 9)))
        for name, owner, score in (("a", "adalovelace", 0.9), ("b", "ada1ovelace", 0.2), ("c", "ada1ovelace", 0.1))
    ]
    assert set(rank_all(candidates, np.ones(1)).rank) == {"a", "b", "c"}
    assert season.ranks("small", "careful")


# B5: the two that rank are named before the freeze


def test_the_two_that_rank_are_decided_at_the_freeze(root):
    (root / "frozen.json").unlink()
    for name in ("first", "second", "third"):
        copy_entry(root, name)
    copy_entry(root, "aside", ranked="false")
    board = read_board(root / "small")
    season = freeze(root, "small", read_entries(board, root).good)
    ranked = {name: one.ranked for name, one in season.frozen["small"].items()}
    assert ranked == {"aside": False, "careful": True, "first": True, "orca": True, "second": False, "third": False}
    for name in ("careful", "first"):  # withdrawn after the freeze
        shutil.rmtree(root / "small" / "entries" / name)
    again = read_season(root)
    assert not again.ranks("small", "second")
    assert again == season
    found = standings(board, read_entries(board, root), again)
    assert found.withdrawn == {"careful": "ada", "first": "ada"}
    assert {one.name for one in found.ranked} == set()


# B6: one bad entry is left out


def break_look_alike(root):
    copy_entry(root, "0rca")


def break_planner(root):
    seal(copy_entry(root, "bad"), planner="planner/careful.py\n")


def break_json(root):
    (copy_entry(root, "bad") / "entry.json").write_text("[" * 5000)


def break_card(root):
    (copy_entry(root, "bad") / "card.toml").write_bytes(b"\xff\xfe")


def break_table(root):
    (copy_entry(root, "bad") / "public.parquet").write_bytes(b"PAR1nothingPAR1")


def break_name_of_scenario(root):
    change_rows(copy_entry(root, "bad") / "public.parquet", "scenario", lambda names: ["<script>"] * len(names))


def break_outcome(root):
    change_rows(copy_entry(root, "bad") / "public.parquet", "outcome", lambda names: ["running\n"] * len(names))


def break_numbers(root):
    change_rows(copy_entry(root, "bad") / "public.parquet", "score", lambda values: [float("inf")] * len(values))


def break_file(root):
    (copy_entry(root, "bad") / "planner" / "x.so").write_text("")


def break_folder(root):
    copy_entry(root, "bad").rename(root / "small" / "entries" / "Bad name")


def break_entry(root):
    path = copy_entry(root, "bad") / "entry.json"
    path.unlink()
    path.mkdir()


@pytest.mark.parametrize(
    "break_it",
    [break_look_alike, break_planner, break_json, break_card, break_table, break_name_of_scenario, break_outcome,
     break_numbers, break_file, break_folder, break_entry],
)  # fmt: skip
def test_a_bad_entry_stops_neither_the_freeze_nor_the_pages_of_others(break_it, root):
    before = write_readme(root).read_text()
    break_it(root)
    board = read_board(root / "small")
    assert freeze(root, "small", read_entries(board, root).good) == read_season(root)
    after = write_readme(root).read_text()
    bad = [line for line in after.splitlines() if "is left out: " in line]
    assert len(bad) == 1
    assert after.replace(bad[0] + "\n\n", "").replace(bad[0] + "\n", "").split() == before.split()


def test_of_two_entries_of_one_name_the_one_that_was_merged_first_stays(root):
    who = ["-c", "user.name=a", "-c", "user.email=a@example.org"]

    def git(*arguments):
        subprocess.run(["git", *who, *arguments], cwd=root, check=True, capture_output=True)

    git("init", "-q", "-b", "main")
    git("add", "-A")
    git("commit", "-q", "-m", "base")
    for name in ("z_alike", "zalike"):  # two requests, each checked before either is merged
        git("checkout", "-q", "-b", name, "main")
        copy_entry(root, name)
        git("add", "-A")
        git("commit", "-q", "-m", name)
        git("checkout", "-q", "main")
    git("merge", "-q", "--no-ff", "zalike")
    git("merge", "-q", "--no-ff", "z_alike")
    assert [path.name for path in merge_order(root / "small" / "entries")][2:] == ["zalike", "z_alike"]
    found = read_entries(read_board(root / "small"), root)
    assert list(found.bad) == ["z_alike"]
    assert "is the name of the entry zalike" in found.bad["z_alike"]
    git("rm", "-r", "-q", "small/entries/zalike")
    git("commit", "-q", "-m", "withdrawn")
    copy_entry(root, "zalike")
    git("add", "-A")
    git("commit", "-q", "-m", "again")
    assert list(read_entries(read_board(root / "small"), root).bad) == ["zalike"]


# A13: empty names


@pytest.mark.parametrize("arguments", [["--name", ""], ["--name", " "]])
def test_an_empty_name_is_refused(arguments, tmp_path):
    (tmp_path / "mine.py").write_text(PLANNER)
    (tmp_path / "card.toml").write_text(card())
    command = ["submit", str(tmp_path / "mine.py"), "--board", "five", "--dry-run", *arguments]
    done = CliRunner().invoke(app, command)
    assert done.exit_code != 0
    assert "cannot be an entry: its name must be" in str(done.exception)


def test_a_card_without_an_account_is_refused(tmp_path):
    (tmp_path / "mine.py").write_text(PLANNER)
    (tmp_path / "card.toml").write_text(card(account='""'))
    done = CliRunner().invoke(app, ["submit", str(tmp_path / "mine.py"), "--board", "five", "--dry-run"])
    assert done.exit_code != 0
    assert "names no account" in str(done.exception)


# A11: a worse copy of oneself


@pytest.mark.parametrize("copied", [1.0, 0.9, 0.5, 0.0])
@pytest.mark.parametrize("rival", [1.0, 0.0])
def test_a_copy_of_oneself_changes_the_rank_of_nobody_else(rival, copied):
    def candidate(name, owner, share):
        return Candidate(name, owner, (np.arange(40)[None] < 40 * share).astype(float), np.zeros((1, 40)))

    own = [candidate("careful", "ada", 1.0), candidate("orca", "maintainers: orca", rival)]
    before = rank_all(own, np.ones(1))
    after = rank_all([*own, candidate("a_copy", "ada", copied)], np.ones(1))
    assert after.rank.pop("a_copy")
    assert before.rank == after.rank
