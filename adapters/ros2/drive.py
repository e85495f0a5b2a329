"""Converts a robot's drives, one per bag, to a trace, on which all metrics of crowdbench can be computed."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from bag import Bag, read_bag
from drive_file import DriveFile
from jaxtyping import Float
from transforms import Trajectory

from crowdbench import InputError, Outcome, Rules, Trace
from crowdbench.core import Unicycle, norm, pad_arrays
from crowdbench.scenario import read_obstacles
from crowdbench.sim import wall_gap_in_step


class Drive(NamedTuple):
    """The states of one drive at multiples of dt, and its outcome.

    Attributes:
        robot: x, y and yaw at each state.
        people: Positions of pedestrians at each state; NaN where they are not observed.
        goal: Goal of the robot in metres.
        walls: The obstacles of the drive.
        gap: Smallest distance in metres between the rims of robot and pedestrians in each step.
        wall_gap: Smallest distance in metres to obstacles in each step.
        outcome: An `Outcome`.
    """

    robot: Float[np.ndarray, "time 3"]
    people: Float[np.ndarray, "time pedestrian 2"]
    goal: Float[np.ndarray, "2"]
    walls: Float[np.ndarray, "polygon corner 2"]
    gap: Float[np.ndarray, "step"]
    wall_gap: Float[np.ndarray, "step"]
    outcome: Outcome


def trace_of(drive: DriveFile) -> tuple[Trace, list[str]]:
    """Read the bags of a drive file.

    Returns:
        The trace, with case 0 for the first bag, and notes on decisions made while reading.

    Raises:
        InputError: A bag cannot be read or used.
    """
    of_all = read_obstacles(Path(drive.map)) if drive.map else []
    drives, notes = [], []
    for name in drive.bags:
        bag = read_bag(Path(name), drive)
        polygons = [np.array(polygon) for polygon in of_all + bag.walls]
        walls = pad_arrays(polygons, np.nan) if polygons else np.empty((0, 0, 2))
        drives.append(_drive(bag, drive, walls, name))
        notes += [f"{name}: {note}" for note in bag.notes]
    return _join(drives, drive), notes


def _drive(bag: Bag, drive: DriveFile, walls: Float[np.ndarray, "polygon corner 2"], name: str) -> Drive:
    """Return one drive, from the first moment at which robot and pedestrians are observed to its end."""
    dt, vehicle = drive.dt, drive.vehicle
    watched = bag.observed if len(bag.observed) else bag.robot.time
    begin, end = max(bag.robot.time[0], watched[0]), min(bag.robot.time[-1], watched[-1])
    time = begin + dt * np.arange(int(np.floor((end - begin) / dt + 1e-6)) + 1)
    if len(time) < 2:
        raise InputError(f"{name}: robot and pedestrians are observed together for less than one step of {dt:g} s")
    silence = Trajectory(watched, np.zeros((len(watched), 3)))
    silence.at(time, drive.max_gap, drive.people.topic)
    robot = bag.robot.at(time, drive.max_gap, "the robot")
    people = np.full((len(time), len(bag.people), 2), np.nan)
    for index, track in enumerate(bag.people):
        here = (time >= track.time[0] - 1e-6) & (time <= track.time[-1] + 1e-6)
        people[here, index] = track.at(time[here], drive.max_gap, "a pedestrian")[:, :2]
    reach = vehicle.radius + drive.people.radius
    gap = _gaps(robot[:, :2], people).min(axis=1, initial=np.inf) - reach
    moved = np.diff(robot[:, :2], axis=0)
    wall_gap = np.array(
        [wall_gap_in_step(*at, *step, vehicle.radius, walls) for at, step in zip(robot[:-1, :2], moved, strict=True)]
    )
    arrived = norm(robot[1:, :2] - bag.goal) < vehicle.goal_tolerance
    ends = {Outcome.COLLISION: gap < 0.0, Outcome.WALL_COLLISION: wall_gap < 0.0, Outcome.SUCCESS: arrived}
    first = {outcome: int(flags.argmax()) for outcome, flags in ends.items() if flags.any()}
    outcome = min(first, key=first.__getitem__, default=Outcome.TIMEOUT)
    last = first.get(outcome, len(gap) - 1) + 1
    return Drive(robot[: last + 1], people[: last + 1], bag.goal, walls, gap[:last], wall_gap[:last], outcome)


def _gaps(
    robot: Float[np.ndarray, "time 2"], people: Float[np.ndarray, "time pedestrian 2"]
) -> Float[np.ndarray, "step pedestrian"]:
    """Return the smallest distance between centres in each step, for straight motion within a step; see `swept`."""
    apart = people - robot[:, None]
    start, change = apart[:-1], np.diff(apart, axis=0)
    squared = np.maximum((change**2).sum(axis=2), 1e-12)
    share = np.clip(-(start * change).sum(axis=2) / squared, 0.0, 1.0)
    return np.nan_to_num(norm(start + share[..., None] * change), nan=np.inf)


def _join(drives: list[Drive], drive: DriveFile) -> Trace:
    """Return the drives as one trace."""
    steps = np.array([len(each.gap) for each in drives])
    most = int(steps.max())
    # The episode of the longest drive times out at its last step, see `Rules.time_limit`.
    rules = Rules(
        dt=drive.dt,
        time_limit=1.0 + (most - 1) * drive.dt,
        visible=True,
        dynamics=Unicycle(),
        goal_tolerance=drive.vehicle.goal_tolerance,
    )
    everybody = [np.concatenate([each.robot[:, None, :2], each.people], axis=1) for each in drives]
    position = pad_arrays(everybody, np.nan, most + 1)
    shape = position.shape[:3]
    heading = pad_arrays([each.robot[:, 2] for each in drives], np.nan, most + 1)
    gap, wall_gap = (pad_arrays([getattr(each, name) for each in drives], np.nan) for name in ("gap", "wall_gap"))
    velocity = np.diff(position, axis=1, prepend=position[:, :1]) / drive.dt
    velocity[:, 0] = velocity[:, 1]  # the velocity before the first step is unknown
    velocity = np.where(np.isnan(velocity) & np.isfinite(position), 0.0, velocity)
    present = np.isfinite(position[..., 0])
    present[:, :, 0] = True
    goal = np.nan_to_num(position[:, -1:].repeat(shape[1], axis=1))
    goal[:, :, 0] = np.array([each.goal for each in drives])[:, None]
    radius = np.full(shape, drive.people.radius)
    radius[:, :, 0] = drive.vehicle.radius
    person = np.broadcast_to(np.arange(shape[2] - 1), (*shape[:2], shape[2] - 1))
    return Trace(
        split="test",
        case=np.arange(len(drives)),
        outcome=np.array([int(each.outcome) for each in drives]),
        steps=steps,
        position=position,
        velocity=velocity,
        heading=heading,
        command=velocity[:, 1:, 0],
        gap=gap,
        wall_gap=wall_gap,
        goal=goal,
        radius=radius,
        preferred_speed=np.full((len(drives), shape[2]), drive.vehicle.preferred_speed),
        present=present,
        person=person.copy(),
        seen=present[:, :, 1:],
        route=np.empty((len(drives), 0, 2)),
        obstacles=pad_arrays([each.walls for each in drives], np.nan),
        rules=rules,
    )
