"""Measure the motion of simulated and recorded pedestrians, without a vehicle; prints motion.md beside this file."""

from __future__ import annotations

import dataclasses
import itertools
import shlex
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
import typer
from jaxtyping import Float, Int

sys.path.append(str(Path(__file__).parents[2]))

from crowdbench import SCENARIOS, Cases, Scenario, load_scenario, read_suite
from crowdbench.cli import help_from_docstring, main
from crowdbench.core import norm
from crowdbench.scenario import ETH_UCY_DT, FRAME_STEP, RecordedTracks, read_tracks
from crowdbench.sim import crowd_decisions, init_memories, step_pedestrians
from crowdbench.utils import markdown, printed_by

Names = Annotated[list[str] | None, typer.Argument(show_default="the suite, and the maps")]

MOVING, SHORTEST = 0.3, 1.0
"""Speed in m/s of both steps of a reversal; shortest path in metres of a pedestrian that counts as walking."""

NEAR, MIDDLE = 2.0, 2.5
"""Distances in metres: to neighbours that count for the density, and to the mean position of the crowd."""

DENSITIES = (0, 3, 6, 1000)
"""Bounds of the classes of the number of near neighbours."""

BRUSHING, RECORDED_RADIUS = 0.05, 0.2
"""In metres: the largest overlap that does not count, and the assumed radius of recorded pedestrians."""

TEXT = Path(__file__).with_suffix(".txt")
"""Text of the page in Markdown, with names for the numbers above."""

HEADER = "people|acceleration 50 %|90 %|99 %|largest|reversals|overlap|share|speed < 3|3 to 5|6 on|arrive|drive|near"


class Walks(NamedTuple):
    """Positions of pedestrians, a row for each pedestrian and moment, ordered by pedestrian and then by time.

    Attributes:
        person: A number for each pedestrian of each world.
        time: In seconds.
        moment: A number for each moment of each world.
        position: In metres.
        radius: In metres.
    """

    person: Int[np.ndarray, "row"]
    time: Float[np.ndarray, "row"]
    moment: Int[np.ndarray, "row"]
    position: Float[np.ndarray, "row 2"]
    radius: Float[np.ndarray, "row"]


def simulate(scenario: Scenario, cases: Cases) -> tuple[Walks, list[float]]:
    """Simulate the pedestrians of a scenario up to its time limit without a vehicle.

    Returns:
        Their walks; and the share that arrives, the smallest distance in metres of a straight drive to their mean
        position, and the number of pedestrians within `MIDDLE` of that position at this time.
    """
    start, dt = scenario.worlds(cases), scenario.rules.dt
    world = init_memories(start.replace(rules=dataclasses.replace(start.rules, visible=False)), scenario.policies)
    states = []
    for _ in range(scenario.rules.max_steps + 1):
        states.append((world.position[:, 1:], np.where(world.present[:, 1:], world.person, -1), world.radius[:, 1:]))
        crowd, world = crowd_decisions(world, scenario.policies)
        world = step_pedestrians(world, crowd, scenario.post_step_rule)
    place, number, radius = map(np.array, zip(*states, strict=True))
    at = step, case, column = np.array((number >= 0).nonzero())
    person = (case * place.shape[2] + column) * (number.max() + 1) + number[step, case, column]
    order = np.lexsort((step, person))
    (step, case, column), person = at[:, order], person[order]
    arrived = (step[np.flatnonzero(np.diff(person, append=-1))] < len(place) - 1).mean()
    way = start.goal[:, 0] - start.position[:, 0]
    driven = np.arange(len(place))[:, None] * dt * start.preferred_speed[:, 0] / norm(way)
    present = (number >= 0)[..., None]
    middle = (place * present).sum(axis=2) / np.where(present.any(axis=2), present.sum(axis=2), np.nan)
    far = norm(middle - start.position[:, 0] - np.minimum(driven, 1.0)[..., None] * way)
    near = ((norm(place - middle[:, :, None]) < MIDDLE) & present[..., 0]).sum(axis=2)
    some = ~np.isnan(far).all(axis=0)
    first = np.nanargmin(far[:, some], axis=0), np.flatnonzero(some)
    walks = Walks(person, step * dt, step * len(start) + case, place[step, case, column], radius[step, case, column])
    return walks, [float(arrived), float(far[first].mean()), float(near[first].mean())]


def recorded(tracks: RecordedTracks) -> Walks:
    """Return recorded pedestrians as walks."""
    rows = tracks.frame / FRAME_STEP * ETH_UCY_DT, tracks.frame, tracks.position
    return Walks(tracks.pedestrian, *rows, np.full(len(tracks.frame), RECORDED_RADIUS))


def measure(walks: Walks) -> list[float]:
    """Return the figures of walks for the page, from accelerations to speeds."""
    velocities = list(_velocities(walks))
    change = np.concatenate([norm(np.diff(velocity, axis=0)) / ETH_UCY_DT for velocity in velocities])
    fast = [velocity * (norm(velocity) > MOVING)[:, None] for velocity in velocities]
    turns = sum(int(((each[1:] * each[:-1]).sum(axis=1) < 0.0).sum()) for each in fast)
    minutes = sum(map(len, velocities)) * ETH_UCY_DT / 60
    overlap, near = np.zeros((2, len(walks.time)))
    order = np.argsort(walks.moment, kind="stable")
    for rows in np.split(order, np.flatnonzero(np.diff(walks.moment[order])) + 1):
        apart = norm(walks.position[rows][:, None] - walks.position[rows]) + np.diag(np.full(len(rows), np.inf))
        overlap[rows] = (walks.radius[rows][:, None] + walks.radius[rows] - apart).max(axis=1)
        near[rows] = (apart < NEAR).sum(axis=1)
    same = np.diff(walks.person) == 0
    speed = norm(np.diff(walks.position, axis=0))[same] / np.diff(walks.time)[same]
    classes = np.digitize(near[:-1][same], DENSITIES[1:-1])
    speeds = [speed[classes == c].mean() if (classes == c).any() else np.nan for c in range(len(DENSITIES) - 1)]
    shares = [max(overlap.max(), 0.0), (overlap > BRUSHING).mean()]
    return [*np.quantile(change, [0.5, 0.9, 0.99, 1.0]), turns / minutes, *shares, *speeds]


def _velocities(walks: Walks) -> Iterator[Float[np.ndarray, "step 2"]]:
    """Yield the velocities in m/s of each walking pedestrian, in steps of `ETH_UCY_DT`."""
    for rows in np.split(np.arange(len(walks.time)), np.flatnonzero(np.diff(walks.person)) + 1):
        time, position = walks.time[rows], walks.position[rows]
        if norm(np.diff(position, axis=0)).sum() >= SHORTEST:
            at = np.arange(time[0], time[-1] + 1e-9, ETH_UCY_DT)
            yield np.diff([np.interp(at, time, xy) for xy in position.T], axis=1).T / ETH_UCY_DT


def row(name: str, numbers: list[float]) -> list[str]:
    """Return the row of a table, in the order of `HEADER`."""
    shown = (f"{100 * number:.2f} %" if column in (6, 10) else f"{number:.2f}" for column, number in enumerate(numbers))
    cells = ["-" if cell == "nan" else cell for cell in shown]
    return [name, *cells, *["-"] * (HEADER.count("|") - len(cells))]


def default_scenarios() -> list[str]:
    """Return the names of the scenarios of the suite, and of the maps."""
    suite = read_suite()
    maps = sorted(path.stem for path in (SCENARIOS / "maps").glob("*.toml"))
    return [*suite.ranked, *suite.stress, *suite.held_out, *maps]


@help_from_docstring
def motion(
    scenarios: Names = None, data: Path | None = None, cases: int = 100, pedestrians: list[str] | None = None
) -> None:
    """Measure accelerations, reversals, overlaps and speeds of pedestrians without a vehicle, and print a page.

    Args:
        scenarios: Scenarios, by name or file.
        data: The folder with the tracks of ETH/UCY, to measure these too.
        cases: Number of validation cases of each scenario.
        pedestrians: A pedestrian policy that replaces the policies of the scenarios. Repeat it for several.
    """
    rows = [row(path.stem, measure(recorded(read_tracks(path)))) for path in sorted(data.glob("*.txt"))] if data else []
    named = scenarios or default_scenarios()
    policies: Sequence[str | None] = pedestrians or [None]
    for name, policy in itertools.product(named, policies):
        walks, besides = simulate(load_scenario(name, pedestrians=policy), Cases("val", 0, cases))
        rows.append(row(f"{name}, {policy}" if policy else name, [*measure(walks), *besides]))
    asked = [*map(shlex.quote, scenarios or []), *["--data DIR"] * bool(data), *[f"--cases {cases}"] * (cases != 100)]
    asked += [f"--pedestrians {shlex.quote(policy)}" for policy in pedestrians or []]
    command = " ".join(["python studies/validity/motion.py", *asked])
    numbers = {"near": NEAR, "middle": MIDDLE, "brushing": BRUSHING, "radius": RECORDED_RADIUS, "shortest": SHORTEST}
    text = TEXT.read_text(encoding="utf-8").strip().format(cases=cases, dt=ETH_UCY_DT, moving=MOVING, **numbers)
    print("# How people move", printed_by(command), text, sep="\n\n", end="\n\n")
    print(markdown(HEADER.split("|"), rows))


if __name__ == "__main__":
    main(motion)
