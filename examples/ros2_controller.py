"""A controller on topics of ROS 2, without ROS and without crowdbench. It drives to the goal and away from pedestrians.

export CYCLONEDDS_URI=file://$PWD/adapters/ros2/loopback.xml
python examples/ros2_controller.py &
python adapters/ros2/simulate.py --name example --scenario groups_12 --cases 20 --out runs/example
"""

import math
import os
import time
from dataclasses import make_dataclass

from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, float64, int32, sequence, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

SPEED, NEAR, PUSH = 1.0, 1.2, 1.5
"""Speed in m/s, distance in metres at which pedestrians repel, and the strength of this in m/s at contact."""


def ros(name, /, **fields):
    """Return the DDS type of a message of ROS 2."""
    package, kind = name.split("/")
    name_in_dds = {"__idl_typename__": f"{package}.msg.dds_.{kind}_"}
    return make_dataclass(kind, fields.items(), bases=(IdlStruct,), namespace=name_in_dds)


XYZ = dict.fromkeys("xyz", float64)
Header = ros("std_msgs/Header", stamp=ros("builtin_interfaces/Time", sec=int32, nanosec=uint32), frame_id=str)
Point, Vector3 = ros("geometry_msgs/Point", **XYZ), ros("geometry_msgs/Vector3", **XYZ)
Pose = ros("geometry_msgs/Pose", position=Point, orientation=ros("geometry_msgs/Quaternion", **XYZ, w=float64))
Twist = ros("geometry_msgs/Twist", linear=Vector3, angular=Vector3)
Goal = ros("geometry_msgs/PoseStamped", header=Header, pose=Pose)
Posed = ros("geometry_msgs/PoseWithCovariance", pose=Pose, covariance=array[float64, 36])
Moving = ros("geometry_msgs/TwistWithCovariance", twist=Twist, covariance=array[float64, 36])
Odometry = ros("nav_msgs/Odometry", header=Header, child_frame_id=str, pose=Posed, twist=Moving)
Tags = {"reliability": float64, "tagnames": sequence[str], "tags": sequence[str]}
Person = ros("people_msgs/Person", name=str, position=Point, velocity=Point, **Tags)
People = ros("people_msgs/People", header=Header, people=sequence[Person])


def velocity(here, goal, people):
    """Return the velocity in m/s towards the goal and away from near pedestrians, in the frame of the map."""
    distance = math.hypot(goal.x - here.x, goal.y - here.y)
    vx, vy = (SPEED * (b - a) / max(distance, 0.3) for a, b in ((here.x, goal.x), (here.y, goal.y)))
    for person in people:
        dx, dy = here.x - person.position.x, here.y - person.position.y
        apart = math.hypot(dx, dy) or 1e-9
        push = PUSH * max(0.0, NEAR - apart) / NEAR / apart
        vx, vy = vx + push * dx, vy + push * dy
    slower = min(1.0, SPEED / max(math.hypot(vx, vy), 1e-9))
    return slower * vx, slower * vy


def main():
    """Answer each message of odometry with a command in the frame of the robot."""
    participant = DomainParticipant(int(os.environ.get("ROS_DOMAIN_ID", 0)))
    qos = Qos(Policy.Reliability.Reliable(duration(milliseconds=100)), Policy.History.KeepLast(10))
    types = {"odom": Odometry, "people": People, "goal_pose": Goal}
    readers = {
        name: DataReader(participant, Topic(participant, f"rt/{name}", kind), qos) for name, kind in types.items()
    }
    writer = DataWriter(participant, Topic(participant, "rt/cmd_vel", Twist), qos)
    latest, answered = {}, None
    while True:
        time.sleep(0.001)
        for name, reader in readers.items():
            for message in reader.take(N=10):
                if isinstance(message, types[name]):  # not the notice that a writer has ended
                    latest[name] = message
        stamps = [latest[name].header.stamp for name in ("odom", "people") if name in latest]
        if len(latest) < len(types) or stamps[0] != stamps[1] or stamps[0] == answered:
            continue
        answered, pose = stamps[0], latest["odom"].pose.pose
        vx, vy = velocity(pose.position, latest["goal_pose"].pose.position, latest["people"].people)
        heading = 2.0 * math.atan2(pose.orientation.z, pose.orientation.w)
        cos, sin = math.cos(heading), math.sin(heading)
        writer.write(Twist(Vector3(cos * vx + sin * vy, cos * vy - sin * vx, 0.0), Vector3(0.0, 0.0, 0.0)))


if __name__ == "__main__":
    main()
