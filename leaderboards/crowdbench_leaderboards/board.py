"""A board: its scenarios and cases, its rules, and the weight of each scenario."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from jaxtyping import Float
from pydantic import Field

from crowdbench import METRICS, PLANNERS, Cases, InputError, Scenario, load_scenario, read_suite, scenario_path
from crowdbench.core import COLLISION_RULES
from crowdbench.metrics import MAIN, OF_FLEETS, Metric, scenario_weights
from crowdbench.runs import LOOK_FIRST, Replanning
from crowdbench.scenario import known_files
from crowdbench.sim import SIMULATOR
from crowdbench.utils import Flag, Location, Name, Names, TomlTable, choice, integer, parse_table, read_toml

FILE = "board.toml"

SUITE = "suite"
"""The value of `families` for the ranked scenarios of `crowdbench suite`."""

MEASURED = (*MAIN, "sct", "intimate_zone", "max_velocity_change", "imposed_delay", "imposed_delay_positive")
"""The metrics that boards show."""

AMONG = "+"
"""Between a scenario of several vehicles and the planner of all but the first one, as in `fleet_4+orca`."""

_NO_RULES = {"title", "description", "position", "recorded", "ranked"}
"""Keys of a board that are not in its digest, because no figure depends on them."""

_PACKAGE = Path(__file__).parent
ROOT = _PACKAGE / "rules" if (_PACKAGE / "rules").is_dir() else _PACKAGE.parent
"""The folder of the boards that ship: in the package in a wheel, beside it in a checkout."""


class BoardSpec(TomlTable):
    """The contents of `board.toml`. `families = "suite"` stands for the ranked scenarios of `crowdbench suite`.

    `position` orders boards in lists. `recorded` is true if the scenarios need recorded tracks, and `ranked` if entries
    have ranks. A scenario such as `fleet_4+orca` has other vehicles, which a planner that ships drives. `public_cases`
    is the number of public cases of each scenario. `cases` is the number of cases in a season, on which entries are
    ranked. `track` is the track of sensing; without one, sensors are as in the files of the scenarios.
    """

    title: Name
    description: Name
    version: int = integer(least=1, most=10**6)
    position: int = integer(1000, least=1, most=1000)
    families: Annotated[
        dict[str, Names], Field(min_length=1, description="a table of families, each with a list of scenarios")
    ]
    recorded: Flag = False
    ranked: Flag = True
    cases: int = integer(1000, least=1, most=10**6)
    public_cases: int = integer(50, least=1, most=10**6)
    replan_every: int = integer(1, least=1, most=1000)
    look_first: int = integer(LOOK_FIRST, least=1, most=1000)
    collision: str = choice(COLLISION_RULES, default="swept")
    # Absent from the rules of boards without a track, so that it does not change their digests.
    track: str | None = Field(default=None, exclude_if=lambda value: value is None, description="a track of sensing")


@dataclass(frozen=True)
class Board:
    """A board.

    Attributes:
        name: The name of its folder.
        spec: The contents of its `board.toml`.
        data: The folder with the recorded tracks that its scenarios need; None if they need none, or if nothing is
            simulated.
    """

    name: str
    spec: BoardSpec
    data: Path | None = None

    def __reduce__(self) -> tuple[type[Board], tuple[str, BoardSpec, Path | None]]:
        """Leave loaded scenarios out: another process cannot import the files of their policies."""
        return Board, (self.name, self.spec, self.data)

    @functools.cached_property
    def parts(self) -> dict[str, Any]:
        """Everything that results and ranks depend on: rules, metrics, scenarios, and the version of the simulator."""
        if self.spec.recorded:
            scenarios = {name: _recorded_digest(name) for name in self.scenarios}
        else:
            scenarios = {scenario.name: scenario.digest for scenario in self._public}
        return {
            "rules": self.spec.model_dump(mode="json", exclude=_NO_RULES),
            "scenarios": scenarios,
            "metrics": list(self.metrics),
            "simulator": SIMULATOR,
        }

    @property
    def digest(self) -> str:
        """The sha256 of `parts`."""
        return _digest(self.parts)

    @functools.cached_property
    def _public(self) -> Sequence[Scenario]:
        """The scenarios with the public cases."""
        return self._load(None)

    @property
    def metrics(self) -> Mapping[str, Metric]:
        """The metrics that are computed for an entry's runs."""
        return {name: METRICS[name] for name in MEASURED} | (OF_FLEETS if self.is_fleet else {})

    @property
    def is_fleet(self) -> bool:
        """True if worlds have several vehicles."""
        return not self.spec.recorded and self._public[0].rules.vehicles > 1

    def scored_vehicles(self, scenario: str) -> int:
        """Return the number of vehicles of a world that are scored: all that the entry drives."""
        if self.spec.recorded or others_in(scenario):
            return 1
        return next(each.rules.vehicles for each in self._public if each.name == scenario)

    @property
    def cases(self) -> Cases:
        """The cases of each scenario in a season."""
        return Cases("test", 0, self.spec.cases)

    @property
    def public_cases(self) -> Cases:
        """The public cases of each scenario."""
        return Cases("test", 0, self.spec.public_cases)

    @property
    def replanning(self) -> Replanning:
        """The steps at which entries observe."""
        return Replanning(self.spec.replan_every, self.spec.look_first)

    @property
    def scenarios(self) -> list[str]:
        """The names of the scenarios, family by family."""
        return [name for names in self.spec.families.values() for name in names]

    @property
    def weights(self) -> Float[np.ndarray, "scenario"]:
        """The weights of the scenarios, with sum 1: equal for all families, and equal for all scenarios of a family."""
        return scenario_weights(self.spec.families)

    def overrides(self, seed: int | None) -> dict[str, Any]:
        """Return the scenario keys that the board sets, for the cases of a seed; None for the public cases."""
        rules: dict[str, Any] = {"collision": self.spec.collision}
        if self.spec.track is not None:
            rules["sensor.track"] = self.spec.track
        if seed is not None:
            rules["seed"] = seed
            if not self.spec.recorded:
                rules["crowdnav_cases"] = 0
        return rules

    def load(self, seed: int | None) -> Sequence[Scenario]:
        """Load the scenarios with the rules of the board and the cases of a seed, see `overrides`.

        Raises:
            InputError: A scenario does not exist, or recorded tracks are not given.
        """
        return self._public if seed is None else self._load(seed)

    def _load(self, seed: int | None) -> Sequence[Scenario]:
        files = {name: name.partition(AMONG)[0] for name in self.scenarios}
        loaded = {name: load_scenario(file, self.overrides(seed), data=self.data) for name, file in files.items()}
        return [dataclasses.replace(scenario, name=name) for name, scenario in loaded.items()]

    def with_data(self, data: Path | None) -> Board:
        """Return the board with the folder of the recorded tracks that its scenarios need.

        Args:
            data: The folder that the user gave, or None.

        Raises:
            InputError: Recorded tracks are needed but are missing or differ, or `data` is given but not needed.
        """
        if data is None:
            if self.spec.recorded:
                raise InputError(f"the people of the board {self.name} were recorded: give their tracks, --data DIR")
            return self
        if not self.spec.recorded:
            raise InputError(f"--data does not go with the board {self.name}, whose people were not recorded")
        board = dataclasses.replace(self, data=data)
        board.load(None)
        return board


def read_board(folder: Path) -> Board:
    """Read a board from its folder.

    Raises:
        InputError: `board.toml` is missing or wrong, or a scenario does not exist. Scenarios with recorded tracks are
            checked by `with_data`.
    """
    file = Location(f"{folder.name}/{FILE}")
    table = read_toml(folder / FILE, "board")
    if table.get("families") == SUITE:
        table["families"] = {name: [name] for name in read_suite().ranked}
    board = Board(folder.name, parse_table(BoardSpec, table, file))
    names = board.scenarios
    if double := [name for i, name in enumerate(names) if name in names[:i]]:
        raise InputError(f"{file.file}: the scenario {double[0]} is in two families")
    with file.at("families").named():
        if not board.spec.recorded:
            _check_vehicles(board)
    return board


def others_in(scenario: str) -> str:
    """Return the planner of all vehicles but the first one in a scenario of a board; empty if the entry drives all."""
    return scenario.partition(AMONG)[2]


def _check_vehicles(board: Board) -> None:
    """Raise InputError if a scenario does not exist, or has no other vehicles or no such planner for them."""
    for scenario in board.load(None):
        others = others_in(scenario.name)
        if others and others not in PLANNERS.built_in():
            raise InputError(f"{scenario.name} needs a planner that ships, but none is called {others!r}")
        if (scenario.rules.vehicles > 1) != board.is_fleet or (others and not board.is_fleet):
            raise InputError(f"{scenario.name}: all scenarios of a board have several vehicles, or all have one")


def _recorded_digest(name: str) -> str:
    """Return the sha256 of a scenario with recorded tracks, which can be loaded only with their files.

    It is computed from the keys of the scenario's file and the sha256 of the tracks, which every run checks.

    Raises:
        InputError: The sha256 of the tracks is not known.
    """
    table = read_toml(scenario_path(name), "scenario")
    tracks = table.get("tracks", {})
    files = {**known_files(tracks.get("scene", "")), **tracks.get("files", {})}
    if not files:
        raise InputError(f"the scenario {name} names no recorded tracks whose sha256 is known: add tracks.files to it")
    return _digest({"keys": {key: value for key, value in table.items() if key != "description"}, "tracks": files})


def _digest(table: Mapping[str, Any]) -> str:
    """Return the sha256 of a table."""
    return hashlib.sha256(json.dumps(table, sort_keys=True).encode()).hexdigest()


def find_board(name: str, root: Path = ROOT) -> Board:
    """Read a board by its name from a folder of boards, or else one that ships.

    Raises:
        InputError: There is no such board, or its `board.toml` is wrong.
    """
    for folder in (root, ROOT):
        if name and "/" not in name and (folder / name / FILE).is_file():
            return read_board(folder / name)
    names = ", ".join(board.name for board in read_boards())
    raise InputError(f"no board is called {name!r}; there are {names}, and those in {root}")


def read_boards(root: Path = ROOT) -> list[Board]:
    """Read the boards of a folder in the order of their `position`. Raises InputError if there is none."""
    boards = [read_board(path.parent) for path in root.glob(f"*/{FILE}")]
    if not boards:
        raise InputError(f"{root} is no folder of boards: no folder in it has a {FILE}")
    return sorted(boards, key=lambda board: (board.spec.position, board.name))
