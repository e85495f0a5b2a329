"""What was found of an entry is believed only where it follows from the entry, the season and a maintainer's key."""

import json
import re
import shutil
import subprocess

import pytest
from small_boards import card, make_key
from typer.testing import CliRunner

from crowdbench.cli.app import app, build_script
from crowdbench.utils.errors import InputError
from crowdbench_leaderboards.board import read_board
from crowdbench_leaderboards.entry import read_entries, read_entry
from crowdbench_leaderboards.fill import fill, to_submit, to_verify
from crowdbench_leaderboards.pages.standings import standings
from crowdbench_leaderboards.season import read_season
from crowdbench_leaderboards.signature import find_signer, is_signed, sign
from crowdbench_leaderboards.verdict import Unverified, read_verification
from crowdbench_leaderboards.verification import verify_in_season

pytestmark = pytest.mark.slow


@pytest.fixture
def key(made):
    return made / "key_of_tester"


def why_unranked(root, name="careful"):
    """Why an entry has no rank; empty where it has one."""
    board = read_board(root / "small")
    found = standings(board, read_entries(board, root), read_season(root))
    return next(one.explanation for one in found.entries if one.entry.name == name)


def change(folder, **changes):
    """Change what a verification says; it is signed as before."""
    path = folder / "verification.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))


def test_a_signed_verification_ranks(root):
    assert why_unranked(root) == ""
    path = root / "small" / "verifications" / "careful" / "first" / "verification.json"
    found = json.loads(path.read_text())
    assert (found["by"], found["board"], found["entry"]) == ("tester", "small", "careful")
    assert list(found["files"]) == ["circle_crossing_5/episodes.csv"]
    header, first, *_ = (path.parent / "circle_crossing_5" / "episodes.csv").read_text().splitlines()
    assert header == "case,outcome,steps,sct"
    assert re.fullmatch(r"0,(success|collision|timeout),\d+,0\.\d{1,6}", first)


def unsign(folder, root, key):
    (folder / "verification.json.sig").unlink()


def raise_figures(folder, root, key):
    perfect = {"mean": 1.0, "low": 1.0, "high": 1.0, "n": 10, "max": 1.0}
    change(folder, figures={"circle_crossing_5": {"success_rate": perfect}})


def sign_with_another_key(folder, root, key):
    (root.parent / "elsewhere").mkdir()
    sign(folder / "verification.json", make_key(root.parent, root.parent / "elsewhere", "stranger"))


def sign_for_something_else(folder, root, key):
    path = folder / "verification.json"
    path.with_name("verification.json.sig").unlink()
    subprocess.run(["ssh-keygen", "-q", "-Y", "sign", "-f", key, "-n", "git", path], check=True, capture_output=True)


def sign_as_another_maintainer(folder, root, key):
    sign(folder / "verification.json", make_key(root.parent, root, "another"))


def edit_the_runs(folder, root, key):
    with (folder / "circle_crossing_5" / "episodes.csv").open("a") as file:
        file.write("\n")


def take_another_entry(folder, root, key):
    shutil.rmtree(folder)
    shutil.copytree(root / "small" / "verifications" / "orca" / "first", folder)


def choose_a_seed(folder, root, key):
    change(folder, seed=1)
    sign(folder / "verification.json", key)


def claim_another_season(folder, root, key):
    change(folder, season="zeroth")
    sign(folder / "verification.json", key)


def write_nonsense(folder, root, key):
    (folder / "verification.json").write_text("[]")


def nest_deeply(folder, root, key):
    (folder / "verification.json").write_text("[" * 100_000)


def link_the_runs(folder, root, key):
    shutil.rmtree(folder / "circle_crossing_5")
    (folder / "circle_crossing_5").symlink_to(root / "small" / "entries" / "careful" / "public" / "circle_crossing_5")


@pytest.mark.parametrize(
    ("forge", "why"),
    [
        (unsign, "no maintainer has signed its verification"),
        (raise_figures, "no maintainer has signed its verification"),
        (sign_with_another_key, "no maintainer has signed its verification"),
        (sign_for_something_else, "no maintainer has signed its verification"),
        (sign_as_another_maintainer, "no maintainer has signed its verification"),
        (edit_the_runs, "the runs of its verification were changed"),
        (take_another_entry, "its verification is of another entry, another digest of the board, or other cases"),
        (choose_a_seed, "its verification is of another entry, another digest of the board, or other cases"),
        (claim_another_season, "its verification is of another entry, another digest of the board, or other cases"),
        (write_nonsense, "its verification.json is damaged"),
        (nest_deeply, "its verification.json is damaged"),
        (link_the_runs, "is not a plain file"),
        (lambda folder, root, key: shutil.rmtree(folder), "nobody has verified it in this season"),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_a_forged_verification_does_not_rank_and_is_made_again(forge, why, root, key, tmp_path, monkeypatch):
    monkeypatch.setattr("crowdbench_leaderboards.calibrated_time.TIMED", 2)
    folder = root / "small" / "verifications" / "careful" / "first"
    forge(folder, root, key)
    assert why in why_unranked(root)
    assert "reported by its authors" in why_unranked(root)
    (job,) = to_verify(read_board(root / "small"), root, tmp_path / "work", key)
    assert job.title == "careful on small"
    job.do()
    assert why_unranked(root) == ""


def test_an_entry_that_was_changed_after_the_freeze_loses_its_rank(root):
    entry = root / "small" / "entries" / "careful"
    table = json.loads((entry / "entry.json").read_text())
    (entry / "entry.json").write_text(json.dumps(table | {"options": {"near": 2.0}}))
    assert "it was not frozen with the other entries, or was changed since" in why_unranked(root)


def test_a_folder_without_maintainers_believes_nobody(root):
    (root / "maintainers").unlink()
    with pytest.raises(Unverified, match="no maintainer has signed"):
        read_verification(
            read_entry(root / "small" / "entries" / "orca"), read_board(root / "small"), read_season(root)
        )


def test_who_is_no_maintainer_verifies_nothing(root, key, tmp_path):
    entry = read_entry(root / "small" / "entries" / "careful")
    with pytest.raises(InputError, match="there is no key"):
        verify_in_season(entry, read_board(root / "small"), tmp_path, read_season(root), tmp_path / "missing")
    (tmp_path / "other").mkdir()
    stranger = make_key(tmp_path, tmp_path / "other", "stranger")
    with pytest.raises(InputError, match=r"is no maintainer's: .* has no line for it"):
        find_signer(stranger, root)
    with pytest.raises(InputError, match="there is no key"):
        find_signer(tmp_path / "missing", root)
    (tmp_path / "damaged").write_text("no key")
    with pytest.raises(InputError, match="does not sign: "):
        find_signer(tmp_path / "damaged", root)
    assert find_signer(key, root) == "tester"
    assert not list(tmp_path.glob("**/trial*"))


def test_a_planner_of_others_does_not_come_near_the_key(root, key, tmp_path, monkeypatch):
    shutil.rmtree(root / "small" / "verifications")
    monkeypatch.setattr("crowdbench_leaderboards.verification.level", lambda: "process")
    settings = {"board": read_board(root / "small"), "work": tmp_path, "season": read_season(root), "key": key}
    for name in ("careful", "orca"):
        with pytest.raises(InputError, match="an entry is verified in a sandbox, for which bubblewrap is needed"):
            verify_in_season(read_entry(root / "small" / "entries" / name), **settings)


def test_a_name_is_no_pattern(root, tmp_path, key):
    path = tmp_path / "text"
    path.write_text("text")
    sign(path, key)
    assert is_signed(path, "tester", root)
    assert not is_signed(path, "*", root)
    assert not is_signed(path, "", root)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--season"], "--season and --key go together"),
        (["--key", "key"], "--season and --key go together"),
        (["--season", "--key", "missing"], "there is no key missing"),
        (["--cases", "1000000"], "--cases is 1000000, but the board small has"),
    ],
)
def test_what_does_not_go_with_a_verification(arguments, sentence, root):
    done = CliRunner().invoke(app, ["verify", str(root / "small" / "entries" / "careful"), *arguments])
    assert sentence in str(done.exception)


def test_fill_says_what_it_does_and_what_it_took(root, key, tmp_path, monkeypatch):
    monkeypatch.setattr("crowdbench_leaderboards.calibrated_time.TIMED", 2)
    shutil.rmtree(root / "small" / "verifications")
    (root / "cards").mkdir()
    (root / "cards" / "orca.toml").write_text(card())
    (root / "shipped.toml").write_text('[[shipped]]\nname = "orca"\nplanner = "orca"\n')
    command = ["small", "--root", str(root), "--work", str(tmp_path / "work")]
    unknown = CliRunner().invoke(build_script(fill), ["five", *command[1:]])
    assert "no board is called 'five'; there are small" in str(unknown.exception)
    said = CliRunner().invoke(build_script(fill), command).output
    assert "small: no entry is verified: give the key of a maintainer, --key FILE" in said
    said = CliRunner().invoke(build_script(fill), [*command, "--key", str(key)]).output
    assert re.search("verification: careful on small, the first of 2", said)
    assert re.search(r"verification: orca on small took \d+\.\d minutes", said)
    assert why_unranked(root) == ""
    shutil.rmtree(root / "small" / "entries" / "orca")
    said = CliRunner().invoke(build_script(fill), command).output
    assert "entry: orca on small, the first of 1" in said


def test_fill_refuses_tracks_that_no_board_needs(root, tmp_path):
    done = CliRunner().invoke(build_script(fill), ["small", "--data", str(tmp_path), "--root", str(root)])
    assert "--data goes with boards of recorded people" in str(done.exception)


def test_fill_enters_a_planner_again_if_its_entry_is_pending(root, tmp_path):
    (root / "shipped.toml").write_text('[[shipped]]\nname = "orca"\nplanner = "orca"\n')
    board, work = read_board(root / "small"), tmp_path / "work"
    assert to_submit(board, root, work) == []
    file = root / "small" / "entries" / "orca" / "entry.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | {"board_digest": "0" * 64}))
    assert [each.title for each in to_submit(board, root, work)] == ["orca on small"]
