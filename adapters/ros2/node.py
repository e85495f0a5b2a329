"""Drives a robot by a planner, through topics of ROS 2.

python adapters/ros2/node.py --planner mppi
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from jaxtyping import Float
from observation_messages import turned
from observer import READ, Observer, Robot
from recording import Recording
from topics import Topics, message

from crowdbench import Driver, InputError, Observation, load_planner
from crowdbench.cli import announce_compilation, assignments, exit_on_interrupt, main, say
from crowdbench.core import Holonomic, Unicycle
from crowdbench.utils import require_positive

POLL = 0.05
"""Seconds between two checks of the age of messages."""

DECISION_LIMIT = 60.0
"""Longest time in seconds of a decision in lock-step, and of the first one, in which a planner is compiled."""

DYNAMICS = {"holonomic": Holonomic, "unicycle": Unicycle}


def twist_of(command: Float[np.ndarray, "2"], obs: Observation) -> Any:
    """Return a command of the vehicle's dynamics as a message for `/cmd_vel`."""
    if obs.vehicle.dynamics.name == "holonomic":
        x, y = turned(command, -float(obs.vehicle.heading[0]))
        return message("geometry_msgs/Twist", linear=message("geometry_msgs/Vector3", x=x, y=y))
    speed, turn = command.tolist()
    linear, angular = message("geometry_msgs/Vector3", x=speed), message("geometry_msgs/Vector3", z=turn)
    return message("geometry_msgs/Twist", linear=linear, angular=angular)


def serve(driver: Driver, observer: Observer, topics: Topics, send: Callable[[Any], None], limit: float) -> None:
    """Answer observations with commands until an error or an interrupt, and stop the robot then.

    Args:
        driver: The driver of the planner.
        observer: Collects the messages.
        topics: The topics.
        send: Sends a command.
        limit: Age of a message in seconds above which the robot stops.
    """
    try:
        is_moving = False
        while True:
            topics.wait(POLL)
            for topic in READ:
                for content in topics.take(topic):
                    observer.add(topic, content)
            obs = observer.observation()
            if obs is not None:
                if observer.is_new:
                    driver.reset(np.zeros(1, np.int64))
                command = np.zeros(2) if observer.has_arrived(obs) else driver.decide(obs)[0]
                driver.decision_limit = DECISION_LIMIT if observer.lockstep else limit
            # Without lock-step, the first decision may take too long, because the planner is compiled.
            old = "" if observer.lockstep else observer.old(limit)
            if obs is not None and not old:
                send(twist_of(command, obs))
                is_moving = True
            elif is_moving and old:
                send(message("geometry_msgs/Twist"))
                say(f"stopped: no new message on {old} for {limit:g} s")
                is_moving = False
    finally:
        send(message("geometry_msgs/Twist"))


def drive(
    planner: Annotated[str, typer.Option()],
    option: list[str] | None = None,
    dynamics: str = "holonomic",
    radius: float = 0.3,
    speed: float = 1.0,
    dt: float = 0.25,
    limit: float = 1.0,
    dry: bool = False,
    record: Path | None = None,
) -> None:
    """Drive a robot by a planner. With `simulate.py`, the simulator states dynamics, radius, speed and dt.

    Args:
        dynamics: The robot's dynamics, holonomic or unicycle.
        radius: The robot's radius in metres.
        speed: The robot's preferred and largest speed in m/s.
        dt: Seconds from a command to the next.
        limit: Age in seconds of odometry or pedestrians above which the robot stops.
        dry: Print commands instead of sending them.
        record: Record a bag with all messages in this folder.
    """
    if dynamics not in DYNAMICS:
        raise InputError(f"dynamics {dynamics!r} is not one of {', '.join(DYNAMICS)}")
    for name, number in (("radius", radius), ("speed", speed), ("dt", dt), ("limit", limit)):
        require_positive(f"--{name}", number)
    announce_compilation()
    driver = Driver(load_planner(planner, assignments(option or [], "--option")), planner)
    observer = Observer(Robot(DYNAMICS[dynamics](), radius, speed, dt))
    topics = Topics(["cmd_vel"], READ)
    with Recording(record) if record else contextlib.nullcontext() as recording:

        def send(twist: Any) -> None:
            if dry:
                print(f"{twist.linear.x:.3f} {twist.linear.y:.3f} m/s, {twist.angular.z:.3f} rad/s", flush=True)
            else:
                topics.write("cmd_vel", twist)
            if recording:
                recording.add(observer.latest, twist)

        say(f"{planner} waits for /odom, /people and /goal_pose")
        with exit_on_interrupt("the robot has stopped"):
            serve(driver, observer, topics, send, limit)


if __name__ == "__main__":
    main(drive)
