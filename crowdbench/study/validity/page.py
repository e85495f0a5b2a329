"""The page of `crowdbench validity`: what was measured, beside what is published."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np
from jaxtyping import Shaped

from crowdbench.evaluate.formats import markdown
from crowdbench.study.intervals import mean_over_networks
from crowdbench.study.measures import Measure
from crowdbench.study.validity import door, texts
from crowdbench.study.validity.measure import Left, Setting, Walked
from crowdbench.study.validity.people import EVERYBODY, People
from crowdbench.study.validity.published import DOOR_FLOW, single_file_speed, weidmann_speed

Found = Mapping[Setting, Walked | Left]
"""What was found, by what was measured."""

Kind = TypeVar("Kind", Walked, Left)

SOURCES = Path(__file__).with_name("sources.md")
"""The full references, in Markdown."""

SPEED = Measure("speed", "speed", "m/s", sign=1, digits=2)
SHARE = Measure("share", "share", "%", sign=1, digits=0, scale=100.0)
FLOW = Measure("flow", "specific flow", "/(m s)", sign=1, digits=2)


def page(found: Found) -> str:
    """Write the page.

    Args:
        found: What was found.

    Returns:
        The page in Markdown.
    """
    policies = list(dict.fromkeys(setting.policy for setting in found))
    worlds = len(next(result.speed for result in found.values() if isinstance(result, Walked)))
    parts = [
        "# Validity of the pedestrian policies",
        texts.INTRODUCTION.format(worlds=worlds),
        *(f"**{policy}**: {texts.LIMITS[policy]}" for policy in policies if policy in texts.LIMITS),
        "## Speed against density",
        texts.ONE_WAY,
        *(_speeds(found, policies, "one way", people, "people per m²") for people in EVERYBODY),
        texts.SINGLE_FILE,
        *(_speeds(found, policies, "single file", people, "people per m") for people in EVERYBODY if people.per_metre),
        "## Lanes",
        texts.TWO_WAYS,
        *(_lanes(found, policy) for policy in policies),
        "## Flow through a door",
        texts.DOOR,
        *(_doors(found, policy) for policy in policies),
        "## References",
        SOURCES.read_text(encoding="utf-8").strip(),
    ]
    return "\n\n".join(parts)


def published_speed(setting: Setting) -> float:
    """The published mean speed in m/s in one direction or in single file."""
    if setting.experiment == "single file":
        return single_file_speed(setting.at)
    return weidmann_speed(setting.at, setting.people.free_speed)


def estimated(measure: Measure, values: Shaped[np.ndarray, "world"]) -> str:
    """A mean over worlds with its 95 % interval, as the page shows it; a dash where no world has a value."""
    if np.isnan(values.astype(float)).all():
        return "-"
    return measure.estimate(mean_over_networks(values.astype(float)[None]))


def _speeds(found: Found, policies: Sequence[str], experiment: str, people: People, at: str) -> str:
    """The speeds of one kind of people by density, under all policies."""
    by_policy = [dict(_of(found, Walked, experiment, policy, people)) for policy in policies]
    rows = []
    for i, setting in enumerate(by_policy[0]):
        cells = [list(results.values())[i] for results in by_policy]
        row = [f"{setting.at:g}", SPEED.number(published_speed(setting))]
        rows.append(row + [text for each in cells for text in (estimated(SPEED, each.speed), _mean(each.overlapping))])
    header = [heading for policy in policies for heading in (policy, "overlapping")]
    return f"{people.title}:\n\n" + markdown([at, "published", *header], rows)


def _lanes(found: Found, policy: str) -> str:
    """Lanes under one policy, by kinds of people and density."""
    one_way = {(setting.people, setting.at): walked for setting, walked in _of(found, Walked, "one way", policy)}
    rows = []
    for setting, walked in _of(found, Walked, "two ways", policy):
        free = one_way[setting.people, setting.at].speed.mean()
        speeds = [estimated(SPEED, walked.speed), SPEED.number(float(free))]
        found_of = [estimated(SHARE, walked.order), *speeds, _count(walked.stuck)]
        rows.append([setting.people.title, f"{setting.at:g}", *found_of])
    header = ["people", "per m²", "order of lanes", "speed", "speed in one direction", "worlds stuck"]
    return f"{policy}:\n\n" + markdown(header, rows)


def _doors(found: Found, policy: str) -> str:
    """The flow through doors under one policy, by kinds of people and width."""
    rows = []
    for setting, left in _of(found, Left, "door", policy):
        reported = FLOW.reported(DOOR_FLOW.get(setting.at)) or "-"
        flow = [reported, estimated(FLOW, left.flow), _mean(left.share), _count(left.blocked)]
        rows.append([setting.people.title, f"{setting.at:g} m", *flow])
    header = ["people", "width", "published", "specific flow", f"through in {door.TIME:g} s", "doors blocked"]
    return f"{policy}:\n\n" + markdown(header, rows)


def _of(
    found: Found, kind: type[Kind], experiment: str, policy: str, people: People | None = None
) -> list[tuple[Setting, Kind]]:
    """What was found in one experiment with one policy, with one kind of people or with all."""
    return [
        (setting, result)
        for setting, result in found.items()
        if isinstance(result, kind) and (setting.experiment, setting.policy) == (experiment, policy)
        if people is None or setting.people is people
    ]


def _mean(shares: Shaped[np.ndarray, "world"]) -> str:
    return SHARE.number(float(shares.mean()))


def _count(worlds: Shaped[np.ndarray, "world"]) -> str:
    return f"{int(worlds.sum())} of {len(worlds)}"
