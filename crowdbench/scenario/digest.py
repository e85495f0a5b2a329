"""The digest of a scenario: twelve hexadecimal digits that two scenarios share if all their cases are the same."""

from __future__ import annotations

import functools
import hashlib
import json
from collections.abc import Mapping
from typing import Any

from crowdbench.core.dynamics import DYNAMICS
from crowdbench.scenario.layouts import LAYOUTS
from crowdbench.scenario.schema import (
    ClearSpaceSpec,
    GoalChangeSpec,
    LidarSpec,
    ScenarioSpec,
    layout_spec,
    pedestrians_spec,
    vehicle_spec,
)
from crowdbench.sim.pedestrians import ORCA, ORCAPlus, PowerLaw, Recorded, SocialForce, Standing, StopAndGo, Straight

VERSION = 1
"""Raise it when a default changes, or what a key means, so that no earlier digest is the digest of a scenario now."""

BUILT_IN = {
    "distracted": StopAndGo(ORCA()),
    "orca": ORCA(),
    "orca_plus": ORCAPlus(),
    "power_law": PowerLaw(),
    "recorded": Recorded(),
    "social_force": SocialForce(),
    "standing": Standing(),
    "straight": Straight(),
}
"""The pedestrian policies whose parameters' defaults are known here, by their names."""

_NAMES = ("name", "description")
"""What a result has beside the keys that make the cases."""


def compute_digest(table: Mapping[str, Any]) -> str:
    """Return the digest of a scenario: twelve hexadecimal digits.

    It is over the keys whose values differ from their defaults, and over the digests of the files of layouts and
    policies. A new key whose default means what was the case before changes no digest.

    Args:
        table: The scenario in full, `Scenario.table`, or the table `scenario` of a `result.json`.
    """
    return _digest_of(json.dumps({key: value for key, value in table.items() if key not in _NAMES}))


@functools.lru_cache(maxsize=1000)
def _digest_of(text: str) -> str:
    table = json.loads(text)
    changed = json.dumps({"version": VERSION, **_changed(table, _defaults(table))}, sort_keys=True)
    return hashlib.sha256(changed.encode()).hexdigest()[:12]


def _defaults(table: Mapping[str, Any]) -> dict[str, Any]:
    """All keys of a scenario of the same layout and policies with their defaults, as far as these are known.

    The options of a layout and the parameters of a policy from elsewhere count in full.
    """
    top = ScenarioSpec()
    files = table.get("pedestrians", {}).get("policy_files", {})
    policies = {name: policy.parameters for name, policy in BUILT_IN.items() if name not in files}
    defaults = {**top.complete(), "pedestrians": pedestrians_spec(policies)().complete()}
    # Written as the name of one policy, where all pedestrians follow the same.
    (defaults["pedestrians"]["policy"],) = top.pedestrians.policy
    # Tables that may be left out as a whole have defaults where they are given.
    optional = (
        ("pedestrians", "goal_change", GoalChangeSpec),
        ("pedestrians", "clear_space", ClearSpaceSpec),
        ("sensor", "lidar", LidarSpec),
    )
    for section, key, kind in optional:
        if table.get(section, {}).get(key) is not None:
            fields = kind.model_fields.items()
            defaults[section][key] = {name: field.default for name, field in fields if not field.is_required()}
    layout = table.get("layout", {})
    generator = layout.get("generator", top.layout.generator)
    if generator in LAYOUTS and "generator_file" not in layout:
        defaults["layout"] = layout_spec(LAYOUTS[generator])().complete()
    dynamics = table.get("vehicle", {}).get("dynamics", top.vehicle.dynamics)
    if dynamics in DYNAMICS:
        defaults["vehicle"] = vehicle_spec(dynamics)().complete()
    return defaults


def _changed(table: Mapping[str, Any], defaults: Mapping[str, Any]) -> dict[str, Any]:
    """What of a table differs from its defaults; a table within it counts if anything in it does."""
    changed = {}
    for key, value in table.items():
        default = defaults.get(key)
        if isinstance(value, dict) and isinstance(default, dict):
            value, default = _changed(value, default), {}
        if key not in defaults or value != default:
            changed[key] = value
    return changed
