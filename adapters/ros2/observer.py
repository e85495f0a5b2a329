"""Observations of a planner from topics of ROS 2: of a robot, or of `simulate.py`."""

from __future__ import annotations

import dataclasses
import json
import math
import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from bag import grid_obstacles
from jaxtyping import Float
from observation_messages import RADIUS, SECOND, nanoseconds_of, turned

from crowdbench import InputError, Observation, Rules
from crowdbench.core import HISTORY, Dynamics, Pedestrians, Vehicle, norm, pad_arrays

READ = ("odom", "people", "scan", "goal_pose", "map", "tf", "tf_static", "crowdbench/state")

FARTHEST = 1000.0
"""Range in metres of a scan that states none."""


class Pose(NamedTuple):
    """A pose in metres and radians."""

    x: float
    y: float
    yaw: float

    def of(self, inner: Pose) -> Pose:
        """Return the pose of something whose pose in this frame is given."""
        x, y = turned((inner.x, inner.y), self.yaw)
        return Pose(self.x + x, self.y + y, self.yaw + inner.yaw)

    def inverse(self) -> Pose:
        """Return the pose of the outer frame in this one."""
        x, y = turned((-self.x, -self.y), -self.yaw)
        return Pose(x, y, -self.yaw)


def pose_of(at: Any, q: Any) -> Pose:
    """Return a pose from a position and a quaternion."""
    return Pose(at.x, at.y, math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z)))


@dataclass(frozen=True)
class Robot:
    """Properties of a robot, if no simulator states them.

    Attributes:
        dynamics: Its dynamics.
        radius: Radius in metres.
        speed: Preferred and largest speed in m/s.
        dt: Seconds from a command to the next.
        people_radius: Radius of pedestrians in metres.
    """

    dynamics: Dynamics
    radius: float
    speed: float
    dt: float
    people_radius: float = 0.3


class Observer:
    """Observer of a robot and of the pedestrians around it, in the frame of the goal.

    Attributes:
        latest: The last message of each topic.
        arrived: The time at which it arrived, in seconds of `time.monotonic`.
        is_new: True if the last observation is the first one of an episode.

    Args:
        robot: Properties of the robot.
    """

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self.latest: dict[str, Any] = {}
        self.arrived: dict[str, float] = {}
        self.frames: dict[str, tuple[str, Pose]] = {}
        self.state: Mapping[str, Any] | None = None
        self.obstacles: Float[np.ndarray, "polygon corner 2"] = np.empty((0, 0, 2))
        self.past: dict[str, deque[tuple[float, float]]] = {}
        self.episode: Any = None
        self.step, self.planned = 0, 0
        self.is_new = False

    @property
    def lockstep(self) -> bool:
        """True if a simulator waits for each command."""
        return self.state is not None and bool(self.state["lockstep"])

    def add(self, topic: str, message: Any) -> None:
        """Add a message that has arrived."""
        self.latest[topic], self.arrived[topic] = message, time.monotonic()
        if topic in ("tf", "tf_static"):
            for link in message.transforms:
                pose = pose_of(link.transform.translation, link.transform.rotation)
                self.frames[_frame(link.child_frame_id)] = _frame(link.header.frame_id), pose
        elif topic == "crowdbench/state":
            self.state = json.loads(message.data)

    def old(self, limit: float) -> str:
        """Return the topics whose last message is older than a limit in seconds, as text; empty if there are none."""
        now = time.monotonic()
        return " and ".join(
            f"/{topic}" for topic in ("odom", "people") if now - self.arrived.get(topic, -math.inf) > limit
        )

    def has_arrived(self, obs: Observation) -> bool:
        """Return whether the robot is at its goal. A simulator ends the episode itself."""
        return self.state is None and bool(norm(obs.vehicle.goal - obs.vehicle.position)[0] < obs.vehicle.radius[0])

    def observation(self) -> Observation | None:
        """Return the observation of the next step, or None before its messages have arrived.

        Raises InputError if there is no transform between two frames.
        """
        if not {"odom", "people", "goal_pose"} <= self.latest.keys():
            return None
        state, goal = self.state, self.latest["goal_pose"]
        now = nanoseconds_of(self.latest["odom"].header.stamp)
        if state is None:
            episode, dt = nanoseconds_of(goal.header.stamp), self.robot.dt
            is_due = episode != self.episode or now - self.planned >= (dt - 1e-3) * SECOND or now < self.planned
        else:
            episode, dt = state["start"], state["rules"]["dt"]
            needed = ["odom", "people", *["scan"] * ("lidar" in state["rules"].get("sensor", {}))]
            stamps = {nanoseconds_of(self.latest[topic].header.stamp) for topic in needed if topic in self.latest}
            of_case = ["goal_pose", *["map"] * state["map"]]
            starts = {nanoseconds_of(self.latest[topic].header.stamp) for topic in of_case if topic in self.latest}
            is_whole = starts == {episode} and stamps == {state["stamp"]}
            is_due = is_whole and state["stamp"] != self.planned
        if not is_due:
            return None
        self.is_new = episode != self.episode
        if self.is_new:
            self.episode, self.step, self.past = episode, -1, {}
            self.obstacles = self._obstacles()
        self.planned = now
        self._check_numbers()
        self.step = self.step + 1 if state is None else state["step"]
        return self._observe(dt)

    def _check_numbers(self) -> None:
        """Raise InputError if a position or a velocity is not finite."""
        odom, goal = self.latest["odom"], self.latest["goal_pose"]
        points = {
            "odom": [odom.pose.pose.position, odom.pose.pose.orientation, odom.twist.twist.linear],
            "people": [point for one in self.latest["people"].people for point in (one.position, one.velocity)],
            "goal_pose": [goal.pose.position],
        }
        for topic, values in points.items():
            if not all(math.isfinite(number) for point in values for number in vars(point).values()):
                raise InputError(f"a message of /{topic} has a number that is not finite")

    def _observe(self, dt: float) -> Observation:
        """Return the observation of the last messages."""
        state, robot = self.state or {}, self.robot
        rules = Rules.of_table(state["rules"]) if state else self._rules(dt)
        odom, goal = self.latest["odom"], self.latest["goal_pose"]
        pose = self._in_goal_frame(odom.header.frame_id).of(
            pose_of(odom.pose.pose.position, odom.pose.pose.orientation)
        )
        twist, target = odom.twist.twist, goal.pose.position
        route = np.reshape(state.get("route", []), (-1, 2)).astype(np.float64)
        vehicle = Vehicle(
            position=np.array([pose[:2]]),
            velocity=np.array([turned((twist.linear.x, twist.linear.y), pose.yaw)]),
            heading=np.array([pose.yaw]),
            angular_speed=np.array([twist.angular.z]),
            goal=np.array([[target.x, target.y]]),
            route=route[None],
            waypoint=np.array([state.get("waypoint", 0)]),
            radius=np.array([state.get("radius", robot.radius)]),
            preferred_speed=np.array([state.get("preferred_speed", robot.speed)]),
            dynamics=rules.dynamics,
            actuation=rules.actuation,
            goal_tolerance=rules.goal_tolerance,
            body=rules.body,
        )
        return Observation(
            vehicle,
            self._pedestrians(),
            self.obstacles[None],
            row=np.zeros(1, np.int64),
            noise_key=np.array([state.get("noise_key", 0)], np.uint64),
            step=np.array([self.step]),
            dt=rules.dt,
            sensor=rules.sensor,
            lidar=self._lidar(rules),
        )

    def _rules(self, dt: float) -> Rules:
        """Return the rules of a robot, with a lidar if there are scans."""
        table: dict[str, Any] = {"dt": dt}
        if "scan" in self.latest:
            scan = self.latest["scan"]
            table["sensor"] = {"lidar": {"beams": len(scan.ranges), "range": min(scan.range_max, FARTHEST)}}
        return dataclasses.replace(Rules.of_table(table), dynamics=self.robot.dynamics)

    def _pedestrians(self) -> Pedestrians:
        """Return the pedestrians of the last message, with the positions of earlier ones."""
        message = self.latest["people"]
        frame = self._in_goal_frame(message.header.frame_id)
        velocity, radius, past = [], [], {}
        for person in message.people:
            at = frame.of(Pose(person.position.x, person.position.y, 0.0))
            past[person.name] = self.past.get(person.name, deque(maxlen=HISTORY))
            past[person.name].append((at.x, at.y))
            velocity.append(turned((person.velocity.x, person.velocity.y), frame.yaw))
            tags = dict(zip(person.tagnames, person.tags, strict=False))
            radius.append(float(tags.get(RADIUS, self.robot.people_radius)))
        self.past, people = past, len(past)
        history = [[track[0]] * (HISTORY - len(track)) + [*track] for track in past.values()]
        places = np.reshape(np.array(history, np.float64), (people, HISTORY, 2)).swapaxes(0, 1)
        return Pedestrians(
            position=places[None, -1].copy(),
            velocity=np.reshape(np.array(velocity, np.float64), (1, people, 2)),
            radius=np.array([radius], np.float64),
            seen=np.ones((1, people), bool),
            history=places[None].copy(),
            observed=np.array([[len(track) for track in past.values()]], np.int64).reshape(1, people),
            age=np.zeros((1, people)),
        )

    def _obstacles(self) -> Float[np.ndarray, "polygon corner 2"]:
        """Return the obstacles of the map in the frame of the goal; none without a map."""
        if "map" not in self.latest:
            return np.empty((0, 0, 2))
        grid = self.latest["map"]
        frame = self._in_goal_frame(grid.header.frame_id)
        polygons = grid_obstacles(grid, lambda pose: tuple(frame.of(Pose(*pose))))
        return pad_arrays([np.array(corners) for corners in polygons], np.nan)

    def _lidar(self, rules: Rules) -> Float[np.ndarray, "1 beam"] | None:
        """Return the last scan, with the first beam along the heading; None without a lidar."""
        if rules.sensor.lidar is None:
            return None
        scan = self.latest["scan"]
        ranges = np.array(scan.ranges, np.float64)
        if abs(len(ranges) * abs(scan.angle_increment) - 2.0 * math.pi) > 1.5 * abs(scan.angle_increment):
            raise InputError("/scan is no whole ring of beams, which a lidar of crowdbench is")
        ranges = np.roll(ranges, round(scan.angle_min / scan.angle_increment))
        if scan.angle_increment < 0.0:
            ranges = np.roll(ranges[::-1], 1)
        far = rules.sensor.lidar.range
        return np.where(np.isfinite(ranges), np.minimum(ranges, far), far)[None]

    def _in_goal_frame(self, frame: str) -> Pose:
        """Return the pose of a frame in the frame of the goal."""
        goal = self.latest["goal_pose"].header.frame_id
        (root, pose), (end, inner) = self._root(_frame(goal)), self._root(_frame(frame))
        if root != end:
            raise InputError(f"/tf has no transform from {frame!r} to {goal!r}, the frame of the goal")
        return pose.inverse().of(inner)

    def _root(self, frame: str) -> tuple[str, Pose]:
        """Return the root of the tree of frames above a frame, and the pose in it."""
        pose = Pose(0.0, 0.0, 0.0)
        for _ in range(len(self.frames)):
            if frame not in self.frames:
                break
            frame, link = self.frames[frame]
            pose = link.of(pose)
        return frame, pose


def _frame(name: str) -> str:
    return name.lstrip("/")
