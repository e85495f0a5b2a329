"""Reads a scenario from a TOML table and says in one sentence what is wrong with it."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from crowdbench.scenario.layouts import LAYOUTS
from crowdbench.scenario.scenario import Quantity, Scenario
from crowdbench.sim.pedestrians import PedestrianPolicy
from crowdbench.toml_section import Section, is_number, read_toml
from crowdbench.types import COLLISION_RULES, Rules

MAX_PEDESTRIANS = 1000
MAX_STEPS = 100_000
PolicyLoader = Callable[[str], tuple[str, PedestrianPolicy, str | None]]


def read_table(path: Path) -> dict[str, Any]:
    """The TOML table of a file. Raises InputError where it cannot be read."""
    return read_toml(path, "scenario")


def parse(table: Mapping[str, Any], name: str, source: str, load_policy: PolicyLoader) -> Scenario:
    """The scenario that a table describes; `load_policy` turns what the table says into a policy's
    name, the policy, and the digest of its file.

    Raises InputError, naming `source` and the key, for unknown keys, wrong types and impossible values.
    """
    top = Section(dict(table), source)
    top.text("description")
    rules = _rules(top)
    seed = top.integer("seed", 0, 0, 2**63 - 1)
    crowdnav_cases = top.integer("crowdnav_cases", 0, 0, 500)
    generator, layout = _layout(top.section("layout"))
    vehicle = top.section("vehicle")
    vehicle_radius = vehicle.number("radius", 0.3, above=0.0, below=100.0)
    vehicle_speed = vehicle.number("preferred_speed", 1.0, above=0.0, below=100.0)
    vehicle.close()
    pedestrians = top.section("pedestrians")
    number = pedestrians.interval("number", 5, 0, MAX_PEDESTRIANS)
    radius = _quantity(pedestrians, "radius", 0.3, least=1e-3)
    preferred_speed = _quantity(pedestrians, "preferred_speed", 1.0, least=1e-3)
    shares, policies = _policies(pedestrians, load_policy)
    parameters = {policy: _parameters(pedestrians.section(policy), made) for policy, made in policies.items()}
    pedestrians.close()
    top.close()
    return Scenario(
        name=name,
        source=source,
        rules=rules,
        seed=seed,
        crowdnav_cases=crowdnav_cases,
        generator=generator,
        layout=layout,
        vehicle_radius=vehicle_radius,
        vehicle_speed=vehicle_speed,
        number=number,
        radius=radius,
        preferred_speed=preferred_speed,
        shares=shares,
        policies=policies,
        parameters=parameters,
        table=top.complete,
    )


def _rules(top: Section) -> Rules:
    rules = Rules(
        dt=top.number("dt", 0.25, above=0.0, below=1.0),
        time_limit=top.number("time_limit", 25.0, above=1.0, below=1e6),
        collision=top.choice("collision", "swept", COLLISION_RULES),
        visible=top.section("vehicle").flag("visible", False),
    )
    if rules.max_steps > MAX_STEPS:
        raise top.wrong("dt", f"large enough for an episode of time_limit to end within {MAX_STEPS} steps")
    return rules


def _layout(layout: Section) -> tuple[str, dict[str, float]]:
    generator = layout.choice("generator", "circle_crossing", tuple(LAYOUTS))
    options = {
        option: layout.number(option, parameter.default, least=0.0, below=1e6)
        for option, parameter in inspect.signature(LAYOUTS[generator]).parameters.items()
        if parameter.kind is parameter.KEYWORD_ONLY
    }
    layout.close()
    return generator, options


def _policies(pedestrians: Section, load_policy: PolicyLoader) -> tuple[dict[str, float], dict[str, PedestrianPolicy]]:
    """Share and policy by name; in the complete table the names stand for themselves, files by their digests."""
    shares: dict[str, float] = {}
    policies: dict[str, PedestrianPolicy] = {}
    files: dict[str, str] = {}
    for spec, share in _shares(pedestrians, "policy", "orca").items():
        name, policy, digest = load_policy(spec)
        if name in pedestrians.complete or name in policies:
            raise pedestrians.wrong("policy", f"of policies that are not both called {name}, nor as another key here")
        shares[name], policies[name] = share, policy
        if digest is not None:
            files[name] = digest
    # In the order of their names: who follows which must not depend on the order in the file.
    shares, policies = dict(sorted(shares.items())), dict(sorted(policies.items()))
    pedestrians.complete["policy"] = shares if len(shares) > 1 else next(iter(shares))
    if files:
        pedestrians.complete["policy_files"] = files
    return shares, policies


def _parameters(section: Section, policy: PedestrianPolicy) -> dict[str, Quantity]:
    quantities = {
        parameter: _quantity(section, parameter, default, least=0.0) for parameter, default in policy.parameters.items()
    }
    section.close()
    return quantities


def _shares(section: Section, key: str, default: str) -> dict[str, float]:
    value = section.read(key, default)
    shares = {value: 1.0} if isinstance(value, str) else value
    if (
        not isinstance(shares, dict)
        or not shares
        or not all(is_number(share) and 0 < share < 1e9 for share in shares.values())
    ):
        raise section.wrong(
            key, "the name of a policy, or shares of several such as { orca = 0.7, social_force = 0.3 }"
        )
    total = sum(shares.values())
    return {name: share / total for name, share in shares.items()}


def _quantity(section: Section, key: str, default: float, *, least: float) -> Quantity:
    """A number or a Gaussian; whole where the default is."""
    value = section.read(key, default)
    table = {"mean": value, "std": 0.0, "low": value, "high": value} if is_number(value) else value
    if (
        not isinstance(table, dict)
        or set(table) != {"mean", "std", "low", "high"}
        or not all(map(is_number, table.values()))
        or not least <= table["low"] <= table["mean"] <= table["high"] < 1e6
        or not 0 <= table["std"] < 1e6
        or (table["std"] > 0 and table["high"] - table["low"] < 0.1 * table["std"])
    ):
        raise section.wrong(
            key,
            f"a number of at least {least:g}, or a Gaussian {{ mean = 1.0, std = 0.2, low = 0.6, high = 1.4 }} "
            f"with {least:g} <= low <= mean <= high and bounds that are not narrower than a tenth of std",
        )
    section.complete[key] = {name: float(number) for name, number in table.items()}
    return Quantity(**section.complete[key], whole=isinstance(default, int))
