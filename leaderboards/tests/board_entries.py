"""Entries of a planner with a given source text, which tests submit to a temporary board."""

import json

from small_boards import card, write_board

from crowdbench.utils.files import sha256
from crowdbench_leaderboards.board import read_board
from crowdbench_leaderboards.submission import Submission, submit

PLANNER = """
import os, time
import crowdbench, numpy as np

class Mine(crowdbench.Planner):
    def plan(self, obs):
        way = obs.vehicle.goal - obs.vehicle.position
        near = np.linalg.norm(obs.pedestrians.position - obs.vehicle.position[:, None], axis=2).min(axis=1) < 1.2
        return think(obs, way * (np.where(near, 0.3, 0.9) / np.hypot(*way.T))[:, None])

def think(obs, commands):
    return commands

def planner(weights="", seed=0):
    return Mine()
"""


def seal(folder, **changes):
    """Write what an entry says, with the digests of its files as they are now."""
    table = json.loads((folder / "entry.json").read_text()) | changes
    paths = [path for path in folder.rglob("*") if path.is_file() and path.name != "entry.json"]
    table["files"] = {path.relative_to(folder).as_posix(): sha256(path) for path in paths}
    (folder / "entry.json").write_text(json.dumps(table))


def entered(tmp_path, text, options=None, networks=(), name="mine", root=None, **fields):
    """What is submitted with a planner of this text."""
    root = root or tmp_path / "boards"
    board = read_board(root / "small") if (root / "small").exists() else write_board(root)
    (tmp_path / "mine.py").write_text(text)
    (tmp_path / "card.toml").write_text(card(**fields))
    return Submission(
        board, name, str(tmp_path / "mine.py"), options or {}, list(networks), tmp_path / "card.toml", "Ada"
    )


def submitted(tmp_path, text, **given):
    """An entry with a planner of this text, and its board."""
    wanted = entered(tmp_path, text, **given)
    return submit(wanted, tmp_path / "boards", tmp_path / "work")[0], wanted.board
