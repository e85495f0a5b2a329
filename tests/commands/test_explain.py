"""Every option that ships says what it is, and in which unit."""

from dataclasses import dataclass

import pytest

from crowdbench import catalog
from crowdbench.cli.listing import WORDS, OptionRow, list_, option_rows, parameter_rows
from crowdbench.cli.options import parse_docstring
from crowdbench.predict.predictors import PREDICTORS
from crowdbench.utils.errors import InputError

PLANNERS = {f"planner {name}": catalog.PLANNERS.find(name)[1] for name, _ in catalog.PLANNERS.names()}
SHIPPED = PLANNERS | {f"predictor {name}": factory for name, factory in PREDICTORS.functions.items()}


def lacks(row):
    """What the docstring of an option should say and does not, empty where nothing is missing."""
    if not row.meaning:
        return "a meaning"
    is_number = not {WORDS[float], WORDS[int]}.isdisjoint(row.type.split(" or "))
    return "a unit" if is_number and not row.unit else ""


@pytest.mark.parametrize("factory", SHIPPED.values(), ids=SHIPPED)
def test_every_option_that_ships_has_a_meaning_and_every_number_a_unit(factory):
    assert [(row.name, lacks(row)) for row in option_rows(factory) if lacks(row)] == []


@pytest.mark.parametrize("name", [name for name, _ in catalog.PEDESTRIANS.names()])
def test_every_parameter_of_a_pedestrian_policy_has_a_meaning_and_a_unit(name):
    rows = parameter_rows(name, catalog.PEDESTRIANS.find(name)[1])
    assert bool(rows) == (name not in {"recorded", "standing", "straight"})
    assert [(row.name, lacks(row)) for row in rows if lacks(row)] == []


@dataclass(frozen=True)
class Wheels:
    """Wheels.

    Attributes:
        number: How many [1].
        diameter: Of each [m].
        track: Between two of them.
    """

    number: int
    diameter: float = 0.7
    track: float = 1.0


def vehicle(
    name: str,
    doors: int = 4,
    length: float | None = None,
    open: bool = False,
    wheels: Wheels | None = None,
    unsaid: str = "",
):
    """A vehicle.

    It has wheels.

    Args:
        name: What it is called.
        doors: Number of doors,
            the boot aside [1].
        length: From bumper to bumper [m].
        open: Whether it has a roof.
        wheels: What it stands on; false for none.
    """


ROWS = [
    OptionRow("name", "", "text", "", "What it is called."),
    OptionRow("doors", "4", "whole number", "1", "Number of doors, the boot aside."),
    OptionRow("length", "false", "number or false", "m", "From bumper to bumper."),
    OptionRow("open", "false", "true or false", "", "Whether it has a roof."),
    OptionRow("wheels", "false", "table or false", "", "What it stands on; false for none."),
    OptionRow("  number", "", "whole number", "1", "How many."),
    OptionRow("  diameter", "0.7", "number", "m", "Of each."),
    OptionRow("  track", "1", "number", "", "Between two of them."),
    OptionRow("unsaid", '""', "text", "", ""),
]


def test_options_are_read_from_signature_and_docstring():
    assert option_rows(vehicle) == ROWS
    assert parse_docstring(vehicle.__doc__)[0].split() == ["A", "vehicle.", "It", "has", "wheels."]


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["planners", "sarl_sgan_kce"], ["Li, Shan, Narula", "max_acceleration     6.4", "m/s^2"]),
        (["pedestrians", "orca"], ["pedestrians.orca.time_horizon", "--set name=value"]),
        (["metrics", "spl"], ["Anderson"]),
        (["scenarios", "circle_crossing_5"], ["circle_radius = 4.0"]),
    ],
)
def test_one_thing_is_explained(arguments, expected, capsys):
    list_(*arguments)
    printed = capsys.readouterr().out
    for text in expected:
        assert text in printed


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["planners", "orka"], "no planner is called 'orka' .did you mean orca.*; there are"),
        (["metrics", "orka"], "no metric is called 'orka'; there are"),
    ],
)
def test_what_is_not_there_gets_one_sentence(arguments, expected):
    with pytest.raises(InputError, match=expected):
        list_(*arguments)
