"""The content of a scenario's TOML file: its tables, their keys, and the default of each key.

The options of a layout are the keyword-only parameters of its function, the options of a pedestrian policy its
`parameters`. The tables that contain them are created for the layout and the policies of a scenario.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from typing import Annotated, Any, Literal, TypeVar

from pydantic import AfterValidator, BeforeValidator, Field, JsonValue, create_model

from crowdbench.core.dynamics import DYNAMICS
from crowdbench.core.types import COLLISION_RULES, Sensor
from crowdbench.core.types.attention import Attention
from crowdbench.core.types.rules import MAX_PEDESTRIANS, MAX_VEHICLES
from crowdbench.plugins.options import PLAIN, REQUIRED, Option, read_options
from crowdbench.scenario.clear_space import ClearSpace
from crowdbench.scenario.layouts import LAYOUTS
from crowdbench.scenario.placement import Layout
from crowdbench.scenario.population import (
    ARRIVALS,
    Distribution,
    GoalChange,
    PopulationSpec,
    WalkingLimitsSpec,
    WholeDistribution,
)
from crowdbench.utils.errors import InputError, is_integer
from crowdbench.utils.toml import Flag, Name, Text, TomlTable, choice, integer, number, table

Spec = TypeVar("Spec", bound=TomlTable)

SHOWN, SHOWN_IN = 20, 100
"""Planners observe the nearest 20 pedestrians in scenarios with more than 100, and all pedestrians in others."""

MIN_SIZE = 1e-3
"""Lower bound of pedestrians' radii in metres and of their preferred speeds in m/s."""

POPULATION = "population"
"""The key of the population of a policy in the table of its parameters."""

DISTANCE = 8.0
"""Default distance in metres from the vehicle's start to its goal among recorded pedestrians."""


class Size(Distribution):
    """A quantity that must not be 0."""

    low: float = Field(ge=MIN_SIZE)


def quantity(default: float, least: float = 0.0, noun: str = "a number") -> Any:
    """Return the field of a `Distribution` with its default and the smallest allowed value."""
    return Field(
        default=default,
        validate_default=True,
        description=f"{noun} of at least {least:g}, or a Gaussian {{ mean = 1.0, std = 0.2, low = 0.6, high = 1.4 }} "
        f"with {least:g} <= low <= mean <= high and bounds that are not narrower than a tenth of std, or a uniform "
        f"distribution {{ low = 0.6, high = 1.4 }} with {least:g} <= low <= high",
    )


def table_like(example: str) -> Any:
    """Return the field of a table that may be left out, with an example in TOML."""
    return Field(default=None, description=f"a table with the keys of {example}")


def _as_pair(value: Any) -> Any:
    return (value, value) if is_integer(value) else tuple(value) if isinstance(value, list) else value


def _ordered(pair: tuple[int, int]) -> tuple[int, int]:
    if pair[0] > pair[1]:
        raise ValueError
    return pair


def _as_shares(value: Any) -> Any:
    return {value: 1.0} if isinstance(value, str) else value


def _defaults_of(spec: TomlTable) -> Callable[[Any], Any]:
    """Return a function that adds the values of a table to another table, for its missing keys."""
    return lambda value: {**spec.complete(), **value} if isinstance(value, dict) else value


GroupSize = Literal["1", "2", "3", "4", "5"]
"""Numbers of pedestrians in a group, as keys of a table."""


class LayoutSpec(TomlTable, extra="allow"):
    """`[layout]`, whose further keys are the options of the layout; see `layout_spec`.

    Attributes:
        generator: The name of the layout, or a file with it.
        generator_file: The digest of that file; None for built-in and installed layouts.
    """

    generator: Name = "circle_crossing"
    generator_file: str | None = Field(default=None, description="the digest of the layout's file")


class DynamicsSpec(TomlTable, extra="allow"):
    """The key of `[vehicle]` that determines its other allowed keys; see `scenario_spec`."""

    dynamics: str = choice(DYNAMICS, default="holonomic")


class PoliciesSpec(TomlTable, extra="allow"):
    """The keys of `[pedestrians]` that name the policies, with the share of the pedestrians that follow each, and the
    digests of the policies' files by name."""

    policy: Annotated[
        dict[str, Annotated[float, Field(gt=0, lt=1e9)]], Field(min_length=1), BeforeValidator(_as_shares)
    ] = Field(
        default={"orca": 1.0},
        description="the name of a policy, or shares of several such as { orca = 0.7, social_force = 0.3 }",
    )
    policy_files: dict[str, str] = Field(default={}, description="a table of policies with the digest of each file")


class NamesSpec(TomlTable, extra="allow"):
    """The names in a scenario's file that determine its other allowed keys; see `scenario_spec`."""

    layout: LayoutSpec = table("layout")
    vehicle: DynamicsSpec = table("vehicle")
    pedestrians: PoliciesSpec = table("pedestrians")


class VehicleSpec(DynamicsSpec):
    """`[vehicle]`, to which `scenario_spec` adds the limits of the dynamics.

    Radius, length and goal tolerance are in metres, the preferred speed in m/s. Without a length the vehicle is a disc.
    Without a goal tolerance it has arrived when its goal is nearer than its radius. `command_delay` and `lag` are in
    seconds, see `crowdbench.core.dynamics.Actuation`. `number` is the number of vehicles,
    None for 1, see `crowdbench.sim.fleet`.
    """

    visible: Flag = False
    radius: float = number(0.3, above=0.0, below=100.0)
    preferred_speed: float = number(1.0, above=0.0, below=100.0)
    length: float | None = number(None, above=0.0, below=100.0)
    goal_tolerance: float | None = number(None, above=0.0, below=100.0)
    # None changes no digest of a scenario.
    command_delay: float | None = number(None, above=0.0, below=1e3)
    lag: float | None = number(None, above=0.0, below=1e3)
    number: Annotated[int | None, AfterValidator(lambda n: n if n != 1 else None)] = integer(
        None, least=1, most=MAX_VEHICLES
    )


class PedestriansSpec(PoliciesSpec):
    """`[pedestrians]`, with an additional table for each policy; see `scenario_spec`."""

    radius: Size = quantity(0.3, MIN_SIZE)
    attention: Attention | None = table_like("{ ignores = 0.1, delay = 0.4 }")
    limits: WalkingLimitsSpec | None = table_like("{ acceleration = 1.5, braking = 3.0, sideways = 2.0 }")
    # Absent from the dump without a population, so that it does not change the identity of other scenarios.
    population: PopulationSpec | None = Field(
        default=None, exclude_if=lambda value: value is None, description="a table [pedestrians.population]"
    )


class SimulatedPedestriansSpec(PedestriansSpec):
    """`[pedestrians]` without recorded tracks. `number` is the smallest and the largest number of pedestrians."""

    number: Annotated[
        tuple[Annotated[int, Field(ge=0)], Annotated[int, Field(le=MAX_PEDESTRIANS)]],
        BeforeValidator(_as_pair),
        AfterValidator(_ordered),
    ] = Field(
        default=(5, 5),
        description=f"a whole number from 0 to {MAX_PEDESTRIANS}, or a pair of them, [least, most]",
    )
    preferred_speed: Size = quantity(1.0, MIN_SIZE)
    groups: Annotated[dict[GroupSize, Annotated[float, Field(gt=0, lt=1e9)]], Field(min_length=1)] | None = Field(
        default=None,
        description="the shares of groups by their size, from 1 to 5, such as { 1 = 0.4, 2 = 0.4, 3 = 0.2 }",
    )
    arrival: str = choice(ARRIVALS, default="walk_on")
    goal_change: GoalChange | None = table_like("{ period = 5.0, chance = 0.5 }")
    clear_space: ClearSpace | None = table_like("{ distance = 1.5, time = 1.5 }")


class TracksSpec(TomlTable):
    """`[tracks]`: recorded pedestrians of a scene, instead of a layout. Lengths are in metres.

    Attributes:
        format: A name in `FORMATS` of `crowdbench.scenario.tracks.formats`; None for ETH/UCY and DUT.
        scale: Metres of a unit of the file, such as a pixel.
        frame_rate: Frames per second, or units of the time column per second.
        distance: From the vehicle's start to its goal; not used if cars are recorded.
        files: The sha256 of the user's files; the digests of ETH/UCY and DUT are built in.
    """

    # None changes no digest of a scenario.
    scene: Name
    format: Name | None = None
    scale: float | None = number(None, above=0.0, below=1e4)
    frame_rate: float | None = number(None, above=0.0, below=1e10)
    distance: float = number(DISTANCE, above=0.0, below=1000.0)
    files: dict[str, str] = Field(default={}, description="a table of file names with the sha256 of each")


class ScenarioSpec(TomlTable):
    """The file of a scenario: the keys that all scenarios have. `dt` and `time_limit` are in seconds.

    With a `time_limit_factor`, the limit of a case is this multiple of its least time, see
    `crowdbench.sim.least_time`, and `time_limit` is the largest limit of any case.
    """

    description: Text = ""
    dt: float = number(0.25, above=0.0, below=1.0)
    time_limit: float = number(25.0, above=1.0, below=1e6)
    # Absent from the dump without a factor, so that it does not change the identity of other scenarios.
    time_limit_factor: float | None = Field(
        default=None,
        gt=0,
        lt=1e3,
        exclude_if=lambda value: value is None,
        description="a number above 0 and below 1000",
    )
    collision: str = choice(COLLISION_RULES, default="swept")
    # Absent from the dump where collisions end episodes, so that it does not change the identity of other scenarios.
    collision_ends: Flag = Field(default=True, exclude_if=bool, description="true or false")
    seed: int = integer(0, least=0, most=2**63 - 1)
    vehicle: VehicleSpec = table("vehicle")
    sensor: Sensor = table("sensor")
    pedestrians: PedestriansSpec = table("pedestrians")


class LayoutScenarioSpec(ScenarioSpec):
    """The file of a scenario whose agents are placed by a layout."""

    crowdnav_cases: int = integer(0, least=0, most=500)
    layout: LayoutSpec = table("layout")
    pedestrians: SimulatedPedestriansSpec = table("pedestrians")


class TracksScenarioSpec(ScenarioSpec):
    """The file of a scenario with recorded pedestrians."""

    tracks: TracksSpec


def scenario_spec(
    dynamics: str,
    parameters: Mapping[str, Mapping[str, float]],
    populations: Mapping[str, PopulationSpec],
    layout: Layout | None = None,
) -> type[ScenarioSpec]:
    """Return the pydantic model of a complete file.

    A limit of the vehicle that is infinite or 0 by default is None in the model.

    Args:
        dynamics: The vehicle's dynamics.
        parameters: By pedestrian policy, the defaults of its parameters.
        populations: By pedestrian policy, the default of its population; others have none.
        layout: The layout that the file names; None with recorded tracks.

    Raises:
        InputError: See `layout_spec`.
    """
    usual = {field.name: field.default for field in dataclasses.fields(DYNAMICS[dynamics])}
    limits = {
        name: (float | None, number(None if limit in (0.0, math.inf) else limit, above=0.0, below=1e6))
        for name, limit in usual.items()
    }
    policies = {}
    for name, defaults in parameters.items():
        quantities: dict[str, tuple[Any, Any]] = {
            key: (WholeDistribution, quantity(default, noun="a whole number"))
            if isinstance(default, int)
            else (Distribution, quantity(default))
            for key, default in defaults.items()
        }
        if name in populations:
            right = f"a table [pedestrians.{name}.{POPULATION}]"
            kind = Annotated[PopulationSpec, BeforeValidator(_defaults_of(populations[name]))]
            quantities[POPULATION] = kind, Field(default=populations[name], description=right)
        policies[name] = _extended(TomlTable, quantities), table(f"pedestrians.{name}")
    tables: dict[str, Any] = {"vehicle": _extended(VehicleSpec, limits)}
    base: type[ScenarioSpec] = TracksScenarioSpec
    if layout is None:
        tables["pedestrians"] = _extended(PedestriansSpec, policies)
    else:
        base = LayoutScenarioSpec
        tables["pedestrians"] = _extended(SimulatedPedestriansSpec, policies)
        tables["layout"] = layout_spec(layout)
    fields: dict[str, Any] = {name: (model, table(name)) for name, model in tables.items()}
    return create_model(base.__name__, __base__=base, **fields)


def layout_spec(layout: Layout) -> type[LayoutSpec]:
    """Return `[layout]` with the options of one layout: its keyword-only parameters, of the types of their defaults.

    Args:
        layout: The layout. Options of a built-in layout whose default is a float are lengths, and must not be negative.

    Raises:
        InputError: An option has no default, a default of a type that TOML lacks, or the name of another key.
    """
    options = {}
    for option in read_options(layout):
        if not option.keyword_only:
            continue
        if option.name in LayoutSpec.model_fields:
            raise InputError(f"no option of a layout can be called {option.name}, as a key of [layout] is")
        options[option.name] = _option(option, layout in LAYOUTS.values())
    return _extended(LayoutSpec, options)


def _option(option: Option, is_length: bool) -> tuple[Any, Any]:
    """Return the type and the field of an option, derived from its default."""
    default = option.default
    if isinstance(default, float) and is_length:
        return float, number(default, least=0.0, below=1e6)
    for kind, (type_, right) in _OPTIONS.items():
        if isinstance(default, kind):
            return type_, Field(default=default, description=right)
    actual = "no default" if default is REQUIRED else f"the default {default!r}"
    raise InputError(
        f"the option {option.name} has {actual}, but must have one that is true or false, a number, a text, a list or "
        "a table"
    )


_OPTIONS: Mapping[type, tuple[Any, str]] = {kind: (kind, right) for kind, (_, right) in PLAIN.items()} | {
    list: (list[JsonValue], "a list"),
    dict: (dict[str, JsonValue], "a table"),
}
"""Allowed values of a layout's option, by the type of its default: their type, and its name in error messages."""


def _extended(base: type[Spec], fields: Mapping[str, tuple[Any, Any]]) -> type[Spec]:
    """Return the model of a table with additional keys, given as types and fields. Other keys are refused."""
    # Keys are aliases, because as names of attributes some would collide with attributes of pydantic.
    keys: dict[str, Any] = {
        f"key_{i}": (Annotated[kind, Field(alias=key)], field) for i, (key, (kind, field)) in enumerate(fields.items())
    }
    return create_model(base.__name__, __base__=base, __cls_kwargs__={"extra": "forbid"}, **keys)


def additional_keys(spec: TomlTable) -> dict[str, Any]:
    """Return the values of the keys that `scenario_spec` or `layout_spec` has added to a table."""
    fields = type(spec).model_fields.items()
    return {field.alias: getattr(spec, name) for name, field in fields if field.alias is not None}
