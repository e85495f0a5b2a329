"""Trajectories, and the transforms between frames, on a plane."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from crowdbench import InputError

Times = Float[np.ndarray, "message"]
Poses = Float[np.ndarray, "message 3"]
"""x and y in metres, and the yaw in radians."""

LARGEST_OFFSET = 1.0
"""Seconds by which the stamps of a topic may differ from the times of recording, and may go back."""


class Trajectory(NamedTuple):
    """Poses over time.

    Attributes:
        time: Times of messages in seconds, ascending.
        pose: The pose at each time.
    """

    time: Times
    pose: Poses

    @classmethod
    def of(cls, rows: Sequence[tuple[float, float, float, float]], name: str) -> Trajectory:
        """Return the trajectory of messages in the order of their recording.

        Messages that were recorded in another order than they were stamped are sorted. Of several with one stamp, the
        last one counts.

        Args:
            rows: The stamp in seconds, x, y and yaw of each message.
            name: Name of the moving thing, for errors.

        Raises:
            InputError: A pose is not finite, or the stamps go back far.
        """
        table = np.array(rows).reshape(-1, 4)
        for k in np.flatnonzero(~np.isfinite(table).all(axis=1))[:1].tolist():
            raise InputError(
                f"{name} has no valid pose at {table[k, 0]:.2f} s (NaN, infinite, or a quaternion of zeros): cut the "
                "bag before or after it"
            )
        latest = np.maximum.accumulate(table[:, 0])
        for k in np.flatnonzero(latest - table[:, 0] > LARGEST_OFFSET)[:1].tolist():
            raise InputError(
                f"the stamps of {name} go back by {latest[k] - table[k, 0]:.2f} s at {latest[k]:.2f} s: record the bag "
                "with one clock (use_sim_time), and without a restart"
            )
        order = np.argsort(table[:, 0], kind="stable")
        is_last = np.append(np.diff(table[order, 0]) > 0.0, True) if len(table) else np.empty(0, bool)
        table = table[order[is_last]]
        return cls(table[:, 0], table[:, 1:])

    def at(self, time: Times, max_gap: float, name: str) -> Poses:
        """Return the poses at some times.

        Args:
            time: The times in seconds.
            max_gap: Largest time in seconds between the two messages around a time.
            name: Name of the moving frame, for errors.

        Raises:
            InputError: There is no message near a time.
        """
        after = np.clip(np.searchsorted(self.time, time - 1e-6), 0, len(self.time) - 1)
        before = np.maximum(after - (np.abs(self.time[after] - time) > 1e-6), 0)
        missing = np.maximum(time - self.time[before], self.time[after] - time)
        missing = np.maximum(missing, self.time[after] - self.time[before])
        for k in np.flatnonzero(missing > max_gap + 1e-6)[:1].tolist():
            raise InputError(
                f"there is no message of {name} for {missing[k]:.2f} s around {time[k]:.2f} s, but {max_gap:g} s "
                "(max_gap) may pass without one"
            )
        span = np.maximum(self.time[after] - self.time[before], 1e-12)
        share = np.clip((time - self.time[before]) / span, 0.0, 1.0)[:, None]
        change = self.pose[after] - self.pose[before]
        change[:, 2] = (change[:, 2] + np.pi) % (2.0 * np.pi) - np.pi
        return self.pose[before] + share * change


class Link(NamedTuple):
    """The transform of a frame in its parent.

    Attributes:
        child: The frame.
        parent: Its parent.
        is_static: True if it holds at all times.
        trajectory: Its poses in the parent.
    """

    child: str
    parent: str
    is_static: bool
    trajectory: Trajectory

    @property
    def name(self) -> str:
        """Its name in messages."""
        return f"the transform {self.parent} -> {self.child}"

    def at(self, time: Times, max_gap: float) -> Poses:
        """Return the poses of the frame in its parent."""
        if self.is_static:
            return np.repeat(self.trajectory.pose[-1:], len(time), axis=0)
        return self.trajectory.at(time, max_gap, self.name)


class Known(NamedTuple):
    """The part of a bag in which a frame has a pose in the fixed frame.

    Attributes:
        begin: Its first time in seconds.
        end: Its last time in seconds.
        first: The transform that begins last.
        last: The transform that ends first.
    """

    begin: float
    end: float
    first: str
    last: str


@dataclass(frozen=True)
class Transforms:
    """The transforms of a bag, with times in seconds.

    Attributes:
        topic: The topic of the transforms that move, for errors.
        links: The transforms of each frame; several if messages name several parents.
    """

    topic: str
    links: dict[str, list[Link]]

    @classmethod
    def of(cls, topic: str, moving: Iterable[tuple[float, Any]], static: Iterable[Any]) -> Transforms:
        """Return the transforms in messages `geometry_msgs/TransformStamped`.

        Args:
            topic: The topic of the transforms that move.
            moving: Their times in seconds, and the messages.
            static: The messages of static transforms. Their stamps have no meaning.
        """
        samples: dict[tuple[str, str, bool], list[tuple[float, float, float, float]]] = {}
        timed = [(time, one, False) for time, one in moving] + [(0.0, one, True) for one in static]
        for time, one, is_static in timed:
            key = frame_name(one.child_frame_id), frame_name(one.header.frame_id), is_static
            samples.setdefault(key, []).append((time, *pose_of(one.transform, "translation", "rotation")))
        links: dict[str, list[Link]] = {}
        for (child, parent, is_static), rows in samples.items():
            if is_static and (child, parent, False) in samples:
                continue  # a transform that moves is published on both topics
            trajectory = Trajectory.of(rows, f"the transform {parent} -> {child} in {topic}")
            links.setdefault(child, []).append(Link(child, parent, is_static, trajectory))
        return cls(topic, links)

    def path(self, frame: str, fixed: str) -> tuple[list[Link], list[Link]]:
        """Return the transforms from a frame, and from the fixed frame, up to their first common ancestor.

        Raises InputError if they have none, or if frames form a loop.
        """
        up, up_fixed = list(self._ancestors(frame)), list(self._ancestors(fixed))
        names, names_fixed = (
            [start, *(link.parent for link in chain)] for start, chain in ((frame, up), (fixed, up_fixed))
        )
        for k, name in enumerate(names):
            if name in names_fixed:
                return up[:k], up_fixed[: names_fixed.index(name)]
        raise InputError(
            f"{self.topic} has no transform from {frame!r} to {fixed!r} (fixed_frame): it ends at {names[-1]!r}"
        )

    def known(self, frame: str, fixed: str) -> Known:
        """Return when a frame has a pose in the fixed frame."""
        moving = [link for part in self.path(frame, fixed) for link in part if not link.is_static]
        if not moving:
            return Known(-math.inf, math.inf, "", "")
        first = max(moving, key=lambda link: link.trajectory.time[0])
        last = min(moving, key=lambda link: link.trajectory.time[-1])
        return Known(float(first.trajectory.time[0]), float(last.trajectory.time[-1]), first.name, last.name)

    def at(self, frame: str, fixed: str, time: Times, max_gap: float) -> Poses:
        """Return the poses of a frame in the fixed frame.

        Raises:
            InputError: No transforms connect the frames, or they have a gap.
        """
        up, up_fixed = self.path(frame, fixed)
        pose, base = np.zeros((len(time), 3)), np.zeros((len(time), 3))
        for link in up:
            pose = compose(link.at(time, max_gap), pose)
        for link in up_fixed:
            base = compose(link.at(time, max_gap), base)
        return compose(_inverse(base), pose) if up_fixed else pose

    def times(self, frame: str, fixed: str) -> Times:
        """Return the times in seconds of the transforms that move a frame in the fixed frame, from its nearest one."""
        for part in self.path(frame, fixed):
            for link in part:
                if not link.is_static:
                    return link.trajectory.time
        raise InputError(f"no transform in {self.topic} moves {frame!r} in {fixed!r} (fixed_frame)")

    def _ancestors(self, frame: str) -> Iterator[Link]:
        """Yield the transforms from a frame to its root."""
        passed = [frame]
        while links := self.links.get(passed[-1]):
            if len(links) > 1:
                parents = " and ".join(sorted({link.parent for link in links}))
                raise InputError(f"{self.topic} gives the frame {passed[-1]!r} several parents: {parents}")
            yield links[0]
            if links[0].parent in passed:
                raise InputError(f"the frames in {self.topic} form a loop: {' -> '.join([*passed, links[0].parent])}")
            passed.append(links[0].parent)


def frame_name(name: str) -> str:
    """Return the name of a frame without the leading slash of ROS 1."""
    return name.lstrip("/")


def compose(first: Poses, second: Poses) -> Poses:
    """Compose poses: `second` is given in moving frames with the poses `first`."""
    cos, sin = np.cos(first[:, 2]), np.sin(first[:, 2])
    x, y, yaw = second.T
    return np.stack([first[:, 0] + cos * x - sin * y, first[:, 1] + sin * x + cos * y, first[:, 2] + yaw], axis=1)


def _inverse(pose: Poses) -> Poses:
    """Return the poses of the fixed frame in moving frames."""
    x, y, yaw = pose.T
    cos, sin = np.cos(yaw), np.sin(yaw)
    return np.stack([-cos * x - sin * y, sin * x - cos * y, -yaw], axis=1)


def pose_of(message: Any, position: str = "position", rotation: str = "orientation") -> tuple[float, float, float]:
    """Return x, y and yaw of a message with a position and a quaternion; NaN for a quaternion of zeros."""
    at, q = getattr(message, position), getattr(message, rotation)
    if not (q.x or q.y or q.z or q.w):
        return at.x, at.y, math.nan
    yaw = np.arctan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))
    return at.x, at.y, float(yaw)
