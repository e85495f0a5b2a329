"""What was found of an entry is believed only where it follows from the entry, the season and a maintainer's key."""

import json
import re
import shutil
import subprocess

import pyarrow.parquet as pq
import pytest
from board_entries import change_rows
from small_boards import BASELINE, make_key, verifier
from typer.testing import CliRunner

from crowdbench.cli.app import app, build_script
from crowdbench.utils.errors import InputError
from crowdbench_leaderboards.board import read_board
from crowdbench_leaderboards.entries import read_entries
from crowdbench_leaderboards.entry import read_entry
from crowdbench_leaderboards.fill import fill, to_submit, to_verify
from crowdbench_leaderboards.pages.standings import standings
from crowdbench_leaderboards.season import read_season
from crowdbench_leaderboards.signature import find_signer, is_signed, sign
from crowdbench_leaderboards.verdict import Unverified, Verification, read_verification

pytestmark = pytest.mark.slow


@pytest.fixture
def key(made):
    return made / "key_of_tester"


def why_unranked(root, name="careful"):
    """Why an entry has no rank; empty where it has one."""
    board = read_board(root / "small")
    found = standings(board, read_entries(board, root), read_season(root))
    return next(one.explanation for one in found.entries if one.entry.name == name)


def change(folder, key=None, **changes):
    """Change what a verdict says; it is signed as before, or again with a key."""
    path = folder / "verdict.json"
    table = json.loads(path.read_text()) | changes
    if key is not None:
        found = Verification.model_validate_json(json.dumps(table))
        table["signature"] = sign(found.signed_content, key)
    path.write_text(json.dumps(table))


def test_a_signed_verification_ranks(root):
    assert why_unranked(root) == ""
    folder = root / "small" / "entries" / "careful"
    text = (folder / "verdict.json").read_text()
    found = json.loads(text)
    assert (found["by"], found["board"], found["entry"]) == ("tester", "small", "careful")
    assert len(text.splitlines()) <= 40
    names = pq.read_schema(folder / "season.parquet").names
    assert names[:4] == ["scenario", "case", "outcome", "steps"]
    assert "score" in names
    assert "command" not in names
    assert sorted(path.name for path in folder.iterdir()) == [
        "card.toml", "entry.json", "planner", "public.parquet", "season.parquet", "verdict.json",
    ]  # fmt: skip


def unsign(folder, root, key):
    change(folder, signature="")


def change_the_time(folder, root, key):
    change(folder, decision_time={"p99_ms": 0.1, "in_time": 1.0, "is_real_time": True})


def sign_with_another_key(folder, root, key):
    (root.parent / "elsewhere").mkdir()
    change(folder, make_key(root.parent, root.parent / "elsewhere", "stranger"))


def sign_for_something_else(folder, root, key):
    content = Verification.model_validate_json((folder / "verdict.json").read_text()).signed_content
    command = ["ssh-keygen", "-q", "-Y", "sign", "-f", key, "-n", "git"]
    lines = subprocess.run(command, check=True, capture_output=True, input=content).stdout.decode().splitlines()
    change(folder, signature="".join(lines[1:-1]))


def sign_as_another_maintainer(folder, root, key):
    change(folder, make_key(root.parent, root, "another"))


def edit_the_cases(folder, root, key):
    change_rows(folder / "season.parquet", "score", lambda values: [1.0] * len(values))


def take_another_entry(folder, root, key):
    for name in ("verdict.json", "season.parquet"):
        shutil.copy(folder.with_name("orca") / name, folder / name)


def choose_a_seed(folder, root, key):
    change(folder, key, seed=1)


def claim_another_season(folder, root, key):
    change(folder, key, season="zeroth")


def write_nonsense(folder, root, key):
    (folder / "verdict.json").write_text("[]")


def nest_deeply(folder, root, key):
    (folder / "verdict.json").write_text("[" * 100_000)


def remove_the_cases(folder, root, key):
    (folder / "season.parquet").unlink()


def remove_all(folder, root, key):
    (folder / "verdict.json").unlink()


@pytest.mark.parametrize(
    ("forge", "why"),
    [
        (unsign, "no maintainer has signed its verification"),
        (change_the_time, "no maintainer has signed its verification"),
        (sign_with_another_key, "no maintainer has signed its verification"),
        (sign_for_something_else, "no maintainer has signed its verification"),
        (sign_as_another_maintainer, "no maintainer has signed its verification"),
        (edit_the_cases, "the ranked cases of its verification were changed"),
        (take_another_entry, "its verification is of another entry, another digest of the board, or other cases"),
        (choose_a_seed, "its verification is of another entry, another digest of the board, or other cases"),
        (claim_another_season, "its verification is of another entry, another digest of the board, or other cases"),
        (write_nonsense, "its verdict.json is damaged"),
        (nest_deeply, "its verdict.json is damaged"),
        (remove_the_cases, "the ranked cases of its verification were changed"),
        (remove_all, "nobody has verified it in this season"),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_a_forged_verification_does_not_rank_and_is_made_again(forge, why, root, key, tmp_path):
    folder = root / "small" / "entries" / "careful"
    forge(folder, root, key)
    assert why in why_unranked(root)
    assert "reported by its authors" in why_unranked(root)
    (job,) = to_verify(verifier(root, tmp_path / "work"), key)
    assert job.title == "careful on small"
    job.do(progress=lambda done: None)
    assert why_unranked(root) == ""


def test_a_link_in_an_entry_leaves_it_out(root):
    folder = root / "small" / "entries" / "careful"
    (folder / "season.parquet").unlink()
    (folder / "season.parquet").symlink_to(folder.with_name("orca") / "season.parquet")
    assert "is not a plain file" in read_entries(read_board(root / "small"), root).bad["careful"]


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
        verifier(root, tmp_path).verify_in_season(entry, read_season(root), tmp_path / "missing")
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


def test_a_planner_of_others_does_not_come_near_the_key(root, key, tmp_path, monkeypatch):
    monkeypatch.setattr("crowdbench_leaderboards.verification.level", lambda: "process")
    for name in ("careful", "orca"):
        (root / "small" / "entries" / name / "verdict.json").unlink()
        entry = read_entry(root / "small" / "entries" / name)
        with pytest.raises(InputError, match="an entry is verified in a sandbox, for which bubblewrap is needed"):
            verifier(root, tmp_path).verify_in_season(entry, read_season(root), key)


def test_a_name_is_no_pattern(root, key):
    signature = sign(b"text", key)
    assert is_signed(b"text", signature, "tester", root)
    assert not is_signed(b"other", signature, "tester", root)
    assert not is_signed(b"text", signature, "*", root)
    assert not is_signed(b"text", signature, "", root)
    assert not is_signed(b"text", f"{signature}\n-----END SSH SIGNATURE-----", "tester", root)


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


def test_fill_says_what_it_does_and_what_it_took(root, key, tmp_path):
    for path in root.glob("small/entries/*/verdict.json"):
        path.unlink()
    (root / "cards").mkdir()
    (root / "cards" / "orca.toml").write_text(BASELINE)
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


def test_fill_drives_ranked_cases_on_workers(root, key, tmp_path):
    (root / "small" / "entries" / "careful" / "verdict.json").unlink()
    command = ["small", "--root", str(root), "--work", str(tmp_path / "work"), "--key", str(key), "--workers", "1"]
    said = CliRunner().invoke(build_script(fill), command).output
    assert "small: 1 ranked runs of 10 cases" in said
    assert why_unranked(root) == ""


def test_fill_refuses_tracks_that_no_board_needs(root, tmp_path):
    done = CliRunner().invoke(build_script(fill), ["small", "--data", str(tmp_path), "--root", str(root)])
    assert "--data goes with boards of recorded people" in str(done.exception)


def test_fill_enters_a_planner_again_if_its_entry_is_pending(root, tmp_path):
    setting = verifier(root, tmp_path / "work")
    assert to_submit(setting) == []
    file = root / "small" / "entries" / "orca" / "entry.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | {"board_digest": "0" * 64}))
    assert [each.title for each in to_submit(setting)] == ["orca on small"]
