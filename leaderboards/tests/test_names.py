"""Names of entries and submitters that look like others, and copies of oneself, are refused or gain nothing."""

import dataclasses
import shutil

import pytest
from board_entries import PLANNER, entered, seal
from small_boards import card
from typer.testing import CliRunner

from crowdbench.cli.app import app
from crowdbench.isolation import sandbox
from crowdbench.utils.errors import InputError
from crowdbench_leaderboards.board import read_board
from crowdbench_leaderboards.entry import EntrySpec, check_submitter, read_entries, read_entry
from crowdbench_leaderboards.pages.standings import standings
from crowdbench_leaderboards.season import read_season
from crowdbench_leaderboards.submission import rehearse, submit
from crowdbench_leaderboards.verdict import read_verification
from crowdbench_leaderboards.verification import verify

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sandbox.level() != sandbox.BUBBLEWRAP, reason="needs bubblewrap, and the right to use it"),
]


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


def test_titles_are_ascii(tmp_path):
    with pytest.raises(InputError, match="must have letters of ASCII: others can look like these"):
        rehearse(entered(tmp_path, PLANNER, title='"\u041eRCA"'), tmp_path / "boards")


def test_a_name_of_a_card_that_ships_and_of_another_entry_is_taken(root, tmp_path):
    (root / "cards").mkdir()
    (root / "cards" / "strange.toml").write_text("")
    with pytest.raises(InputError, match=r"'strange', .* is the name of a planner that ships"):
        rehearse(entered(tmp_path, PLANNER, root=root, name="strange", title='"Mine"'), root)
    (root / "cards" / "social_force.toml").write_text("")
    baseline = entered(tmp_path, PLANNER, root=root, name="social_force", title='"Mine"')
    with pytest.raises(InputError, match=r"'social_force', .* is the name of a planner that ships"):
        rehearse(dataclasses.replace(baseline, planner="social_force"), root)
    taken = "is the name of the entry careful"
    with pytest.raises(InputError, match=taken):
        rehearse(entered(tmp_path, PLANNER, root=root, name="care_ful", title='"Mine"'), root)


def test_a_forged_name_is_refused_by_those_who_verify_and_show_it(root, tmp_path):
    shutil.copytree(root / "small" / "entries" / "careful", root / "small" / "entries" / "sarl_cvm")
    board = read_board(root / "small")
    with pytest.raises(InputError, match=r"'sarl_cvm', .* is the name of a planner that ships"):
        verify(read_entry(root / "small" / "entries" / "sarl_cvm"), board, work=tmp_path / "work")
    with pytest.raises(InputError, match=r"'sarl_cvm', .* is the name of a planner that ships"):
        read_entries(board, root)


# A10: names of submitters


@pytest.mark.parametrize(
    "name", ["\u0410da", "\uff21da", "Ada\u200b", "Łukasz", "\u0391da", ".Ada", " Ada", "", " ", "-", "A\u0308"]
)
def test_names_of_submitters_are_ascii(name, folder, tmp_path):
    with pytest.raises(InputError, match="cannot submit an entry"):
        check_submitter(name, "")
    seal(folder, submitted_by=name)
    with pytest.raises(InputError, match=r"submitted_by: |cannot submit an entry"):
        read_entry(folder)


@pytest.mark.parametrize("name", ["crowdbench", "CrowdBench", "crowd-bench", "Crowd Bench.", "crowd_bench"])
def test_nobody_is_called_as_the_maintainers(name):
    with pytest.raises(InputError, match="must be of a planner that ships"):
        check_submitter(name, "")


def test_submitters_differ_by_letters_and_digits(folder):
    own = read_entry(folder)
    for name in ("ADA", "Ada.", "A-d-a", "a d a"):
        spec = own.spec.model_copy(update={"submitted_by": name})
        assert type(own)(folder, EntrySpec(**spec.model_dump()), own.card).submitter == own.submitter


# A13: empty names


@pytest.mark.parametrize("arguments", [["--name", ""], ["--name", " "]])
def test_an_empty_name_is_refused(arguments, tmp_path):
    (tmp_path / "mine.py").write_text(PLANNER)
    (tmp_path / "card.toml").write_text(card())
    command = ["submit", str(tmp_path / "mine.py"), "--board", "five", "--dry-run", *arguments]
    done = CliRunner().invoke(app, command)
    assert done.exit_code != 0
    assert "cannot be an entry: its name must be" in str(done.exception)


@pytest.mark.parametrize("authors", ['[""]', '[" "]', "[]", '["Łukasz"]'])
def test_an_empty_submitter_is_refused(authors, tmp_path):
    (tmp_path / "mine.py").write_text(PLANNER)
    (tmp_path / "card.toml").write_text(card(authors=authors))
    done = CliRunner().invoke(app, ["submit", str(tmp_path / "mine.py"), "--board", "five", "--dry-run"])
    assert done.exit_code != 0
    assert "authors" in str(done.exception) or "cannot submit an entry" in str(done.exception)


# A11: a worse copy of oneself


def outcomes(root, name, successes):
    """Write the outcomes of an entry in the season."""
    path = root / "small" / "verifications" / name / "first" / "circle_crossing_5" / "episodes.csv"
    header, *rows = path.read_text().splitlines()
    columns = [row.split(",") for row in rows]
    for number, row in enumerate(columns):
        row[1] = "success" if number in successes else "timeout"
    path.write_text("\n".join([header, *map(",".join, columns)]) + "\n")


@pytest.mark.parametrize("copied", [range(10), range(9), range(5), range(0)])
@pytest.mark.parametrize("rival", [range(10), range(0)])
def test_a_copy_of_oneself_changes_the_rank_and_the_tier_of_nobody_else(rival, copied, root, monkeypatch):
    board, season = read_board(root / "small"), read_season(root)
    verification = read_verification(read_entry(root / "small" / "entries" / "careful"), board, season)
    monkeypatch.setattr("crowdbench_leaderboards.pages.standings.read_verification", lambda *_: verification)
    outcomes(root, "careful", range(10))
    outcomes(root, "orca", rival)
    before = standings(board, read_entries(board, root), season)
    for folder in ("entries", "verifications"):
        shutil.copytree(root / "small" / folder / "careful", root / "small" / folder / "a_copy")
    outcomes(root, "a_copy", copied)
    after = standings(board, read_entries(board, root), season)
    ranks = [{one.name: str(one.rank) for one in found.ranked} for found in (before, after)]
    assert ranks[1].pop("a_copy")
    assert ranks[0] == ranks[1]
    starts = [dict(zip([one.name for one in found.ranked], found.tiers, strict=True)) for found in (before, after)]
    assert starts[0]["orca"] == starts[1]["orca"]
    assert sum(starts[0].values()) == sum(starts[1].values())
