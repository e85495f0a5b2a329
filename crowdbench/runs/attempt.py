"""An attempt at one case in a JSON file: the commands of a vehicle, as the game of the documentation's start page
writes them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pydantic import Field

from crowdbench import catalog
from crowdbench.results.run_result import RunResult
from crowdbench.runs.loading import load_run
from crowdbench.runs.make import make_run
from crowdbench.runs.replay import Playback
from crowdbench.runs.spec import RunSpec
from crowdbench.scenario.cases import Cases, parse_case
from crowdbench.utils.errors import InputError
from crowdbench.utils.files import read_json, sha256
from crowdbench.utils.toml import Location, Name, TomlTable, parse_table


class Attempt(TomlTable):
    """The file. Its commands are in the units of the vehicle's dynamics; after the last one they are 0."""

    planner: Name
    scenario: Name
    case: Name
    commands: list[list[float]] = Field(min_length=1, description="a list of commands, two numbers each")


def drive_attempt(path: Path, folder: Path) -> RunResult:
    """Return the run of an attempt, which is simulated and written.

    Args:
        path: The file of the attempt.
        folder: The directory of the run.

    Raises:
        InputError: The file is no attempt, or the vehicle cannot execute a command.
    """
    try:
        table = read_json(path)
    except OSError as error:
        raise InputError(f"attempt {path} cannot be read: {error.strerror}") from None
    if not isinstance(table, dict):
        raise InputError(f"{path} is no attempt, which is a table with the keys {', '.join(Attempt.model_fields)}")
    attempt = parse_table(Attempt, table, Location(str(path)))
    scenario = catalog.load_scenario(attempt.scenario)
    commands = np.zeros((1, scenario.rules.max_steps, 2))
    given = attempt.commands[: scenario.rules.max_steps]
    if any(len(command) != 2 for command in given):
        raise InputError(f"{path}: each of the commands must have two numbers")
    commands[0, : len(given)] = given
    split, number = parse_case(attempt.case, "val")
    spec = RunSpec(attempt.planner, attempt.scenario, Cases(split, number, number + 1), record="commands")
    make_run(load_run(spec, Playback(commands), scenario, key=sha256(path)), folder)
    return RunResult.read(folder)
