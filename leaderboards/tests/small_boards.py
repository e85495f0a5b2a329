"""A small folder of boards with two entries, a planner file and a built-in planner, built once for all tests."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest
from filelock import FileLock

from crowdbench.isolation import sandbox
from crowdbench.plugins.new_planner import make_planner
from crowdbench_leaderboards.board import read_board
from crowdbench_leaderboards.entries import read_entries
from crowdbench_leaderboards.fill import freeze_entries
from crowdbench_leaderboards.submission import Submission, submit
from crowdbench_leaderboards.verification import Verifier

BOARD = """
title = "Small"
description = "Five pedestrians"
version = 1
cases = 10
public_cases = 8
[families]
circle = ["circle_crossing_5"]
"""

SEASON = f"""
name = "first"
closes = 2027-01-31
round = 5000000
randomness = "{"ab" * 32}"
rehearsal = true
"""

SHIPPED = '[[shipped]]\nname = "orca"\nplanner = "orca"\n'


def card(**changes):
    """The text of a card."""
    fields = {"title": '"Mine"', "authors": '["Ada"]', "contact": '"ada@example.org"', "account": '"ada"'}
    fields |= {"method": '"mine"', "licence": '"MIT"', "description": '"Drives."', "training_data": "[]"}
    fields |= {"training_scenarios": "[]", "privileged_training": "false", "crowd_model": '"none"'}
    fields |= {"validation_runs": "1", "training_seeds": "0"}
    return "".join(f"{key} = {value}\n" for key, value in (fields | changes).items())


BASELINE = card(account='""', title='"ORCA"')
"""The card of a planner that ships."""


def write_board(root, name="small", text=BOARD):
    """A board in a folder of boards."""
    (root / name).mkdir(parents=True, exist_ok=True)
    (root / name / "board.toml").write_text(text)
    return read_board(root / name)


def verifier(root, work, name="small", **given):
    """The setting of verifications of a board."""
    return Verifier(read_board(root / name), root, work, {}, **given)


def verify(entry, board, work, cases=None):
    """The verdict on an entry on cases that are drawn now."""
    return Verifier(board, entry.directory.parents[2], work, {}).verify(entry, cases)[0]


def make_key(folder, root, name="tester"):
    """A key that makes somebody a maintainer of a folder of boards."""
    if shutil.which("ssh-keygen") is None:
        pytest.skip("signing verdicts needs ssh-keygen")
    if sandbox.level() == sandbox.PROCESS:
        pytest.skip("verification in a season needs bubblewrap")
    key = folder / f"key_of_{name}"
    subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", str(key)], check=True)
    kind, public, *_ = key.with_suffix(".pub").read_text().split()
    with (root / "maintainers").open("a") as file:
        file.write(f'{name} namespaces="crowdbench" {kind} {public}\n')
    return key


def verified_root(tmp_path_factory):
    """A folder of boards whose two entries, `careful` and `orca`, were verified in a season."""
    own = tmp_path_factory.getbasetemp()
    shared = own.parent if "PYTEST_XDIST_WORKER" in os.environ else own  # all workers of one run of pytest
    with FileLock(shared / "boards.lock"):
        if not (shared / "boards").exists():
            partial = tmp_path_factory.mktemp("boards")
            _make(partial)
            shutil.copytree(partial, shared / "boards-made")
            (shared / "boards-made").rename(shared / "boards")
    return shared / "boards"


def _make(folder: Path):
    root, work = folder / "leaderboards", folder / "work"
    board = write_board(root)
    (root / "season.toml").write_text(SEASON)
    (root / "shipped.toml").write_text(SHIPPED)
    (folder / "card.toml").write_text(card(title='"A plain planner"'))
    (folder / "baseline.toml").write_text(BASELINE)
    planner = make_planner("careful", folder)
    submit(Submission(board, "careful", str(planner / "careful.py"), {}, [], folder / "card.toml"), root, work)
    submit(Submission(board, "orca", "orca", {}, [], folder / "baseline.toml"), root, work)
    season, key = freeze_entries(board, root), make_key(folder, root)
    for entry in read_entries(board, root).good:
        verifier(root, work).verify_in_season(entry, season, key)
    assert not any(path.is_dir() for path in work.iterdir())
