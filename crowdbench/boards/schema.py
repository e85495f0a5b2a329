"""What `board.toml`, `season.toml` and `card.toml` may hold: their keys, and the default of each key."""

from __future__ import annotations

import datetime
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, InstanceOf

from crowdbench.core.types.rules import COLLISION_RULES
from crowdbench.runs.spec import LOOK_FIRST
from crowdbench.utils.toml import Flag, Name, Names, Text, TomlTable, choice, integer, number

Families = Annotated[
    dict[str, Names], Field(min_length=1, description="a table of families, each with a list of scenarios")
]

Texts = Annotated[list[Text], Field(description="a list of texts in quotes")]


def _date(value: Any) -> Any:
    # A date and time is a date for Python.
    return value if not isinstance(value, datetime.datetime) else None


Date = Annotated[InstanceOf[datetime.date], BeforeValidator(_date), Field(description="a date, such as 2027-01-31")]


class FlagsSpec(TomlTable):
    """`flags`: bounds beyond which an entry is called intrusive or jerky. They were fixed on validation cases.

    `intimate_zone` is the largest share of time with a gap below 0.45 m to somebody. `imposed_delay` is the largest
    mean of the time that all pedestrians of a case together lose to the vehicle, where they see it, in seconds. `jerk`
    is the largest 95th percentile over episodes, in m/s^3.
    """

    intimate_zone: float = number(above=0.0, below=1.0)
    imposed_delay: float | None = number(None, above=0.0, below=10000.0)
    jerk: float = number(above=0.0, below=1000.0)


class SeasonSpec(TomlTable):
    """The whole of `season.toml`: when entries are frozen, and what the seed of their cases then follows from.

    `round` is a round of drand's default chain (League of Entropy) after `closes`, and `randomness` what it has
    published, empty before. `rehearsal` is for a season whose round was known before it closed.
    """

    name: Name
    closes: Date
    round: int = integer(least=1, most=2**53)
    randomness: Annotated[
        str,
        Field(pattern="^([0-9a-f]{64})?$", description="64 hexadecimal digits, or empty before the round"),
    ] = ""
    rehearsal: Flag = False


class BoardSpec(TomlTable):
    """The whole of `board.toml`. A change of the rules is a new `version`.

    `position` orders boards where several are listed. `recorded` says that its scenarios need recorded tracks, and
    `ranked` whether entries have ranks. Authors run `public_cases` of each scenario, which everybody knows. A season's
    figures are of `cases` of each.
    """

    title: Name
    description: Name
    version: int = integer(least=1, most=10**6)
    position: int = integer(1000, least=1, most=1000)
    families: Families
    recorded: Flag = False
    ranked: Flag = True
    cases: int = integer(2000, least=1, most=10**6)
    public_cases: int = integer(500, least=1, most=10**6)
    replan_every: int = integer(1, least=1, most=1000)
    look_first: int = integer(LOOK_FIRST, least=1, most=1000)
    collision: str = choice(COLLISION_RULES, default="swept")
    ranks_flagged: Flag = False
    flags: Annotated[FlagsSpec, Field(description="a table [flags] with intimate_zone and jerk")]


class CardSpec(TomlTable):
    """The whole of `card.toml`: what the authors of an entry say of it.

    `method` names what the entry belongs to, so that several entries of one method can be compared with others as a
    method. `crowd_model` is the model of pedestrians inside the planner, such as "ORCA", or "none".
    `validation_runs` is how many trained or tuned variants were compared before this one was chosen.
    """

    title: Name
    authors: Names
    contact: Name
    method: Name
    licence: Name
    description: Name
    paper: Text = ""
    code: Text = ""
    training_data: Texts
    training_scenarios: Texts
    privileged_training: Flag
    crowd_model: Name
    validation_runs: int = integer(least=0, most=10**9)
    training_seeds: int = integer(least=0, most=10**9)
    ablation: Flag = False
