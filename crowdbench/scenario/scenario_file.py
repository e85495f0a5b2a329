"""Construct a scenario from a TOML table. An error message describes the first mistake in one sentence."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from crowdbench.core.dynamics import DISC, DYNAMICS, Actuation, Bicycle, Body, Dynamics, Holonomic, Unicycle, chain
from crowdbench.core.types import Rules, WalkingLimits
from crowdbench.core.types.attention import Attention
from crowdbench.scenario.layouts.crossings import crowdnav_plus
from crowdbench.scenario.placement import Layout, LayoutCall
from crowdbench.scenario.population import RECORDED, Distribution, Population, PopulationSpec
from crowdbench.scenario.scenario import Scenario
from crowdbench.scenario.schema import (
    DISTANCE,
    POPULATION,
    SHOWN,
    SHOWN_IN,
    LayoutScenarioSpec,
    NamesSpec,
    PedestriansSpec,
    PoliciesSpec,
    ScenarioSpec,
    SimulatedPedestriansSpec,
    Spec,
    TracksScenarioSpec,
    TracksSpec,
    VehicleSpec,
    additional_keys,
    scenario_spec,
)
from crowdbench.scenario.starts import LayoutStarts
from crowdbench.sim.pedestrians import PedestrianPolicy, Recorded
from crowdbench.utils.errors import InputError, require
from crowdbench.utils.toml import Location, parse_table

if TYPE_CHECKING:
    from crowdbench.scenario.recorded import TrackedCrowd

MAX_STEPS = 100_000
MAX_DELAY = 1000

LoadLayout = Callable[[str], tuple[str, Layout, str | None]]
"""Function from `layout.generator` to the layout's name, the layout, and the digest of its file, if any."""

OF_EVERYBODY = ("radius", "preferred_speed", "inertia")
"""Quantities with a spread that do not depend on the policy."""

LoadPolicy = Callable[[str], tuple[str, PedestrianPolicy, str | None]]
"""Function from `pedestrians.policy` to a policy's name, the policy, and the digest of its file, if any."""


def parse_scenario(
    table: Mapping[str, Any],
    name: str,
    source: str,
    load_layout: LoadLayout,
    load_policy: LoadPolicy,
    data: Path | None = None,
) -> Scenario:
    """Construct a scenario from a table.

    Args:
        table: The table of a file, possibly with changes, or the complete table of a run.
        name: Name of the scenario.
        source: Name of its file in error messages.
        load_layout: Loads the layout that the table names.
        load_policy: Loads the pedestrian policies that the table names.
        data: The folder with the recorded tracks, if the user gave one.

    Raises:
        InputError: A key is unknown, or a value has the wrong type or is impossible; the message contains the key.
    """
    file = Location(source)
    names = parse_table(NamesSpec, table, file)
    policies = _load_policies(names.pedestrians, load_policy, file.at("pedestrians"))
    parameters = {name: part.policy.parameters for name, part in policies.items()}
    populations = {
        name: _own_population(name, part.policy) for name, part in policies.items() if part.policy.population
    }
    if "tracks" in table:
        layout = None
        model = scenario_spec(names.vehicle.dynamics, parameters, populations)
    else:
        with file.at("layout", "generator").named():
            generator, layout, digest = load_layout(names.layout.generator)
            model = scenario_spec(names.vehicle.dynamics, parameters, populations, layout)
        _check_digest(names.layout.generator_file, digest, file.at("layout", "generator_file"))
    spec = parse_table(model, _with_attention(table, policies), file)
    # Names of plug-ins replace their files, whose digests are added.
    shares = {name: part.share for name, part in policies.items()}
    digests = {name: part.digest for name, part in policies.items() if part.digest is not None}
    spec = _with(spec, "pedestrians", policy=shares, policy_files=digests)
    variation = _variation(spec.pedestrians, policies, file.at("pedestrians"))
    intentions = tuple(variation.get(name, PopulationSpec()).intention for name in (*policies, RECORDED))
    rules = rules_of(spec, file)
    if any(intention.noise or intention.inertia for intention in intentions):
        rules = dataclasses.replace(rules, intentions=intentions)
    starts: LayoutStarts | TrackedCrowd
    if isinstance(spec, LayoutScenarioSpec):
        assert layout is not None
        spec = _with(spec, "layout", generator=generator, generator_file=digest)
        starts = _layout_starts(spec, layout, variation, file)
    else:
        assert isinstance(spec, TracksScenarioSpec)
        starts, files = _recorded_starts(spec.tracks, rules, data, file.at("tracks"))
        spec = _with(spec, "tracks", files=files)
        if starts.has_cars and RECORDED not in policies:
            policies[RECORDED] = _Policy(Recorded(), 0.0, None)  # moves the other cars
    return Scenario(
        name=name,
        source=source,
        table=spec.complete(),
        vehicle=_without_limits(spec.vehicle),
        rules=rules,
        crowd=_population(spec.pedestrians, policies, starts, variation),
        starts=starts,
        policies={name: part.policy for name, part in policies.items()},
    )


def _without_limits(vehicle: VehicleSpec) -> VehicleSpec:
    """Return `[vehicle]` without the keys of one dynamics: an object of a class that was made here has no pickle."""
    return VehicleSpec(**vehicle.model_dump(include=set(VehicleSpec.model_fields)))


def _with(spec: Spec, key: str, **values: object) -> Spec:
    """Return the model of a scenario with other values in one of its tables."""
    return spec.model_copy(update={key: getattr(spec, key).model_copy(update=values)})


def _layout_starts(
    spec: LayoutScenarioSpec, layout: Layout, variation: Mapping[str, PopulationSpec], file: Location
) -> LayoutStarts:
    """Return the starts of cases by a layout: the first test cases as in CrowdNav, or as in CrowdNav++ with its
    layout."""
    pedestrians, cases = file.at("pedestrians"), spec.crowdnav_cases
    if RECORDED in spec.pedestrians.policy:
        right = "another policy, or there must be a table [tracks]"
        raise pedestrians.at("policy").wrong(RECORDED, right)
    if spec.seed and cases:
        raise InputError(
            f"{file.file}: seed is {spec.seed}, which changes no test case below crowdnav_cases = {cases}, because "
            "these are drawn with CrowdNav's seeds: set crowdnav_cases = 0 too"
        )
    if cases and spec.pedestrians.clear_space:
        right = "left out where crowdnav_cases is not 0: those cases start as in CrowdNav"
        raise pedestrians.at("clear_space").wrong("given", right)
    if cases and layout is crowdnav_plus and variation:
        right = "left out where crowdnav_cases is not 0: those cases start as in CrowdNav++"
        raise pedestrians.at("population").wrong("given", right)
    call = LayoutCall(layout, **additional_keys(spec.layout))
    if not cases or layout is not crowdnav_plus:
        return LayoutStarts(call, cases)
    from crowdbench.scenario.crowdnav_plus import CrowdNavPlusStarts

    return CrowdNavPlusStarts(call, cases)


def _recorded_starts(
    tracks: TracksSpec, rules: Rules, data: Path | None, location: Location
) -> tuple[TrackedCrowd, dict[str, str]]:
    """Return the recorded crowd of a scenario, and the digests of the files with its tracks."""
    # Imported here, because most scenarios do without.
    from crowdbench.scenario.recorded import TrackedCrowd
    from crowdbench.scenario.tracks.scenes import load_scene

    with location.named():
        recordings, files = load_scene(tracks, data)
        crowd = TrackedCrowd.of(tracks.scene, recordings, tracks.distance, rules)
    if crowd.has_cars and tracks.distance != DISTANCE:
        right = "left out where cars say where the vehicle starts and goes"
        raise location.at("distance").wrong(f"{tracks.distance:g}", right)
    return crowd, files


def _own_population(name: str, policy: PedestrianPolicy) -> PopulationSpec:
    """Return the population that a policy brings. Raises InputError if it is invalid."""
    population = policy.population
    require(f"population of pedestrian policy {name}", population, isinstance(population, Mapping), "a table")
    return parse_table(PopulationSpec, population, Location(f"pedestrian policy {name}", POPULATION))


def _with_attention(table: Mapping[str, Any], policies: Mapping[str, _Policy]) -> Mapping[str, Any]:
    """Return the table of a scenario with the attention that its policies bring; keys of the scenario replace it.

    Raises InputError if an attention is invalid, or if policies bring different ones.
    """
    tables = {name: part.policy.attention for name, part in policies.items() if part.policy.attention}
    pedestrians = table.get("pedestrians", {})
    own = pedestrians.get("attention", {})
    if not tables or not isinstance(own, Mapping):
        return table
    for name, brought in tables.items():
        require(f"attention of pedestrian policy {name}", brought, isinstance(brought, Mapping), "a table")
        parse_table(Attention, brought, Location(f"pedestrian policy {name}", "attention"))
        if brought != next(iter(tables.values())):
            raise InputError(f"pedestrian policies {', '.join(tables)} have different attention: use one of them")
    return {**table, "pedestrians": {**pedestrians, "attention": {**brought, **own}}}


def _variation(spec: PedestriansSpec, policies: Mapping[str, _Policy], location: Location) -> dict[str, PopulationSpec]:
    """Return, by policy, the population of its pedestrians: the policy's own, or `[pedestrians.population]`.

    Raises InputError if a quantity with a spread belongs to no policy that has this population.
    """
    variation, common, known = {}, spec.population, set(OF_EVERYBODY)
    for name, table in additional_keys(spec).items():
        part, parameters = policies[name].policy, additional_keys(table)
        own = parameters.pop(POPULATION, None)
        if part.stands or name == RECORDED:
            continue
        varied = {key for key in parameters if not isinstance(part.parameters[key], int)}
        if own is not None:
            _check_spread(own, {*OF_EVERYBODY, *varied}, location.at(name, POPULATION))
        known |= varied if own is None else set()
        if (population := own or common) is not None:
            variation[name] = population
    if common is not None:
        _check_spread(common, known, location.at(POPULATION))
    return variation


def _check_spread(population: PopulationSpec, known: set[str], location: Location) -> None:
    """Raise InputError if a quantity with a spread is not known."""
    for name in population.spread:
        if name not in known:
            raise location.at("spread").wrong(f"a table with {name}", f"of {', '.join(sorted(known))}")


def _population(
    spec: PedestriansSpec,
    policies: Mapping[str, _Policy],
    starts: LayoutStarts | TrackedCrowd,
    variation: Mapping[str, PopulationSpec],
) -> Population:
    """Return the pedestrians of a scenario."""
    parameters = {name: additional_keys(values) for name, values in additional_keys(spec).items()}
    for table in parameters.values():
        table.pop(POPULATION, None)
    common: dict[str, Any] = {
        "radius": spec.radius,
        "shares": spec.policy,
        "standing": [name for name, part in policies.items() if part.policy.stands],
        "parameters": {name: parameters.get(name, {}) for name in policies},
        "variation": variation,
    }
    if isinstance(spec, SimulatedPedestriansSpec):
        return Population(
            **common,
            number=spec.number,
            preferred_speed=spec.preferred_speed,
            groups={int(size): share for size, share in sorted((spec.groups or {}).items())},
            arrival=spec.arrival,
            goal_change=spec.goal_change,
            clear_space=spec.clear_space,
        )
    assert not isinstance(starts, LayoutStarts)
    speed = Distribution.model_validate(starts.top_speed)
    return Population(**common, number=starts.number, preferred_speed=speed)


def rules_of(spec: ScenarioSpec, file: Location) -> Rules:
    """Return the rules of a scenario.

    Raises InputError if an episode may take too many steps, if keys of the vehicle contradict each other or keys of
    the crowd, or if a delay is not a whole number of steps or exceeds `MAX_DELAY` steps.
    """
    # Computed without `max_steps`, which is infinite for a tiny dt.
    if spec.time_limit - 1.0 > (MAX_STEPS - 1) * spec.dt:
        right = f"large enough for an episode of time_limit to end within {MAX_STEPS} steps"
        raise file.at("dt").wrong(repr(spec.dt), right)
    pedestrians, vehicle, walking = spec.pedestrians, spec.vehicle, spec.pedestrians.limits
    location = file.at("vehicle")
    actuation = Actuation(vehicle.command_delay or 0.0, vehicle.lag or 0.0)
    _check_delay(spec.sensor.delay, spec.dt, file.at("sensor", "delay"))
    _check_delay(actuation.delay, spec.dt, location.at("command_delay"))
    sensor = spec.sensor
    if isinstance(pedestrians, SimulatedPedestriansSpec):
        change, period = pedestrians.goal_change, file.at("pedestrians", "goal_change", "period")
        if change is not None and not _count_steps(change.period, spec.dt, period):
            raise period.wrong(f"{change.period:g}", f"a multiple of dt, {spec.dt:g} s")
        if sensor.nearest is None and pedestrians.number[1] > SHOWN_IN:
            sensor = sensor.model_copy(update={"nearest": SHOWN})
    attention = pedestrians.attention
    if attention is not None and attention.ignores + attention.yields_late + attention.attracted > 1.0:
        wrong, right = "a table of shares that sum to more than 1", "one whose shares sum to 1 at most"
        raise file.at("pedestrians", "attention").wrong(wrong, right)
    limits = {key: value for key, value in additional_keys(vehicle).items() if value is not None}
    with location.named():
        dynamics = DYNAMICS[vehicle.dynamics](**limits)
    if isinstance(dynamics, Unicycle) and dynamics.max_angular_speed * spec.dt > math.pi:
        right = f"{math.pi / spec.dt:.6g} rad/s at most: the vehicle may turn by half a circle in a step"
        raise location.at("max_angular_speed").wrong(f"{dynamics.max_angular_speed:g}", right)
    _check_fleet(spec, location.at("number"))
    recorded = [*pedestrians.policy, RECORDED].index(RECORDED)
    return Rules(
        dt=spec.dt,
        time_limit=spec.time_limit,
        time_limit_factor=spec.time_limit_factor,
        collision=spec.collision,
        collision_ends=spec.collision_ends,
        visible=vehicle.visible,
        attention=attention if vehicle.visible else None,
        dynamics=dynamics,
        actuation=actuation,
        goal_tolerance=vehicle.goal_tolerance,
        body=_body(vehicle, dynamics, location),
        sensor=sensor,
        walking=None if walking is None else WalkingLimits(**walking.complete(), exempt=recorded),
        vehicles=vehicle.number or 1,
    )


def _check_fleet(spec: ScenarioSpec, location: Location) -> None:
    """Raise InputError if there are several vehicles beside a key that is defined for one vehicle only."""
    given = spec.complete()
    wrong = {
        "collision": spec.collision != "swept",
        "vehicle.length": spec.vehicle.length is not None,
        **{name: bool(given.get(name)) for name in ("tracks", "crowdnav_cases")},
        **{f"pedestrians.{name}": bool(given["pedestrians"].get(name)) for name in ("attention", "groups")},
    }
    for key in wrong if (spec.vehicle.number or 1) > 1 else ():
        if wrong[key]:
            raise location.wrong(str(spec.vehicle.number), f"1 with this {key}")


def _body(vehicle: VehicleSpec, dynamics: Dynamics, location: Location) -> Body:
    """Return the body of a vehicle. Its rear axle and its front axle are equally far from its middle."""
    if vehicle.length is None:
        return DISC
    length, wheelbase = location.at("length"), dynamics.wheelbase if isinstance(dynamics, Bicycle) else 0.0
    if isinstance(dynamics, Holonomic):
        raise length.wrong(f"{vehicle.length:g}", 'left out where dynamics = "holonomic": such a vehicle is a disc')
    if vehicle.length < 2.0 * vehicle.radius:
        raise length.wrong(f"{vehicle.length:g}", f"{2.0 * vehicle.radius:g} or more, twice the radius")
    if vehicle.length < wheelbase:
        raise length.wrong(f"{vehicle.length:g}", f"{wheelbase:g} or more, the wheelbase")
    return chain(vehicle.length, vehicle.radius, wheelbase / 2.0)


def _check_delay(seconds: float, dt: float, location: Location) -> None:
    """Raise InputError if a delay is not a whole number of steps of `dt` seconds, or exceeds `MAX_DELAY` of them."""
    if _count_steps(seconds, dt, location) > MAX_DELAY:
        raise location.wrong(f"{seconds:g}", f"{MAX_DELAY * dt:g} s or less, {MAX_DELAY} steps")


def _count_steps(seconds: float, dt: float, location: Location) -> int:
    """Return a duration in seconds as a number of steps. Raises InputError if it is no multiple of `dt`."""
    steps = round(seconds / dt)
    if not math.isclose(steps * dt, seconds):
        raise location.wrong(f"{seconds:g}", f"a multiple of dt, {dt:g} s")
    return steps


class _Policy(NamedTuple):
    """A pedestrian policy of a crowd, the share of the pedestrians that follow it, and the digest of its file."""

    policy: PedestrianPolicy
    share: float
    digest: str | None


def _load_policies(names: PoliciesSpec, load: LoadPolicy, location: Location) -> dict[str, _Policy]:
    """Return the policies, sorted by name, so that the policy of a pedestrian does not depend on the file's order."""
    policies: dict[str, _Policy] = {}
    at_policy = location.at("policy")
    for spec, share in names.policy.items():
        with at_policy.named():
            name, policy, digest = load(spec)
        if name in policies or name in SimulatedPedestriansSpec.model_fields:
            right = f"of policies that are not both called {name}, nor as another key here"
            raise at_policy.wrong(", ".join(names.policy), right)
        _check_digest(names.policy_files.get(name), digest, location.at("policy_files", name))
        policies[name] = _Policy(policy, share, digest)
    return dict(sorted(policies.items()))


def _check_digest(stated: str | None, digest: str | None, location: Location) -> None:
    """Raise InputError if the digest of a file is not the stated one."""
    if stated is not None and stated != digest:
        raise location.wrong(stated, f"the digest of the file that is given, {digest}")
