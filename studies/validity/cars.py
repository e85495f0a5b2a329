"""People beside cars, as they were recorded, and as policies move the same people along the same ways (DUT).

A window starts every second, and takes four. In it the cars drive as they were recorded, and the people who are there
start where they were, with the velocity that they had, and go the ways that they went, at their own mean speed. Where
they are after four seconds is compared with where they were, among people for whom a car was as near, and as soon in
their way: see `energy`.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from crowdbench.catalog import load_scenario
from crowdbench.core.geometry import norm
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.tracks.excerpts import CarMotion, Excerpt, car_discs, cut_excerpt, people_of, times_of
from crowdbench.scenario.tracks.scenes import Recording, load_scene
from crowdbench.sim import simulator

SCENE, SCENARIO = "dut", "dut_reactive"
SECONDS, EVERY = 4.0, 1.0
"""The length of a window, and the time from the start of one to that of the next, in seconds."""

DT = 0.25
"""The length of a step, in seconds."""

RADIUS = 0.2
"""Of people, in metres."""

GAPS = (0.0, 2.0, 4.0, 8.0)
"""Bounds of the gap to the nearest car at the start, in metres; who is farther from all cars is left out."""

CONTACTS = (0.0, 2.0, 4.0, np.inf)
"""Bounds of the time to contact at constant velocities, in seconds; the last group are those who touch no car."""

CLOSE = 1.0
"""A car is in somebody's way if its rim comes so near, in metres."""

_FAR = np.array([1000.0, 1000.0])
"""Where the vehicle stands, which has no part in this, in metres."""

Vectors = Float[np.ndarray, "person 2"]

Start = tuple[int, Recording, float]
"""The number of a clip, the clip, and when a window starts in it, in seconds."""


@dataclasses.dataclass(frozen=True)
class Windows:
    """Windows of one half of all clips, and the people in them who are there to the end.

    Attributes:
        excerpts: The windows.
        clip: The clip of each.
        window: The window of each person.
        person: Its number in that window.
        group: Its group by gap and time to contact.
        forward: The direction in which it walks at the start.
        away: The direction across, on which the nearest car is not.
        moved: Its displacement in metres, forward and away.
    """

    excerpts: list[Excerpt]
    clip: Int[np.ndarray, "window"]
    window: Int[np.ndarray, "person"]
    person: Int[np.ndarray, "person"]
    group: Int[np.ndarray, "person"]
    forward: Vectors
    away: Vectors
    moved: Vectors

    @property
    def clips(self) -> Int[np.ndarray, "person"]:
        """The clip of each person."""
        return self.clip[self.window]

    def turn(self, vector: Vectors) -> Vectors:
        """Vectors of people, forward and away."""
        return np.stack([(vector * self.forward).sum(axis=1), (vector * self.away).sum(axis=1)], axis=1)


def cut_halves(data: Path) -> tuple[Windows, Windows]:
    """The windows of the first halves of all clips, and of the second ones.

    Raises InputError where the folder lacks the clips of DUT.
    """
    recordings = load_scene(SCENE, data, {}).recordings
    first: list[Start] = []
    second: list[Start] = []
    for clip, recording in enumerate(recordings):
        times = times_of(recording.tracks)
        begin, end = float(times.min()), float(times.max())
        middle = (begin + end) / 2.0
        for half, start, stop in ((first, begin, middle), (second, middle, end)):
            half += [(clip, recording, at) for at in np.arange(start, stop - SECONDS + 1e-6, EVERY).tolist()]
    return _people(first), _people(second)


def _people(starts: list[Start]) -> Windows:
    """Cut windows, and find who is in them from the start to the end near a car."""
    cut = [(clip, excerpt) for clip, recording, at in starts if (excerpt := _cut(recording, at)) is not None]
    rows = [(number, *row) for number, (_, excerpt) in enumerate(cut) for row in _near_cars(excerpt)]
    excerpts, clips = [excerpt for _, excerpt in cut], np.array([clip for clip, _ in cut])
    found = Windows(excerpts, clips, *map(np.array, zip(*rows, strict=True)))
    return dataclasses.replace(found, moved=found.turn(found.moved))


def _cut(recording: Recording, start: float) -> Excerpt | None:
    """The window that starts at a time in seconds; None where nobody is there."""
    times = start + DT * np.arange(-1, round(SECONDS / DT) + 1)
    people = [each for each in people_of(recording.tracks) if each.is_there(times[1:]).any()]
    cars = [disc for car in recording.cars for disc in car_discs(car) if disc.is_there(times[1:]).any()]
    still = CarMotion(_FAR, _FAR + 100.0, 0.0, 0.0)
    return cut_excerpt(recording.tracks.name, 0, times, [*people, *cars], still) if people and cars else None


def _near_cars(excerpt: Excerpt) -> Iterator[tuple[int, int, Any, Any, Any]]:
    """The people of a window who are there to its end, and near a car at its start."""
    is_car, there = ~np.isnan(excerpt.radius), np.isfinite(excerpt.track[..., 0])
    cars = np.flatnonzero(is_car & there[0])
    if not len(cars):
        return
    for person in np.flatnonzero(~is_car & there.all(axis=0)).tolist():
        place, velocity = excerpt.track[0, person], excerpt.velocity[person]
        to_car, closing = excerpt.track[0, cars] - place, excerpt.velocity[cars] - velocity
        reach = excerpt.radius[cars] + RADIUS
        gap = norm(to_car) - reach
        group = _group(float(gap.min()), _contact(to_car, closing, reach + CLOSE))
        heading = velocity if norm(velocity) > 0.2 else excerpt.goal[person] - place
        if group is None or norm(heading) < 1e-6:
            continue
        forward = heading / norm(heading)
        across = np.array([-forward[1], forward[0]])
        away = across if across @ to_car[gap.argmin()] <= 0.0 else -across
        yield person, group, forward, away, excerpt.track[-1, person] - place


def _contact(
    to_car: Float[np.ndarray, "car 2"], closing: Float[np.ndarray, "car 2"], reach: Float[np.ndarray, "car"]
) -> float:
    """The time in seconds until somebody touches a car where all keep their velocities; infinite if never."""
    a, b = (closing**2).sum(axis=1), (to_car * closing).sum(axis=1)
    c = (to_car**2).sum(axis=1) - reach**2
    root = b**2 - a * c
    meets = (root > 0.0) & (b < 0.0) & (a > 0.0)
    time = np.where(meets, (-b - np.sqrt(np.maximum(root, 0.0))) / np.where(a > 0.0, a, 1.0), np.inf)
    return float(np.where(c <= 0.0, 0.0, time).min())


def _group(gap: float, contact: float) -> int | None:
    """The number of the group by gap and time to contact; None for who is far from cars."""
    if gap >= GAPS[-1]:
        return None
    near = max(int(np.searchsorted(GAPS, gap, side="right")) - 1, 0)
    soon = min(int(np.searchsorted(CONTACTS, contact, side="right")) - 1, len(CONTACTS) - 2)
    return near * (len(CONTACTS) - 1) + soon


def group_names() -> list[str]:
    """What the groups are, in their order."""
    gaps = [f"{low:g} to {high:g} m" for low, high in itertools.pairwise(GAPS)]
    soon = [f"in {low:g} to {high:g} s" for low, high in itertools.pairwise(CONTACTS[:-1])]
    return [f"{gap}, {when}" for gap in gaps for when in (*soon, "none in 4 s")]


def move(windows: Windows, policy: str, parameters: Mapping[str, Any], data: Path) -> Vectors:
    """Where a policy moves the people of windows, forward and away, in metres.

    Args:
        windows: The windows.
        policy: The pedestrian policy.
        parameters: Its parameters, by name.
        data: The folder with the clips of DUT.

    Raises:
        InputError: There is no such policy or parameter, or the policy fails.
    """
    changes = {
        "dt": DT,
        "time_limit": SECONDS + 1.0 - DT,
        "vehicle.visible": False,
        "pedestrians.attention": None,
        "pedestrians.policy": policy,
        "pedestrians.radius": RADIUS,
    }
    named = {f"pedestrians.{policy}.{name}": value for name, value in parameters.items()}
    base = load_scenario(SCENARIO, changes | named, data=data)
    tracks = base.tracks
    assert tracks is not None  # the scenario has recorded people
    splits = {"train": [], "val": [], "test": windows.excerpts}
    starts = dataclasses.replace(tracks, windows=splits)
    number = (1, max(len(excerpt.radius) for excerpt in windows.excerpts))
    scenario = dataclasses.replace(base, starts=starts, crowd=dataclasses.replace(base.crowd, number=number))
    world = scenario.worlds(Cases("test", 0, len(windows.excerpts)))
    before = world.position[windows.window, 1 + windows.person]
    for _ in range(scenario.rules.max_steps):
        world = simulator.walk(world, simulator.crowd_velocities(world, scenario.policies), scenario.post_step_rule)
    return windows.turn(world.position[windows.window, 1 + windows.person] - before)


def keep_on(windows: Windows) -> Vectors:
    """Where people would be who kept their velocity."""
    start = np.array([windows.excerpts[w].velocity[p] for w, p in zip(windows.window, windows.person, strict=True)])
    return windows.turn(SECONDS * start)
