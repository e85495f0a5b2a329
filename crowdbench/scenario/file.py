"""Reads a scenario from a TOML table and says in one sentence what is wrong with it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from crowdbench.dynamics import DISC, DYNAMICS, Bicycle, Body, Dynamics, Holonomic, Unicycle, chain
from crowdbench.errors import InputError
from crowdbench.scenario.certified import LEFT_OUT, without_recorded
from crowdbench.scenario.people import Quantity
from crowdbench.scenario.placement import Layout
from crowdbench.scenario.renewal import GoalChange
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
from crowdbench.scenario.tracked import RECORDED, TrackedCrowd
from crowdbench.sim.pedestrians import PedestrianPolicy, Recorded
from crowdbench.toml_file import Location, parsed, read_toml
from crowdbench.tracks.scenes import Scene
from crowdbench.types import Rules, Sensor

MAX_STEPS = 100_000
OF_TRACKS = ("number", "preferred_speed", "arrival", "goal_change", "groups")
"""Keys of `[pedestrians]` that recorded tracks stand for."""

PolicyLoader = Callable[[str], tuple[str, PedestrianPolicy, str | None]]
"""Turns what a table says of a pedestrian policy into its name, the policy, and the digest of its file, if any."""

LayoutLoader = Callable[[str], tuple[str, Layout, str | None]]
"""The same for a layout."""

SceneLoader = Callable[[str, Mapping[str, str]], Scene]
"""Reads a scene by its name, whose files must have the given sha256."""


def read_table(path: Path) -> dict[str, Any]:
    """The TOML table of a file. Raises InputError where it cannot be read."""
    return read_toml(path, "scenario")


def parse(
    table: Mapping[str, Any],
    name: str,
    source: str,
    load_layout: LayoutLoader,
    load_policy: PolicyLoader,
    load_scene: SceneLoader,
) -> Scenario:
    """Make a scenario from a table.

    Args:
        table: As read from a file, perhaps with changes.
        name: What the scenario is called.
        source: What its file is called, for errors.
        load_layout: Loads the layout.
        load_policy: Loads a pedestrian policy.
        load_scene: Reads a scene of recorded tracks.

    Returns:
        The scenario.

    Raises:
        InputError: A key is unknown, or a value is of the wrong type or impossible; `source` and the key are named.
    """
    file = Location(source)
    top = parsed(ScenarioSpec, table, file)
    _refuse_limits_of_others(table.get("vehicle", {}), top.vehicle.dynamics, file.at("vehicle"))
    vehicle = parsed(vehicle_spec(top.vehicle.dynamics), table.get("vehicle", {}), file.at("vehicle"))
    rules = _rules(top, vehicle, file.at("vehicle"))
    # Not by `max_steps`, which a tiny dt makes infinite.
    if top.time_limit - 1.0 > (MAX_STEPS - 1) * top.dt:
        right = f"large enough for an episode of time_limit to end within {MAX_STEPS} steps"
        raise file.at("dt").wrong(repr(top.dt), right)
    if top.seed and top.crowdnav_cases:
        raise InputError(
            f"{source}: seed is {top.seed}, which changes no test case below crowdnav_cases = {top.crowdnav_cases}, "
            "because these are drawn with CrowdNav's seeds: set crowdnav_cases = 0 too"
        )
    with file.at("layout", "generator").named():
        generator, layout, layout_file = load_layout(top.layout.generator)
        options_of_layout = layout_spec(layout)
    asked = {**table.get("layout", {}), "generator": generator}
    options = parsed(options_of_layout, asked, file.at("layout")).complete()
    policies = _policies(top.pedestrians.policy, load_policy, file.at("pedestrians", "policy"))
    tracks, found = _tracks(top, table, rules, load_scene, file)
    if tracks and tracks.has_cars and RECORDED not in policies:
        policies[RECORDED] = _Policy(Recorded(), 0.0, None)  # which moves the other cars
    kind = pedestrians_spec({policy: each.made.parameters for policy, each in policies.items()})
    pedestrians = parsed(kind, table.get("pedestrians", {}), file.at("pedestrians")).complete()
    return Scenario(
        name=name,
        source=source,
        rules=rules,
        seed=top.seed,
        crowdnav_cases=top.crowdnav_cases,
        layout=layout,
        layout_options={option: value for option, value in options.items() if option != "generator"},
        vehicle_radius=vehicle.radius,
        vehicle_speed=vehicle.preferred_speed,
        number=tracks.number if tracks else top.pedestrians.number,
        radius=Quantity(**pedestrians["radius"]),
        preferred_speed=Quantity(tracks.top_speed) if tracks else Quantity(**pedestrians["preferred_speed"]),
        shares={policy: each.share for policy, each in policies.items() if each.share},
        policies={policy: each.made for policy, each in policies.items()},
        parameters={
            policy: {
                parameter: Quantity(**pedestrians[policy][parameter], whole=isinstance(default, int))
                for parameter, default in each.made.parameters.items()
            }
            for policy, each in policies.items()
        },
        table={key: value for key, value in top.complete().items() if key != "tracks"}
        | {
            "layout": {} if tracks else options | ({"generator_file": layout_file} if layout_file else {}),
            "vehicle": vehicle.complete(),
            "pedestrians": {key: value for key, value in pedestrians.items() if not (tracks and key in OF_TRACKS)}
            | _written(policies),
        }
        | ({"tracks": found} if tracks else {}),
        arrival=top.pedestrians.arrival,
        groups={int(size): share for size, share in (top.pedestrians.groups or {}).items()},
        goal_change=_goal_change(top.pedestrians.goal_change, top.dt, file.at("pedestrians", "goal_change")),
        tracks=tracks,
    )


def _goal_change(spec: GoalChangeSpec | None, dt: float, location: Location) -> GoalChange | None:
    """How goals change on the way. Raises InputError where the period is no multiple of `dt`."""
    if spec is None:
        return None
    every = round(spec.period / dt)
    if every < 1 or not math.isclose(every * dt, spec.period):
        raise location.at("period").wrong(f"{spec.period:g}", f"a multiple of dt, {dt:g} s")
    return GoalChange(every, spec.chance)


def _tracks(
    top: ScenarioSpec, table: Mapping[str, Any], rules: Rules, load_scene: SceneLoader, file: Location
) -> tuple[TrackedCrowd | None, dict[str, Any]]:
    """The recorded people of a scenario, and what a result says of them.

    Args:
        top: The scenario's file.
        table: The same as it was read.
        rules: The rules of the scenario.
        load_scene: Reads a scene.
        file: What the file is called, for errors.

    Returns:
        None and nothing for a scenario without them.

    Raises:
        InputError: A key says what the tracks say too, the policy of recorded people has none, or the scene cannot be
            read.
    """
    if top.tracks is None:
        if RECORDED in top.pedestrians.policy:
            raise file.at("pedestrians", "policy").wrong(RECORDED, "another policy, or there must be a table [tracks]")
        return None, {}
    own: list[tuple[str, ...]] = [(key,) for key in ("layout", "crowdnav_cases") if table.get(key)]
    own += [("pedestrians", key) for key in OF_TRACKS if key in table.get("pedestrians", {})]
    if own:
        right = "left out where there is a table [tracks], which says who starts where, how fast, and to where"
        raise file.at(*own[0]).wrong("given", right)
    with file.at("tracks").named():
        scene = load_scene(top.tracks.scene, top.tracks.files)
        crowd = TrackedCrowd.of(scene, top.tracks.distance, rules)
    if crowd.has_cars and "distance" in table["tracks"]:
        raise file.at("tracks", "distance").wrong("given", "left out where cars say where the vehicle starts and goes")
    found = {"scene": scene.name, "files": dict(scene.files)}
    return crowd, found if crowd.has_cars else found | {"distance": crowd.distance}


def _refuse_limits_of_others(table: Mapping[str, Any], dynamics: str, location: Location) -> None:
    """Raise InputError where `[vehicle]` has a limit that only other dynamics have."""
    known = {name: {field.name for field in dataclasses.fields(kind)} for name, kind in DYNAMICS.items()}
    for key in table:
        owners = [f'"{name}"' for name, limits in known.items() if key in limits]
        if owners and key not in known[dynamics]:
            right = f"left out where dynamics is {dynamics}: only {' and '.join(owners)} has it"
            raise location.at(key).wrong("given", right)


def _rules(top: ScenarioSpec, vehicle: VehicleSpec, location: Location) -> Rules:
    """The rules of a scenario. Raises InputError where keys of its vehicle contradict each other or the crowd's."""
    if top.pedestrians.sees_vehicle < 1.0 and not vehicle.visible:
        raise location.at("visible").wrong("false", "true where the key pedestrians.sees_vehicle says how many see it")
    limits = {key: value for key, value in vehicle.complete().items() if key not in VehicleSpec.model_fields}
    with location.named():
        dynamics = DYNAMICS[vehicle.dynamics](**{key: value for key, value in limits.items() if value is not None})
    if isinstance(dynamics, Unicycle) and dynamics.max_angular_speed * top.dt > math.pi:
        right = f"{math.pi / top.dt:.6g} rad/s at most: the vehicle may turn by half a circle in a step"
        raise location.at("max_angular_speed").wrong(f"{dynamics.max_angular_speed:g}", right)
    return Rules(
        dt=top.dt,
        time_limit=top.time_limit,
        collision=top.collision,
        visible=vehicle.visible,
        sees_vehicle=top.pedestrians.sees_vehicle,
        dynamics=dynamics,
        goal_tolerance=vehicle.goal_tolerance,
        body=_body(vehicle, dynamics, location),
        sensor=_sensor(top),
    )


def _sensor(top: ScenarioSpec) -> Sensor:
    """The sensor of a scenario; without `nearest` it shows the nearest `SHOWN` of more than `SHOWN_IN` pedestrians."""
    sensor = Sensor.of_table(top.sensor.complete())
    if sensor.nearest is None and top.pedestrians.number[1] > SHOWN_IN:
        return dataclasses.replace(sensor, nearest=SHOWN)
    return sensor


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


def restored(
    table: Mapping[str, Any],
    source: str,
    load_layout: LayoutLoader,
    load_policy: PolicyLoader,
    load_scene: SceneLoader,
) -> Scenario:
    """Make the scenario of a run again.

    Args:
        table: The table `scenario` of its `result.json`.
        source: What that file is called, for errors.
        load_layout: Loads the layout.
        load_policy: Loads a pedestrian policy.
        load_scene: Reads a scene of recorded tracks.

    Returns:
        The scenario, which draws the same cases to the last bit.

    Raises:
        InputError: As `parse` does.
    """
    crowd = {key: value for key, value in table["pedestrians"].items() if key != "policy_files"}
    keys = {key: value for key, value in table.items() if key not in ("name", "digest", LEFT_OUT)}
    layout = {key: value for key, value in table.get("layout", {}).items() if key != "generator_file"}
    keys |= {"layout": layout, "pedestrians": crowd}
    made = parse(keys, str(table.get("name", "")), source, load_layout, load_policy, load_scene)
    made = without_recorded(made, table, source)
    shares = crowd.get("policy")
    if isinstance(shares, Mapping) and len(shares) > 1 and math.isclose(sum(shares.values()), 1.0, abs_tol=1e-12):
        # They have been divided by their sum: once more could change their last bits.
        shares = {policy: float(shares[policy]) for policy in made.shares}
        written = {**made.table, "pedestrians": {**made.table["pedestrians"], "policy": shares}}
        return dataclasses.replace(made, shares=shares, table=written)
    return made


@dataclass(frozen=True)
class _Policy:
    """A pedestrian policy of a crowd, the share of the pedestrians that follow it, and the digest of its file."""

    made: PedestrianPolicy
    share: float
    digest: str | None


def _policies(shares: Mapping[str, float], load_policy: PolicyLoader, location: Location) -> dict[str, _Policy]:
    """The policies by their names, in the order of these: who follows which must not depend on the file's order."""
    policies: dict[str, _Policy] = {}
    for spec, share in shares.items():
        with location.named():
            name, made, digest = load_policy(spec)
        if name in policies or name in PedestriansSpec.model_fields:
            right = f"of policies that are not both called {name}, nor as another key here"
            raise location.wrong(", ".join(shares), right)
        policies[name] = _Policy(made, share, digest)
    return dict(sorted(policies.items()))


def _written(policies: Mapping[str, _Policy]) -> dict[str, Any]:
    """What a result says of the policies: names, whatever the file calls them, and the digests of their files."""
    shares = {name: policy.share for name, policy in policies.items() if policy.share}
    files = {name: policy.digest for name, policy in policies.items() if policy.digest is not None}
    return {"policy": shares if len(shares) > 1 else next(iter(shares))} | ({"policy_files": files} if files else {})
