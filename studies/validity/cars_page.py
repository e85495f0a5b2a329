"""The section on people beside cars: what was measured, in Markdown."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from crowdbench.metrics.info import MetricInfo
from crowdbench.utils.tables import markdown
from studies.validity import cars, energy
from studies.validity.cars import Vectors, Windows

RECORDED, KEPT = "floor: recorded people of other clips", "everybody keeps the velocity"

TRIED: Mapping[str, Mapping[str, Sequence[float]]] = {
    "orca": {"time_horizon": (1.0, 2.0, 3.0, 5.0, 8.0), "safety_space": (0.0, 0.1, 0.2)},
    "social_force": {
        "repulsion_strength": (0.1, 0.3, 1.0, 2.1),
        "repulsion_range": (0.1, 0.3),
        "look_ahead": (0.5, 2.0),
    },
}
"""The parameters that are tried for each policy on the first halves of the clips."""

METRES = MetricInfo("energy distance", "m", "less")

TEXT = Path(__file__).with_name("cars.txt").read_text("utf-8").strip().format(cars=cars, energy=energy)
"""What is measured, in Markdown."""


@dataclass(frozen=True)
class BesideCars:
    """What was measured.

    Attributes:
        windows: The second halves of the clips.
        moved: Where each policy moves the people, by what the table calls it.
        fitted: The parameters that are fitted of each policy.
    """

    windows: Windows
    moved: Mapping[str, Vectors]
    fitted: Mapping[str, Mapping[str, float]]


def measure(policies: Sequence[str], data: Path) -> BesideCars:
    """Move people beside cars by policies, with their defaults and with parameters that are fitted.

    Args:
        policies: The names or files of the policies.
        data: The folder with the clips of DUT.

    Raises:
        InputError: The folder lacks a clip, or a policy fails.
    """
    first, second = cars.cut_halves(data)
    moved, fitted = {KEPT: cars.keep_on(second)}, {}
    for policy in policies:
        moved[policy] = cars.move(second, policy, {}, data)
        if policy in TRIED:
            own = fitted[policy] = _fit(first, policy, data)
            moved[f"{policy}, fitted"] = cars.move(second, policy, own, data)
    return BesideCars(second, moved, fitted)


def _fit(first: Windows, policy: str, data: Path) -> dict[str, float]:
    """The parameters that are best on the first halves."""
    each = [dict(zip(TRIED[policy], values, strict=True)) for values in itertools.product(*TRIED[policy].values())]
    return min(each, key=lambda own: energy.distance(first, cars.move(first, policy, own, data)).mean)


def section(found: BesideCars) -> str:
    """The section in Markdown."""
    reference = found.moved.get("orca")
    rows = [[RECORDED, _say(energy.floor(found.windows)), ""]]
    for name, moved in found.moved.items():
        gap = (
            "" if reference is None or moved is reference else _say(energy.difference(found.windows, moved, reference))
        )
        rows.append([name, _say(energy.distance(found.windows, moved)), gap])
    table = markdown(["people", "energy distance", "more than orca"], rows)
    fitted = [
        f"{policy}, fitted: " + ", ".join(f"`{name}` {value:g}" for name, value in own.items()) + "."
        for policy, own in found.fitted.items()
    ]
    return "\n\n".join(["## People beside cars", TEXT, table, *fitted, _means(found)])


def _means(found: BesideCars) -> str:
    """Mean displacements by group, forward and away."""
    rows = []
    for number, name in enumerate(cars.group_names()):
        own = found.windows.group == number
        if own.sum() >= energy.LEAST:
            each = [moved[own].mean(axis=0) for moved in (found.windows.moved, *found.moved.values())]
            rows.append([name, str(own.sum()), *(f"{forward:.2f}, {away:+.2f}" for forward, away in each)])
    header = ["gap, and car within 1 m", "people", "recorded", *found.moved]
    return "Mean displacement in metres, forward and away from the car:\n\n" + markdown(header, rows)


def _say(value: energy.Range) -> str:
    return METRES.estimate(value, with_unit=True)
