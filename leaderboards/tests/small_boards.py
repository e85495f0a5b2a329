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
from crowdbench_leaderboards.calibrated_time import NotTimed
from crowdbench_leaderboards.entry import read_entries
from crowdbench_leaderboards.fill import freeze_entries
from crowdbench_leaderboards.submission import Submission, submit
from crowdbench_leaderboards.verification import verify_in_season

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


def card(**changes):
    """The text of a card."""
    fields = {"title": '"A <b>planner</b>"', "authors": '["Ada"]', "contact": '"ada@example.org"', "method": '"mine"'}
    fields |= {"licence": '"MIT"', "description": '"Drives."', "training_data": "[]", "training_scenarios": "[]"}
    fields |= {"privileged_training": "false", "crowd_model": '"none"', "validation_runs": "1", "training_seeds": "0"}
    return "".join(f"{key} = {value}\n" for key, value in (fields | changes).items())


def write_board(root, name="small", text=BOARD):
    """A board in a folder of boards."""
    (root / name).mkdir(parents=True, exist_ok=True)
    (root / name / "board.toml").write_text(text)
    return read_board(root / name)


def not_timed(monkeypatch):
    """No decisions are timed, which takes long."""

    def raise_not_timed(*_):
        raise NotTimed("")

    for module in ("submission", "verification"):
        monkeypatch.setattr(f"crowdbench_leaderboards.{module}.time_decisions", raise_not_timed)


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
    (folder / "card.toml").write_text(card())
    planner = make_planner("careful", folder)
    submit(Submission(board, "careful", str(planner / "careful.py"), {}, [], folder / "card.toml", "Ada"), root, work)
    submit(Submission(board, "orca", "orca", {}, [], folder / "card.toml", "crowdbench"), root, work)
    season, key = freeze_entries(board, root), make_key(folder, root)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("crowdbench_leaderboards.calibrated_time.TIMED", 2)
        for entry in read_entries(board, root):
            verify_in_season(entry, board, work, season, key)
    assert not any(path.is_dir() for path in work.iterdir())
