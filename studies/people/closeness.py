"""Measure the seconds that recorded people are close to strangers, as the score of the suite counts them."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple, no_type_check

import numpy as np
import typer

sys.path.append(str(Path(__file__).parents[2]))

from crowdbench.cli import help_from_docstring, main
from crowdbench.metrics import SAMPLE, bootstrap_distribution, closeness, include_mean, interval, weighted_mean
from crowdbench.utils import Format, Grid, markdown, njit, printed_by
from studies.command import print_study

if TYPE_CHECKING:
    from studies.people.windows import Window

RADII = (0.2, 0.3)
"""Radii of a person in metres: as in the other scores of people, and that of the suite's vehicle."""

HEADER = ("people", "radius [m]", "windows", "person-seconds", "seconds close per second", "score without delays")

_NOTE = (
    "Each second of a person counts the sum of its weights over strangers: 1 at gaps up to 0.3 m, falling to 0 at "
    "0.6 m. Members of a group do not count. Between annotations, which are 0.4 s apart, motion is straight. 95 % "
    "intervals are over windows of 8 s. The last column is the score of a vehicle that is as close and never delayed."
)


class Closeness(NamedTuple):
    """Seconds close to strangers per second of a person, with a 95 % interval over windows.

    Attributes:
        mean: The mean.
        low: Lower bound of the interval.
        high: Upper bound of the interval.
        seconds: Sum of the seconds of all persons.
    """

    mean: float
    low: float
    high: float
    seconds: float

    @property
    def cells(self) -> list[str]:
        """The cells of the mean, and of the score of a vehicle that is as close and never delayed."""
        score, least, most = (1.0 / (1.0 + rate) for rate in (self.mean, self.high, self.low))
        return [f"{self.mean:.3f} ({self.low:.3f} to {self.high:.3f})", f"{score:.2f} ({least:.2f} to {most:.2f})"]


@help_from_docstring
def people_close(data: Annotated[Path, typer.Option()], format: Format = Format.MARKDOWN) -> None:
    """Measure the seconds that recorded people are close to strangers.

    Args:
        data: The folder with the tracks of ETH/UCY.
    """
    from studies.people.windows import read_windows

    locations = read_windows(data)
    parts = {"all": [window for windows in locations.values() for window in windows], **locations}
    found = [
        (name, radius, len(windows), measure(windows, radius)) for radius in RADII for name, windows in parts.items()
    ]
    rows = [
        [name, f"{radius}", f"{number}", f"{each.seconds:,.0f}", *each.cells] for name, radius, number, each in found
    ]
    records = [
        {"people": name, "radius": radius, "windows": number, **each._asdict()} for name, radius, number, each in found
    ]
    grid = Grid("People close to strangers", HEADER, rows, records)
    page = [printed_by("python studies/people/closeness.py --data DIR"), markdown(grid.header, grid.rows), _NOTE]
    print_study(records, [grid], "\n\n".join(page), format)


def measure(windows: Sequence[Window], radius: float) -> Closeness:
    """Return the mean closeness of all persons in some windows, who have a radius in metres."""
    close, seconds = np.array([seconds_close(window, radius) for window in windows]).T
    mean = float(weighted_mean(close / seconds, seconds))
    bounds = interval(bootstrap_distribution(weighted_mean, close / seconds, seconds))
    return Closeness(mean, *include_mean(mean, *bounds), float(seconds.sum()))


def seconds_close(window: Window, radius: float) -> tuple[float, float]:
    """Return the seconds of all persons close to strangers in a window, and the seconds of their presence."""
    there = window.present
    dt = window.seconds / (len(window.future) - 1)
    close = _sum_closeness(np.ascontiguousarray(window.future), window.strangers, radius)
    return dt * close, dt * float((there[1:] & there[:-1]).sum())


@no_type_check
@njit
def _sum_closeness(path, strangers, radius):
    """Return the closeness of all persons to strangers, summed over the intervals between frames.

    Args:
        path (array): `[frame, person, 2]`, in metres, NaN for absent persons.
        strangers (array): `[person, person]`, True for pairs that count.
        radius (float): Of a person in metres.
    """
    total = 0.0
    for t in range(len(path) - 1):
        for i in range(path.shape[1]):
            for j in range(path.shape[1]):
                x, y = path[t, j, 0] - path[t, i, 0], path[t, j, 1] - path[t, i, 1]
                dx = path[t + 1, j, 0] - path[t + 1, i, 0] - x
                dy = path[t + 1, j, 1] - path[t + 1, i, 1] - y
                if not strangers[i, j] or math.isnan(x + dx):
                    continue
                samples = max(1, math.ceil(math.hypot(dx, dy) / SAMPLE))
                for k in range(samples):
                    share = (k + 0.5) / samples
                    total += closeness(math.hypot(x + share * dx, y + share * dy) - 2.0 * radius) / samples
    return total


if __name__ == "__main__":
    main(people_close)
