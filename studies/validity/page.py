"""The page of the study: measured results beside published ones."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Shaped

from crowdbench.metrics import MetricInfo, mean_over_networks
from crowdbench.utils import markdown, printed_by
from studies.validity import door, experiments
from studies.validity.experiments import EVERYBODY, People, Setting

Results = Mapping[Setting, Any]
"""Result of each setting: a `Passages` of a door, a `Walk` of all others."""

SPEED = MetricInfo("speed", "m/s", digits=2)
SHARE = MetricInfo("share", share=True, digits=2)
FLOW = MetricInfo("specific flow", "/(m s)", digits=2)

JAM_DENSITY = 5.4
"""Pedestrians per square metre at which all motion stops (Weidmann 1993)."""


DOOR_FLOW = {0.8: 1.61, 1.0: 1.90, 1.2: 1.97}
"""Specific flow in 1/(m s) of 60 people through a bottleneck by its width in metres (Seyfried et al. 2009, table 2)."""

SOURCES = Path(__file__).with_name("sources.txt")
"""The full references, in Markdown."""

LIMITS = {name: SOURCES.with_name(name + ".txt").read_text("utf-8").strip() for name in ("orca", "social_force")}
"""Capabilities and limits of the shipped policies, by name."""

TEXT = SOURCES.with_name("page.txt").read_text("utf-8").strip()
"""The page in Markdown, with names for its numbers and tables."""


def page(results: Results, command: str) -> str:
    """Return the page in Markdown.

    Args:
        results: The result.
        command: The command that prints the page.
    """
    policies = list(dict.fromkeys(setting.policy for setting in results))
    in_file = [people for people in EVERYBODY if people.per_metre]
    tables = {
        "one_way": (_speeds(results, policies, "one way", people, "people per m²") for people in EVERYBODY),
        "single_file": (_speeds(results, policies, "single file", people, "people per m") for people in in_file),
        "lanes": (_lanes(results, policy) for policy in policies),
        "doors": (_doors(results, policy) for policy in policies),
    }
    return fill(
        printed=printed_by(command),
        worlds=len(_of(results, "one way", policies[0])[0][1].speed),
        limits="".join(f"**{policy}**: {LIMITS[policy]}\n\n" for policy in policies if policy in LIMITS),
        **{name: "\n\n".join(each) for name, each in tables.items()},
    )


def fill(**parts: str | int) -> str:
    """Fill `TEXT` with its parts, and with the numbers of the experiments."""
    sources = SOURCES.read_text(encoding="utf-8").strip()
    return TEXT.format(experiments=experiments, door=door, stuck=100 * experiments.STUCK, sources=sources, **parts)


def _speeds(results: Results, policies: list[str], experiment: str, people: People, at: str) -> str:
    """Return the speeds of one kind of pedestrians: rows for each policy, with a column for each density."""
    in_file = experiment == "single file"
    densities = people.per_metre if in_file else people.densities
    published = [single_file_speed(each) if in_file else weidmann_speed(each, people.free_speed) for each in densities]
    rows = [["published", *map(SPEED.amount, published)]]
    for policy in policies:
        walks = [results[Setting(experiment, policy, people, density)] for density in densities]
        rows.append([policy, *(_estimate(SPEED, walk.speed) for walk in walks)])
        rows.append(["overlapping", *(_mean(walk.overlapping) for walk in walks)])
    return f"{people.title}:\n\n" + markdown([at, *(f"{each:g}" for each in densities)], rows)


def _lanes(results: Results, policy: str) -> str:
    """Return the order of lanes under one policy, by kinds of pedestrians and density."""
    rows = []
    for setting, walk in _of(results, "two ways", policy):
        free = float(results[replace(setting, experiment="one way")].speed.mean())
        cells = [_estimate(SHARE, walk.order), _estimate(SPEED, walk.speed), SPEED.amount(free), _count(walk.stuck)]
        rows.append([setting.people.title, f"{setting.at:g}", *cells])
    header = ["people", "per m²", "order of lanes", "speed", "speed in one direction", "worlds stuck"]
    return f"{policy}:\n\n" + markdown(header, rows)


def _doors(results: Results, policy: str) -> str:
    """Return the flow through doors under one policy, by kinds of pedestrians and width."""
    rows = []
    for setting, passages in _of(results, "door", policy):
        published = FLOW.amount(DOOR_FLOW.get(setting.at, math.nan))
        flow = _estimate(FLOW, passages.flow() / setting.at)
        cells = [published, flow, _mean(passages.share), _count(passages.blocked)]
        rows.append([setting.people.title, f"{setting.at:g} m", *cells])
    header = ["people", "width", "published", "specific flow", f"through in {door.TIME:g} s", "doors blocked"]
    return f"{policy}:\n\n" + markdown(header, rows)


def weidmann_speed(density: float, free_speed: float = 1.34) -> float:
    """Return mean walking speed on level ground by density, a fit to 25 data sets (Weidmann 1993).

    Args:
        density: In 1/m^2.
        free_speed: Mean speed of single pedestrians in m/s; Weidmann's is 1.34 m/s.

    Returns:
        In m/s.
    """
    return free_speed * (1.0 - math.exp(-1.913 * (1.0 / density - 1.0 / JAM_DENSITY)))


def single_file_speed(per_metre: float) -> float:
    """Return mean walking speed in single file by density, from the required length 0.36 m + 1.06 s v (Seyfried et al.
    2005).

    Args:
        per_metre: Pedestrians per metre, in 1/m.

    Returns:
        In m/s.
    """
    return (1.0 / per_metre - 0.36) / 1.06


def _of(results: Results, experiment: str, policy: str) -> list[tuple[Setting, Any]]:
    """Return the results of one experiment with one policy."""
    return [(s, result) for s, result in results.items() if (s.experiment, s.policy) == (experiment, policy)]


def _estimate(info: MetricInfo, values: Shaped[np.ndarray, "world"]) -> str:
    """Return a mean over worlds with its 95 % interval; a dash if no world has a value."""
    return info.estimate(mean_over_networks(values.astype(float)[None]), with_unit=True)


def _mean(shares: Shaped[np.ndarray, "world"]) -> str:
    return SHARE.amount(float(shares.mean()))


def _count(worlds: Shaped[np.ndarray, "world"]) -> str:
    return f"{int(worlds.sum())} of {len(worlds)}"
