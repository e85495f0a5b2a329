"""Entries of a planner with a given source text, which tests submit to a temporary board."""

import json

import pyarrow as pa
import pyarrow.parquet as pq
from small_boards import card, write_board

from crowdbench_leaderboards.board import read_board
from crowdbench_leaderboards.entry import files_digest
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
    """Write what an entry says, with the digest of its files as they are now."""
    table = json.loads((folder / "entry.json").read_text()) | changes
    if "files" not in changes:
        table["files"] = files_digest(folder)
    (folder / "entry.json").write_text(json.dumps(table))


def change_rows(path, column, change):
    """Change a column of a table of episodes, given as a list."""
    table = pq.read_table(path)
    values = pa.array(change(table[column].to_pylist()), table.schema.field(column).type)
    pq.write_table(table.set_column(table.column_names.index(column), column, values), path)


def entered(tmp_path, text, options=None, networks=(), name="mine", root=None, **fields):
    """What is submitted with a planner of this text."""
    root = root or tmp_path / "boards"
    board = read_board(root / "small") if (root / "small").exists() else write_board(root)
    (tmp_path / "mine.py").write_text(text)
    (tmp_path / "card.toml").write_text(card(**fields))
    return Submission(board, name, str(tmp_path / "mine.py"), options or {}, list(networks), tmp_path / "card.toml")


def submitted(tmp_path, text, **given):
    """An entry with a planner of this text, and its board."""
    wanted = entered(tmp_path, text, **given)
    return submit(wanted, tmp_path / "boards", tmp_path / "work")[0], wanted.board
