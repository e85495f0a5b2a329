"""Reads a scenario from a TOML table and says in one sentence what is wrong with it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from crowdbench.core.dynamics import DISC, DYNAMICS, Bicycle, Body, Dynamics, Holonomic, Unicycle, chain
from crowdbench.core.types import Rules, Sensor
from crowdbench.scenario.certified import CertificateStatus, Certified
from crowdbench.scenario.clear_space import ClearSpace
from crowdbench.scenario.layouts.crossings import crowdnav_plus
from crowdbench.scenario.placement import Layout, LayoutCall
from crowdbench.scenario.population import RECORDED, Crowd, GoalChange, Quantity
from crowdbench.scenario.scenario import Scenario
from crowdbench.scenario.schema import (
    SHOWN,
    SHOWN_IN,
    GoalChangeSpec,
    PedestriansSpec,
    ScenarioSpec,
    VehicleSpec,
    layout_spec,
    pedestrians_spec,
    vehicle_spec,
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
"""Keys of `[pedestrians]` that recorded tracks stand for."""


class Loaders(NamedTuple):
    """What finds the plug-ins and the recordings that a scenario names.

    Attributes:
        layout: Turns what a table says of a layout into its name, the layout, and the digest of its file, if any.
        policy: The same for a pedestrian policy.
        data: The folder with the recorded tracks; None where nobody has said it.
    """

    layout: Callable[[str], tuple[str, Layout, str | None]]
    policy: Callable[[str], tuple[str, PedestrianPolicy, str | None]]
    data: Path | None = None


def parse(table: Mapping[str, Any], name: str, source: str, load: Loaders) -> Scenario:
    """Make a scenario from a table.

    Args:
        table: As read from a file, perhaps with changes.
        name: What the scenario is called.
        source: What its file is called, for errors.
        load: Finds what the table names.

    Raises:
        InputError: A key is unknown, or a value is of the wrong type or impossible; `source` and the key are named.
    """
    file = Location(source)
    top = parse_table(ScenarioSpec, table, file)
    _refuse_limits_of_others(table.get("vehicle", {}), top.vehicle.dynamics, file.at("vehicle"))
    vehicle = parse_table(vehicle_spec(top.vehicle.dynamics), table.get("vehicle", {}), file.at("vehicle"))
    _check_combinations(top, file)
    rules = _rules(top, vehicle, file)
    with file.at("layout", "generator").named():
        generator, layout, layout_file = load.layout(top.layout.generator)
        options_of_layout = layout_spec(layout)
    layout_table = {**table.get("layout", {}), "generator": generator}
    options = parse_table(options_of_layout, layout_table, file.at("layout")).complete()
    policies = _policies(top.pedestrians.policy, load, file.at("pedestrians", "policy"))
    tracks = _tracks(top, table, rules, load.data, file)
    if tracks and tracks.has_cars and RECORDED not in policies:
        policies[RECORDED] = _Policy(Recorded(), 0.0, None)  # which moves the other cars
    kind = pedestrians_spec({policy: each.policy.parameters for policy, each in policies.items()})
    pedestrians = parse_table(kind, table.get("pedestrians", {}), file.at("pedestrians")).complete()
    space = top.pedestrians.clear_space
    call = LayoutCall(layout, {option: value for option, value in options.items() if option != "generator"})
    complete = {**top.complete(), "layout": options, "vehicle": vehicle.complete()}
    complete["pedestrians"] = pedestrians | _write_policies(policies)
    if layout_file:
        options["generator_file"] = layout_file
    if tracks:
        complete |= {"layout": {}, "tracks": tracks.table}
        for key in OF_TRACKS:
            del complete["pedestrians"][key]
    else:
        del complete["tracks"]
    return Scenario(
        name=name,
        source=source,
        rules=rules,
        seed=top.seed,
        vehicle=Vehicle(vehicle.radius, vehicle.preferred_speed),
        crowd=Crowd(
            number=tracks.number if tracks else top.pedestrians.number,
            radius=Quantity(**pedestrians["radius"]),
            preferred_speed=Quantity(tracks.top_speed) if tracks else Quantity(**pedestrians["preferred_speed"]),
            shares={policy: each.share for policy, each in policies.items() if each.share},
            standing=[policy for policy, each in policies.items() if each.policy.stands],
            parameters={policy: _parameters(each.policy, pedestrians[policy]) for policy, each in policies.items()},
            groups={int(size): share for size, share in (top.pedestrians.groups or {}).items()},
            arrival=top.pedestrians.arrival,
            goal_change=_goal_change(top.pedestrians.goal_change, top.dt, file.at("pedestrians", "goal_change")),
            clear_space=ClearSpace(space.distance, space.time) if space else None,
        ),
        starts=tracks or _layout_starts(call, top.crowdnav_cases),
        policies={policy: each.policy for policy, each in policies.items()},
        table=complete,
    )


def _check_combinations(top: ScenarioSpec, file: Location) -> None:
    """Raise InputError where keys of a scenario exclude each other, each of which is possible alone."""
    # Not by `max_steps`, which a tiny dt makes infinite.
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
    """How cases start by a layout: the first test cases as in CrowdNav, or as in CrowdNav++ with the layout of it."""
    if not crowdnav_cases or layout.function is not crowdnav_plus:
        return LayoutStarts(layout, crowdnav_cases)
    from crowdbench.scenario.crowdnav_plus import CrowdNavPlusStarts

    return CrowdNavPlusStarts(layout, crowdnav_cases)


def _parameters(policy: PedestrianPolicy, table: Mapping[str, Any]) -> dict[str, Quantity]:
    """The parameters of a policy, by its complete table."""
    return {
        parameter: Quantity(**table[parameter], whole=isinstance(default, int))
        for parameter, default in policy.parameters.items()
    }


def _goal_change(spec: GoalChangeSpec | None, dt: float, location: Location) -> GoalChange | None:
    """How goals change on the way. Raises InputError where the period is no multiple of `dt`."""
    if spec is None:
        return None
    every = _count_steps(spec.period, dt, location.at("period"))
    if not every:
        raise location.at("period").wrong(f"{spec.period:g}", f"a multiple of dt, {dt:g} s")
    return GoalChange(every, spec.chance)


def _count_steps(seconds: float, dt: float, location: Location) -> int:
    """Return how many steps take so many seconds. Raises InputError where these are no multiple of `dt`."""
    steps = round(seconds / dt)
    if not math.isclose(steps * dt, seconds):
        raise location.wrong(f"{seconds:g}", f"a multiple of dt, {dt:g} s")
    return steps


def _tracks(
    top: ScenarioSpec, table: Mapping[str, Any], rules: Rules, data: Path | None, file: Location
) -> TrackedCrowd | None:
    """The recorded people of a scenario, if any.

    Raises InputError where a key says what the tracks say too, the policy of recorded people has none, or the scene
    cannot be read.
    """
    if top.tracks is None:
        if RECORDED in top.pedestrians.policy:
            raise file.at("pedestrians", "policy").wrong(RECORDED, "another policy, or there must be a table [tracks]")
        return None
    # Imported here, because most scenarios do without.
    from crowdbench.scenario.recorded import TrackedCrowd
    from crowdbench.scenario.tracks.scenes import load_scene

    own: list[tuple[str, ...]] = [(key,) for key in ("layout", "crowdnav_cases") if table.get(key)]
    own += [("pedestrians", key) for key in OF_TRACKS if key in table.get("pedestrians", {})]
    if own:
        right = "left out where there is a table [tracks], which says who starts where, how fast, and to where"
        raise file.at(*own[0]).wrong("given", right)
    with file.at("tracks").named():
        crowd = TrackedCrowd.of(load_scene(top.tracks.scene, data, top.tracks.files), top.tracks.distance, rules)
    if crowd.has_cars and "distance" in table["tracks"]:
        raise file.at("tracks", "distance").wrong("given", "left out where cars say where the vehicle starts and goes")
    return crowd


def _refuse_limits_of_others(table: Mapping[str, Any], dynamics: str, location: Location) -> None:
    """Raise InputError where `[vehicle]` has a limit that only other dynamics have."""
    known = {name: {field.name for field in dataclasses.fields(kind)} for name, kind in DYNAMICS.items()}
    for key in table:
        owners = [f'"{name}"' for name, limits in known.items() if key in limits]
        if owners and key not in known[dynamics]:
            right = f"left out where dynamics is {dynamics}: only {' and '.join(owners)} has it"
            raise location.at(key).wrong("given", right)


def _rules(top: ScenarioSpec, vehicle: VehicleSpec, file: Location) -> Rules:
    """Return the rules of a scenario.

    Raises InputError where keys of its vehicle contradict each other or the crowd's, or where the sensor's delay is no
    whole number of steps, or more than `MAX_DELAY` of them.
    """
    location, delay = file.at("vehicle"), file.at("sensor", "delay")
    if _count_steps(top.sensor.delay, top.dt, delay) > MAX_DELAY:
        raise delay.wrong(f"{top.sensor.delay:g}", f"{MAX_DELAY * top.dt:g} s or less, {MAX_DELAY} steps")
    if top.pedestrians.sees_vehicle < 1.0 and not vehicle.visible:
        raise location.at("visible").wrong("false", "true where the key pedestrians.sees_vehicle says how many see it")
    limits = {key: value for key, value in vehicle.complete().items() if key not in VehicleSpec.model_fields}
    with location.named():
        dynamics = DYNAMICS[vehicle.dynamics](**{key: value for key, value in limits.items() if value is not None})
    if isinstance(dynamics, Unicycle) and dynamics.max_angular_speed * top.dt > math.pi:
        right = f"{math.pi / top.dt:.6g} rad/s at most: the vehicle may turn by half a circle in a step"
        raise location.at("max_angular_speed").wrong(f"{dynamics.max_angular_speed:g}", right)
    sensor = top.sensor.complete()
    if sensor["nearest"] is None and top.pedestrians.number[1] > SHOWN_IN:
        sensor["nearest"] = SHOWN
    return Rules(
        dt=top.dt,
        time_limit=top.time_limit,
        collision=top.collision,
        visible=vehicle.visible,
        sees_vehicle=top.pedestrians.sees_vehicle,
        dynamics=dynamics,
        goal_tolerance=vehicle.goal_tolerance,
        body=_body(vehicle, dynamics, location),
        sensor=Sensor.of_table(sensor),
    )


def _body(vehicle: VehicleSpec, dynamics: Dynamics, location: Location) -> Body:
    """The body of a vehicle, whose rear axle is as far behind the middle as the front axle is ahead of it."""
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


def restore(table: Mapping[str, Any], source: str, load: Loaders) -> Scenario:
    """Make the scenario of a run again, which draws the same cases to the last bit.

    Args:
        table: The table `scenario` of its `result.json`.
        source: What that file is called, for errors.
        load: Finds what the table names.

    Raises:
        InputError: As `parse` does.
    """
    crowd = {key: value for key, value in table["pedestrians"].items() if key != "policy_files"}
    keys = {key: value for key, value in table.items() if key not in ("name", "digest")}
    layout = {key: value for key, value in table.get("layout", {}).items() if key != "generator_file"}
    keys |= {"layout": layout, "pedestrians": crowd}
    scenario = parse(keys, str(table.get("name", "")), source, load)
    shares = crowd.get("policy")
    if isinstance(shares, Mapping) and len(shares) > 1 and math.isclose(sum(shares.values()), 1.0, abs_tol=1e-12):
        # They have been divided by their sum: once more could change their last bits.
        shares = {policy: float(shares[policy]) for policy in scenario.crowd.shares}
        written = {**scenario.table, "pedestrians": {**scenario.table["pedestrians"], "policy": shares}}
        return dataclasses.replace(scenario, crowd=dataclasses.replace(scenario.crowd, shares=shares), table=written)
    return scenario


def with_certificates(scenario: Scenario, spec: str, file: Path) -> Scenario:
    """Return a scenario with what a file says of its certificates.

    Args:
        scenario: The scenario.
        spec: Its name or its file, as a user gives it.
        file: The file with the certified cases, for this digest or another one; there may be none.

    Raises:
        InputError: The file is not as `studies/certificates/run.py` writes it.
    """
    certified = Certified.read(file)
    if certified is None:
        return scenario
    status = CertificateStatus(spec, scenario.name, scenario.digest, file, certified)
    return dataclasses.replace(scenario, certificates=status)


class _Policy(NamedTuple):
    """A pedestrian policy of a crowd, the share of the pedestrians that follow it, and the digest of its file."""

    policy: PedestrianPolicy
    share: float
    digest: str | None


def _policies(shares: Mapping[str, float], load: Loaders, location: Location) -> dict[str, _Policy]:
    """The policies by their names, in the order of these: who follows which must not depend on the file's order."""
    policies: dict[str, _Policy] = {}
    for spec, share in shares.items():
        with location.named():
            name, policy, digest = load.policy(spec)
        if name in policies or name in PedestriansSpec.model_fields:
            right = f"of policies that are not both called {name}, nor as another key here"
            raise location.wrong(", ".join(shares), right)
        policies[name] = _Policy(policy, share, digest)
    return dict(sorted(policies.items()))


def _write_policies(policies: Mapping[str, _Policy]) -> dict[str, Any]:
    """What a result says of the policies: names, whatever the file calls them, and the digests of their files."""
    shares = {name: policy.share for name, policy in policies.items() if policy.share}
    files = {name: policy.digest for name, policy in policies.items() if policy.digest is not None}
    return {"policy": shares if len(shares) > 1 else next(iter(shares))} | ({"policy_files": files} if files else {})
