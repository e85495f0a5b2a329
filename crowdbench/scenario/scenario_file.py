"""Construct a scenario from a TOML table. An error message describes the first mistake in one sentence."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from crowdbench.core.dynamics import DISC, DYNAMICS, Bicycle, Body, Dynamics, Holonomic, Unicycle, chain
from crowdbench.core.types import Rules, WalkingLimits
from crowdbench.scenario.layouts import LAYOUTS
from crowdbench.scenario.layouts.crossings import crowdnav_plus
from crowdbench.scenario.placement import Layout, LayoutCall
from crowdbench.scenario.population import RECORDED, Crowd, Distribution
from crowdbench.scenario.scenario import Scenario
from crowdbench.scenario.schema import (
    SHOWN,
    SHOWN_IN,
    LayoutSpec,
    NamesSpec,
    PedestriansSpec,
    ScenarioSpec,
    VehicleSpec,
    further_keys,
    scenario_spec,
)
from crowdbench.scenario.starts import LayoutStarts, Vehicle
from crowdbench.sim.pedestrians import PedestrianPolicy, Recorded
from crowdbench.utils.errors import InputError
from crowdbench.utils.toml import Location, parse_table

if TYPE_CHECKING:
    from crowdbench.scenario.recorded import TrackedCrowd

MAX_STEPS = 100_000
MAX_DELAY = 1000
OF_TRACKS = ("number", "preferred_speed", "arrival", "goal_change", "groups", "clear_space")
"""Keys of `[pedestrians]` that recorded tracks replace."""


VERSION = 1
"""Increase it when a default or the meaning of a key changes, so that no earlier digest matches a scenario."""

LoadLayout = Callable[[str], tuple[str, Layout, str | None]]
"""Function from `layout.generator` to the layout's name, the layout, and the digest of its file, if any."""

LoadPolicy = Callable[[str], tuple[str, PedestrianPolicy, str | None]]
"""Function from `pedestrians.policy` to a policy's name, the policy, and the digest of its file, if any."""


def parse(
    table: Mapping[str, Any],
    name: str,
    source: str,
    load_layout: LoadLayout,
    load_policy: LoadPolicy,
    data: Path | None = None,
    read_tracks: bool = True,
) -> Scenario:
    """Construct a scenario from a table.

    Args:
        table: The table of a file, possibly with changes.
        name: Name of the scenario.
        source: Name of its file in error messages.
        load_layout: Loads the layout that the table names.
        load_policy: Loads the pedestrian policies that the table names.
        data: The folder with the recorded tracks, if the user gave one.
        read_tracks: False to compute only the digest, without the tracks; the table must contain their files' digests.

    Raises:
        InputError: A key is unknown, or a value has the wrong type or is impossible; the message contains the key.
    """
    file = Location(source)
    names = parse_table(NamesSpec, table, file)
    _refuse_limits_of_others(table.get("vehicle", {}), names.vehicle.dynamics, file.at("vehicle"))
    policies = _load_policies(names.pedestrians.policy, load_policy, file.at("pedestrians", "policy"))
    parameters = {policy: part.policy.parameters for policy, part in policies.items()}
    with file.at("layout", "generator").named():
        generator, layout, layout_file = load_layout(names.layout.generator)
        model = scenario_spec(layout, names.vehicle.dynamics, parameters)
    spec = parse_table(model, table, file)
    _check_combinations(spec, file)
    rules = _rules(spec, [*policies, RECORDED].index(RECORDED), file)
    tracks = _tracks(spec, table, rules, data, file, read_tracks)
    complete = spec.complete()
    complete["layout"] |= {"generator": generator} | ({"generator_file": layout_file} if layout_file else {})
    shares = {policy: part.share for policy, part in policies.items()}
    complete["pedestrians"]["policy"] = shares if len(shares) > 1 else next(iter(shares))
    if files := {policy: part.digest for policy, part in policies.items() if part.digest}:
        complete["pedestrians"]["policy_files"] = files
    if spec.tracks:
        complete |= {"layout": {}, "tracks": tracks.table if tracks else table["tracks"]}
        for key in OF_TRACKS:
            del complete["pedestrians"][key]
    else:
        del complete["tracks"]
    digest = _digest(complete, _known_defaults(spec, layout, policies), shares)
    if tracks and tracks.has_cars and RECORDED not in policies:
        policies[RECORDED] = _Policy(Recorded(), 0.0, None)  # which moves the other cars
    return Scenario(
        name=name,
        source=source,
        rules=rules,
        seed=spec.seed,
        vehicle=Vehicle(spec.vehicle.radius, spec.vehicle.preferred_speed),
        crowd=_crowd(spec.pedestrians, policies, shares, tracks),
        starts=tracks or _layout_starts(LayoutCall(layout, further_keys(spec.layout)), spec.crowdnav_cases),
        policies={policy: part.policy for policy, part in policies.items()},
        table=complete,
        digest=digest,
    )


def _crowd(
    spec: PedestriansSpec, policies: Mapping[str, _Policy], shares: Mapping[str, float], tracks: TrackedCrowd | None
) -> Crowd:
    """Return the pedestrians of a scenario."""
    parameters = {policy: further_keys(table) for policy, table in further_keys(spec).items()}
    return Crowd(
        number=tracks.number if tracks else spec.number,
        radius=spec.radius,
        preferred_speed=Distribution.model_validate(tracks.top_speed) if tracks else spec.preferred_speed,
        shares=shares,
        standing=[policy for policy, part in policies.items() if part.policy.stands],
        parameters={policy: parameters.get(policy, {}) for policy in policies},
        groups={int(size): share for size, share in (spec.groups or {}).items()},
        arrival=spec.arrival,
        goal_change=spec.goal_change,
        clear_space=spec.clear_space,
    )


def _known_defaults(spec: ScenarioSpec, layout: Layout, policies: Mapping[str, _Policy]) -> dict[str, Any]:
    """Return all keys of a scenario with their defaults.

    The options of a user's layout and the parameters of a user's policy are left out, because their defaults may
    change.
    """
    defaults = type(spec)().complete()
    # As in a complete table, which has only the name if all pedestrians follow the same policy.
    (defaults["pedestrians"]["policy"],) = defaults["pedestrians"]["policy"]
    if layout not in LAYOUTS.values():
        defaults["layout"] = LayoutSpec().complete()
    for name, part in policies.items():
        if part.digest is not None:
            defaults["pedestrians"].pop(name, None)
    # The defaults of optional tables apply only if the tables are given.
    for section, key in (("pedestrians", "goal_change"), ("pedestrians", "clear_space"), ("sensor", "lidar")):
        optional = getattr(getattr(spec, section), key)
        if optional is not None:
            fields = type(optional).model_fields.items()
            defaults[section][key] = {name: field.default for name, field in fields if not field.is_required()}
    return defaults


def _digest(complete: Mapping[str, Any], defaults: Mapping[str, Any], shares: Mapping[str, float]) -> str:
    """Return the digest of a scenario: twelve hexadecimal digits, equal for scenarios with the same cases.

    It covers the keys whose values differ from their defaults, and the digests of the files of layouts and policies.
    A new key whose default keeps the previous behaviour changes no digest.
    """
    changed = _changed({key: value for key, value in complete.items() if key != "description"}, defaults)
    if len(shares) > 1:
        changed["pedestrians"]["policy"] = {name: share / sum(shares.values()) for name, share in shares.items()}
    text = json.dumps({"version": VERSION, **changed}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def _changed(table: Mapping[str, Any], defaults: Mapping[str, Any]) -> dict[str, Any]:
    """Return the entries of a table that differ from its defaults, also within nested tables."""
    changed = {}
    for key, value in table.items():
        default = defaults.get(key)
        if isinstance(value, dict) and isinstance(default, dict):
            value, default = _changed(value, default), {}
        if key not in defaults or value != default:
            changed[key] = value
    return changed


def _check_combinations(top: ScenarioSpec, file: Location) -> None:
    """Raise InputError if keys of a scenario that are valid separately exclude each other."""
    # Computed without `max_steps`, which is infinite for a tiny dt.
    if top.time_limit - 1.0 > (MAX_STEPS - 1) * top.dt:
        right = f"large enough for an episode of time_limit to end within {MAX_STEPS} steps"
        raise file.at("dt").wrong(repr(top.dt), right)
    if top.seed and top.crowdnav_cases:
        raise InputError(
            f"{file.file}: seed is {top.seed}, which changes no test case below crowdnav_cases = {top.crowdnav_cases}, "
            "because these are drawn with CrowdNav's seeds: set crowdnav_cases = 0 too"
        )
    if top.crowdnav_cases and top.pedestrians.clear_space:
        right = "left out where crowdnav_cases is not 0: those cases start as in CrowdNav"
        raise file.at("pedestrians", "clear_space").wrong("given", right)


def _layout_starts(layout: LayoutCall, crowdnav_cases: int) -> LayoutStarts:
    """Return the starts of cases by a layout: the first test cases as in CrowdNav, or as in CrowdNav++ with its
    layout."""
    if not crowdnav_cases or layout.function is not crowdnav_plus:
        return LayoutStarts(layout, crowdnav_cases)
    from crowdbench.scenario.crowdnav_plus import CrowdNavPlusStarts

    return CrowdNavPlusStarts(layout, crowdnav_cases)


def _count_steps(seconds: float, dt: float, location: Location) -> int:
    """Return a duration in seconds as a number of steps. Raises InputError if it is no multiple of `dt`."""
    steps = round(seconds / dt)
    if not math.isclose(steps * dt, seconds):
        raise location.wrong(f"{seconds:g}", f"a multiple of dt, {dt:g} s")
    return steps


def _tracks(
    top: ScenarioSpec, table: Mapping[str, Any], rules: Rules, data: Path | None, file: Location, read_tracks: bool
) -> TrackedCrowd | None:
    """Return the recorded crowd of a scenario, if any.

    Raises InputError if a key is given that the tracks replace, if the policy `recorded` is used without tracks, or if
    the scene cannot be read.
    """
    if top.tracks is None:
        if RECORDED in top.pedestrians.policy:
            raise file.at("pedestrians", "policy").wrong(RECORDED, "another policy, or there must be a table [tracks]")
        return None
    # Imported here, because most scenarios do without.
    from crowdbench.scenario.recorded import TrackedCrowd
    from crowdbench.scenario.tracks.scenes import load_scene

    given: list[tuple[str, ...]] = [(key,) for key in ("layout", "crowdnav_cases") if table.get(key)]
    given += [("pedestrians", key) for key in OF_TRACKS if key in table.get("pedestrians", {})]
    if given:
        right = "left out where there is a table [tracks], which says who starts where, how fast, and to where"
        raise file.at(*given[0]).wrong("given", right)
    if not read_tracks:
        return None
    with file.at("tracks").named():
        crowd = TrackedCrowd.of(load_scene(top.tracks.scene, data, top.tracks.files), top.tracks.distance, rules)
    if crowd.has_cars and "distance" in table["tracks"]:
        raise file.at("tracks", "distance").wrong("given", "left out where cars say where the vehicle starts and goes")
    return crowd


def _refuse_limits_of_others(table: Mapping[str, Any], dynamics: str, location: Location) -> None:
    """Raise InputError if `[vehicle]` has a limit that only other dynamics have."""
    known = {name: {field.name for field in dataclasses.fields(kind)} for name, kind in DYNAMICS.items()}
    for key in table:
        owners = [f'"{name}"' for name, limits in known.items() if key in limits]
        if owners and key not in known[dynamics]:
            right = f"left out where dynamics is {dynamics}: only {' and '.join(owners)} has it"
            raise location.at(key).wrong("given", right)


def _rules(top: ScenarioSpec, recorded: int, file: Location) -> Rules:
    """Return the rules of a scenario, in which the policy of recorded pedestrians has the index `recorded`.

    Raises InputError if keys of its vehicle contradict each other or the crowd's, or if the sensor's delay is not a
    whole number of steps or exceeds `MAX_DELAY` steps.
    """
    vehicle, location, delay = top.vehicle, file.at("vehicle"), file.at("sensor", "delay")
    walking = top.pedestrians.limits
    period = file.at("pedestrians", "goal_change", "period")
    change = top.pedestrians.goal_change
    if change and not _count_steps(change.period, top.dt, period):
        raise period.wrong(f"{change.period:g}", f"a multiple of dt, {top.dt:g} s")
    if _count_steps(top.sensor.delay, top.dt, delay) > MAX_DELAY:
        raise delay.wrong(f"{top.sensor.delay:g}", f"{MAX_DELAY * top.dt:g} s or less, {MAX_DELAY} steps")
    attention = top.pedestrians.attention
    if attention is not None and attention.ignores + attention.yields_late + attention.attracted > 1.0:
        location = file.at("pedestrians", "attention")
        raise location.wrong("a table with reactions of more than everybody", "one whose shares add up to 1 at most")
    limits = {key: value for key, value in further_keys(vehicle).items() if value is not None}
    with location.named():
        dynamics = DYNAMICS[vehicle.dynamics](**limits)
    if isinstance(dynamics, Unicycle) and dynamics.max_angular_speed * top.dt > math.pi:
        right = f"{math.pi / top.dt:.6g} rad/s at most: the vehicle may turn by half a circle in a step"
        raise location.at("max_angular_speed").wrong(f"{dynamics.max_angular_speed:g}", right)
    sensor = top.sensor
    if sensor.nearest is None and top.pedestrians.number[1] > SHOWN_IN:
        sensor = sensor.model_copy(update={"nearest": SHOWN})
    return Rules(
        dt=top.dt,
        time_limit=top.time_limit,
        collision=top.collision,
        visible=vehicle.visible,
        attention=attention if vehicle.visible else None,
        dynamics=dynamics,
        goal_tolerance=vehicle.goal_tolerance,
        body=_body(vehicle, dynamics, location),
        sensor=sensor,
        walking=None if walking is None else WalkingLimits(**walking.complete(), exempt=recorded),
    )


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


class _Policy(NamedTuple):
    """A pedestrian policy of a crowd, the share of the pedestrians that follow it, and the digest of its file."""

    policy: PedestrianPolicy
    share: float
    digest: str | None


def _load_policies(shares: Mapping[str, float], load: LoadPolicy, location: Location) -> dict[str, _Policy]:
    """Return the policies, sorted by name, so that the policy of a pedestrian does not depend on the file's order."""
    policies: dict[str, _Policy] = {}
    for spec, share in shares.items():
        with location.named():
            name, policy, digest = load(spec)
        if name in policies or name in PedestriansSpec.model_fields:
            right = f"of policies that are not both called {name}, nor as another key here"
            raise location.wrong(", ".join(shares), right)
        policies[name] = _Policy(policy, share, digest)
    return dict(sorted(policies.items()))
