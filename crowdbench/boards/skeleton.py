"""The folder of a planner that somebody begins: it drives, it has a test, and a card for leaderboards."""

from __future__ import annotations

import importlib.util
import keyword
import sys
from pathlib import Path

from crowdbench.boards.entry import NAMES
from crowdbench.utils.errors import InputError
from crowdbench.utils.files import new_directory

PLANNER = '''"""{title}: drives straight to the goal, and slowly where a pedestrian is near."""

import numpy as np
from crowdbench import Planner


class {title}(Planner):
    """Keeps a slow speed near pedestrians."""

    def __init__(self, near, slow):
        self.near = near
        self.slow = slow

    def plan(self, obs):  # -> [world, 2], m/s
        to_goal = obs.vehicle.local_goal - obs.vehicle.position
        distance = np.linalg.norm(obs.pedestrians.position - obs.vehicle.position[:, None], axis=2)
        near = ((distance < self.near) & obs.pedestrians.seen).any(axis=1)
        speed = obs.vehicle.preferred_speed * np.where(near, self.slow, 1.0)
        return to_goal * (speed / np.linalg.norm(to_goal, axis=1))[:, None]


def planner(near: float = 1.5, slow: float = 0.3):
    """Make the planner.

    Args:
        near: Distance in metres below which a pedestrian is near.
        slow: Share of the preferred speed that is kept then.
    """
    return {title}(near, slow)
'''

TEST = '''"""The planner keeps its contract and drives. Run with pytest."""

import json
import subprocess
from pathlib import Path

PLANNER = Path(__file__).parent / "{name}.py"


def crowdbench(*arguments):
    return subprocess.run(["crowdbench", *map(str, arguments)], capture_output=True, text=True)


def test_it_keeps_its_contract():
    done = crowdbench("check", PLANNER)
    assert done.returncode == 0, done.stdout + done.stderr


def test_it_reaches_its_goal_where_nobody_is_in_the_way(tmp_path):
    empty = ("--set", "pedestrians.number=0", "--cases", "val:10", "--out", tmp_path / "run", "--json")
    done = crowdbench("run", "--planner", PLANNER, *empty)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["metrics"]["success_rate"]["mean"] == 1.0
'''

CARD = """# What this planner is. `crowdbench submit` puts it into the entry. `paper` and `code` may be missing, as may
# `ablation = true`, for a variant that is shown beside another entry and has no rank. All other fields must be there.
title = "{title}"
authors = ["Your Name"]
contact = "you@example.org"
method = "{name}"  # entries of the same method can be compared with others as a method
licence = "MIT"
description = "Drives straight to the goal, and slowly where a pedestrian is near."
paper = ""  # a DOI or an arXiv number
code = ""  # where the code is
training_data = []  # recorded data that the planner or a part of it was trained on
training_scenarios = []  # scenarios that it was trained in
privileged_training = false  # whether training used what no vehicle can see
crowd_model = "none"  # the model of pedestrians inside the planner, such as "ORCA"
validation_runs = 1  # how many variants were tried before this one was chosen
training_seeds = 0  # how many times it was trained with other seeds
"""


def write_skeleton(name: str, out: Path) -> Path:
    """Make the folder of a new planner.

    Args:
        name: The planner's name, which is the name of the folder.
        out: The folder to make it in.

    Returns:
        Its folder.

    Raises:
        InputError: The name cannot be one, or the folder exists already or cannot be written.
    """
    is_word = keyword.iskeyword(name) or keyword.iskeyword(name.capitalize())
    if not NAMES.fullmatch(name) or not name[0].isalpha() or is_word:
        raise InputError(
            f"{name!r} cannot be the name of a planner: take 2 to 50 lower-case letters, digits and underscores, a "
            "letter first, and no word of Python"
        )
    title = "".join(part.capitalize() for part in name.split("_"))
    folder = out / name
    if folder.exists():
        raise InputError(f"{folder} exists already: choose another name, or another folder with --out")
    if _is_module(name):
        raise InputError(f"{name!r} is a module that is installed, which the planner would hide: take another name")
    with new_directory(folder, overwrite=False) as partial:
        for file, text in {f"{name}.py": PLANNER, f"test_{name}.py": TEST, "card.toml": CARD}.items():
            (partial / file).write_text(text.replace("{title}", title).replace("{name}", name), encoding="utf-8")
    return folder


def _is_module(name: str) -> bool:
    """Whether Python has a module of this name, which the planner's file would replace."""
    if name in sys.builtin_module_names:
        return True
    spec = importlib.util.find_spec(name)
    return spec is not None and spec.origin is not None  # a folder that happens to be here has none
