import math
import subprocess
import sys
from typing import Annotated

import pytest
from pydantic import AfterValidator, Field

from crowdbench.utils.errors import InputError
from crowdbench.utils.toml import (
    Flag,
    Location,
    Name,
    Names,
    TomlTable,
    Values,
    choice,
    integer,
    number,
    parse_table,
    read_toml,
    table,
)


def even(value: int) -> int:
    if value % 2:
        raise InputError(f"{value} is odd: give an even number")
    return value


class Wheel(TomlTable):
    name: Name
    radius: float = number(1.0, above=0.0, below=2.0)
    spokes: Annotated[int, AfterValidator(even)] = integer(8, least=0, most=100)


class Body(TomlTable):
    colour: str = choice(("red", "dark+green"), default="red")
    painted: Flag = False


class Car(TomlTable):
    wheels: list[Wheel] = Field(default=[], description="a list of tables [[wheels]]")
    spare: Wheel | None = Field(default=None, description="a table [spare]")
    body: Body = table("body")
    doors: Annotated[int, AfterValidator(even)] = integer(4, least=0, most=9)
    owners: Names = Field(default=["nobody"])
    options: Values = Field(default={})


NAMED = {"name": "a"}

WRONG = [
    ({"wheels": [NAMED, {"colour": "red"}]}, "unknown key wheels[2].colour; the keys here are name, radius, spokes"),
    (
        {"body": {"colour": 3}, "wheel": 4},
        "unknown key wheel (did you mean wheels?); the keys here are wheels, spare, body",
    ),
    ({"wheels": [{"radius": 1.0}]}, "wheels[1].name is missing, but must be a text in quotes"),
    ({"wheels": [{"name": ""}]}, "wheels[1].name is '', but must be a text in quotes, not an empty one"),
    ({"wheels": NAMED}, "wheels is {'name': 'a'}, but must be a list of tables [[wheels]]"),
    ({"wheels": [3]}, "wheels is [3], but must be a list of tables [[wheels]]"),
    ({"wheels": [{**NAMED, "spokes": 7}]}, "in wheels[1], 7 is odd: give an even number"),
    ({"spare": {**NAMED, "radius": 2.0}}, "spare.radius is 2.0, but must be a number above 0 and below 2"),
    ({"spare": {**NAMED, "radius": True}}, "spare.radius is True, but must be a number above 0"),
    ({"spare": {**NAMED, "radius": math.nan}}, "spare.radius is nan, but must be a number above 0"),
    ({"spare": {**NAMED, "spokes": 8.0}}, "spare.spokes is 8.0, but must be a whole number from 0 to 100"),
    ({"body": {"colour": "darkgreen"}}, 'body.colour is \'darkgreen\', but must be one of "red", "dark+green"'),
    ({"body": {"painted": 1}}, "body.painted is 1, but must be true or false"),
    ({"body": 3}, "body is 3, but must be a table [body]"),
    ({"owners": ["a", "a"]}, "owners is ['a', 'a'], but must be a list of texts in quotes, none of them twice"),
    ({"options": {"a": [math.inf]}}, "options is {'a': [inf]}, but must be a table such as { key = 1.0 }"),
    ({"doors": 3}, "3 is odd: give an even number"),
]


@pytest.mark.parametrize(("given", "sentence"), WRONG)
def test_what_is_wrong_is_said_in_one_sentence(given, sentence):
    with pytest.raises(InputError) as error:
        parse_table(Car, given, Location("car.toml"))
    assert str(error.value).startswith(f"car.toml: {sentence}")
    assert "\n" not in str(error.value)


def test_a_table_within_a_file_is_named_from_the_top():
    with pytest.raises(InputError, match=r"car.toml: cars\[3\].spare.name is missing"):
        parse_table(Car, {"spare": {}}, Location("car.toml").at("cars", 2))


def test_what_is_left_out_has_its_default_and_whole_numbers_are_numbers():
    car = parse_table(Car, {"wheels": [{"name": "a", "radius": 1}]}, Location("car.toml"))
    assert car.complete() == {
        "wheels": [{"name": "a", "radius": 1.0, "spokes": 8}],
        "spare": None,
        "body": {"colour": "red", "painted": False},
        "doors": 4,
        "owners": ["nobody"],
        "options": {},
    }
    assert isinstance(car.wheels[0].radius, float)


def test_the_command_line_starts_without_pydantic():
    code = "import sys, crowdbench.cli; sys.exit('pydantic' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


def test_a_byte_order_mark_is_ignored(tmp_path):
    (tmp_path / "a.toml").write_text('\ufeffname = "a"\n', encoding="utf-8")
    assert read_toml(tmp_path / "a.toml", "scenario") == {"name": "a"}
