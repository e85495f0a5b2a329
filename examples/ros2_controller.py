"""A controller on topics of ROS 2, without ROS and crowdbench. It drives to the goal, and away from near pedestrians.

docs/robots.md has the commands. The types of the messages are those that `simulate.py` announces.
"""

import os

from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication, BuiltinTopicDcpsSubscription
from cyclonedds.domain import DomainParticipant
from cyclonedds.dynamic import get_types_for_typeid
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

SPEED, NEAR, PUSH = 1.0, 1.2, 1.5  # m/s; distance in metres at which pedestrians repel; m/s of this at contact
participant = DomainParticipant(int(os.environ.get("ROS_DOMAIN_ID", "0")))


def find_topic(name, endpoints):
    """Return a topic that another program writes or reads, and the types of its messages."""
    for end in BuiltinDataReader(participant, endpoints).take_iter(timeout=duration(minutes=1)):
        if end.topic_name == f"rt/{name}":
            kind, types = get_types_for_typeid(participant, end.type_id, duration(seconds=5))
            return Topic(participant, end.topic_name, kind), types
    raise SystemExit(f"no program has announced /{name} for a minute: start adapters/ros2/simulate.py")


goals, people, odometry = (
    DataReader(participant, find_topic(name, BuiltinTopicDcpsPublication)[0])
    for name in ("goal_pose", "people", "odom")
)
commands, types = find_topic("cmd_vel", BuiltinTopicDcpsSubscription)
Twist, Vector3 = types["Twist_"], types["Vector3_"]
writer = DataWriter(participant, commands)
for odom in odometry.take_iter(timeout=duration(minutes=1)):
    here, turn = odom.pose.pose.position, odom.pose.pose.orientation
    goal = goals.read()[-1].pose.position
    velocity = complex(goal.x - here.x, goal.y - here.y)
    velocity *= SPEED / max(abs(velocity), 0.3)
    for person in people.read()[-1].people:
        away = complex(here.x - person.position.x, here.y - person.position.y)
        velocity += PUSH * max(0.0, 1.0 - abs(away) / NEAR) * away / max(abs(away), 1e-9)
    velocity *= min(1.0, SPEED / max(abs(velocity), 1e-9)) * complex(turn.w, -turn.z) ** 2  # in the frame of the robot
    writer.write(Twist(Vector3(velocity.real, velocity.imag, 0.0), Vector3(0.0, 0.0, 0.0)))
