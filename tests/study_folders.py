"""Studies in an empty folder, and artificial results of runs."""

import dataclasses
import math
import types
from pathlib import Path

import numpy as np
import pytest

from crowdbench.cli.app import build_script
from crowdbench.core.types import Outcome
from crowdbench.results.episodes import Episodes
from crowdbench.runs.folder import run_directory
from crowdbench.utils.errors import InputError
from studies.pages import Page
from studies.run import page
from studies.tables import read_tables

# As a planner with networks: what the weights hold is another file's matter.
MINE = """
import json
from pathlib import Path
from crowdbench.planners.reactive import ORCAPlanner

def planner(weights="one", margin=0.0):
    learned = json.loads(Path("weights.json").read_text())[weights]
    made = ORCAPlanner(learned + margin)
    made.facts = {"weights": str(learned)}
    return made
"""

NETWORKS = """
[[networks]]
title = "Learned planners"
scenario = "circle_crossing_5"
cases = "10"
measures = ["success_rate", "navigation_time"]
variant = { title = "CrowdNav's rule", overrides = { collision = "crowdnav" } }

[[networks.rows]]
planner = "./mine.py"
weights = ["one", "two"]
reported = { success_rate = 0.99, navigation_time = 10.6 }
second_reading = "12:24"
"""

CROWDS = """
[[tables]]
title = "Crowds"
cases = "8"
scenarios = ["circle_crossing_5", "square_crossing_5"]
planners = ["orca", "orca_margin"]
"""

TABLE = """
[[networks]]
title = "Beside"
scenario = "circle_crossing_5"
cases = "20"
replan_every = 2

[[networks.rows]]
label = "mine"
planner = "./mine.py"
weights = ["one", "two"]
reported = { success_rate = 0.972, navigation_time = 12.58 }

[[networks.rows]]
label = "other"
planner = "./mine.py"
weights = ["two", "one"]
options = { margin = 0.1 }

[[networks.rows]]
label = "orca"
planner = "orca"
"""


def read_page(text):
    Path("tiny.toml").write_text(text)
    head, tables = read_tables(Path("tiny.toml"))
    return Page("tiny", head.description, tables, head.sources)


def refused(text, parts, read=read_page):
    """That the file is refused in one sentence, which has these parts and names the file once."""
    with pytest.raises(InputError) as error:
        read(text)
    message = str(error.value)
    assert "\n" not in message
    assert message.count("tiny.toml") == 1
    for part in parts:
        assert part in message


def print_page(text, *arguments):
    Path("tiny.toml").write_text(text)
    build_script(page)(["tiny.toml", *arguments], standalone_mode=False)


def made():
    """Name, and when it was made, of every run of the study."""
    return {path.name: path.stat().st_mtime_ns for path in Path("runs/study-tiny").iterdir()}


def episodes(success, **columns):
    """A table of episodes; a failure is a collision."""
    success = np.array(success, bool)
    columns = {name: np.array(values, float) for name, values in columns.items()}
    return Episodes(
        case=np.arange(len(success)),
        outcome=np.where(success, Outcome.SUCCESS, Outcome.COLLISION),
        steps=np.full(len(success), 40),
        columns={
            "success_rate": success,
            "collision_rate": ~success,
            "at_fault_rate": success & ~success,
            "wall_collision_rate": success & ~success,
            "timeout_rate": success & ~success,
            "vehicle_share": np.full(len(success), np.nan),
        }
        | columns,
    )


NOTHING = types.SimpleNamespace(commands=None, number=0)
"""A recorder that has recorded nothing."""


def leave(run, out, table):
    """As if a run had left this table of episodes; metrics that it lacks are undefined."""
    others = {name: np.full(len(table), np.nan) for name in run.metrics} | {
        "person_collision_rate": table.columns["collision_rate"]
    }
    table = dataclasses.replace(table, columns=others | table.columns)
    directory = run_directory(run, out)
    directory.mkdir(parents=True)
    run._write(directory, run.spec.cases, table, NOTHING, 0.0)


def fill(asked, out, **rows):
    """Leaves a table of episodes for each run of each row named, in order, and fills the only table."""
    (table,) = asked.tables
    for row in table.rows:
        for run, table_of_episodes in zip(row.runs, rows[row.label], strict=True):
            leave(run, out, table_of_episodes)
    return table.fill(out)


def table(success, time=10.0, change=1.0, jerk=5.0):
    success = np.array(success, bool)
    columns = {"navigation_time": np.where(success, time, math.nan), "max_velocity_change": change, "jerk": jerk}
    return episodes(success, **{name: np.broadcast_to(values, len(success)) for name, values in columns.items()})


def cells(markdown):
    """The cells of every line of every grid, but for the rules under headings."""
    lines = [line for line in markdown.splitlines() if line.startswith("| ") and "---" not in line]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
