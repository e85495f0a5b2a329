"""The digest of a scenario, which identifies its cases."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any

NOT_IN_DIGEST = ("name", "description", "digest")
"""Keys of a scenario's table that influence no episode."""


def scenario_digest(table: Mapping[str, Any]) -> str:
    """Return twelve hexadecimal digits that change with the cases of a scenario.

    They are the start of the sha256 of the complete table as JSON, without `NOT_IN_DIGEST` and without keys that have
    no value: a new key whose default is None changes no digest.

    Args:
        table: The complete table of the scenario, such as the table `scenario` of a run's `result.json`.
    """
    kept = {key: value for key, value in table.items() if key not in NOT_IN_DIGEST}
    text = json.dumps(_without_none(kept), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def _without_none(table: Mapping[str, Any]) -> dict[str, Any]:
    """Return a table without keys that have no value, also in nested tables."""
    values = {key: _without_none(value) if isinstance(value, dict) else value for key, value in table.items()}
    return {key: value for key, value in values.items() if value is not None}
