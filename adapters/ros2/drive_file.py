"""The TOML file that describes the topics of a robot's bags."""

from __future__ import annotations

import functools
from pathlib import Path

from pydantic import Field

from crowdbench import InputError
from crowdbench.utils import Location, TomlTable, number, parse_table, read_text, read_toml, table


class RobotTable(TomlTable):
    """`[vehicle]`: the robot.

    Attributes:
        odometry: Topic of `nav_msgs/Odometry`, `geometry_msgs/PoseStamped` or `PoseWithCovarianceStamped`; empty for
            the poses of `frame` in the transforms.
        frame: Frame of the robot in the transforms.
        offset: Added to the stamps of the odometry in seconds.
        radius: In metres.
        preferred_speed: Largest intended speed in m/s.
        goal: x and y of its goal in metres, in the fixed frame; empty to use `goal_topic`.
        goal_topic: Topic of `geometry_msgs/PoseStamped` with one goal in each bag.
        goal_tolerance: Distance in metres to its goal below which it has arrived.
    """

    odometry: str = Field(default="", description="the name of a topic")
    frame: str = Field(default="base_link", description="the name of a frame")
    offset: float = number(0.0, least=-1e9, below=1e9)
    radius: float = number(0.3, above=0.0, below=10.0)
    preferred_speed: float = number(1.0, above=0.0, below=50.0)
    goal: list[float] = Field(default=[], max_length=2, description="x and y in metres, as in [8.0, 0.0]")
    goal_topic: str = Field(default="", description="the name of a topic")
    goal_tolerance: float = number(0.3, above=0.0, below=10.0)


class PeopleTable(TomlTable):
    """`[people]`: the tracked pedestrians.

    Attributes:
        topic: Topic of messages with a list of pedestrians.
        list: Field with the list; empty for that of a known type, see `pedestrians.FIELDS`.
        position: Field of a pedestrian with x and y in metres, dotted: `pose.pose.position`.
        id: Field of a pedestrian with its identity. Without one, identities are guessed from positions.
        frame: Frame of the positions; empty for the one in the message's header.
        offset: Added to the stamps of the messages in seconds.
        radius: Radius of each pedestrian in metres.
    """

    topic: str = Field(default="/people", description="the name of a topic")
    list: str = Field(default="", description="the name of a field")
    position: str = Field(default="", description="the name of a field")
    id: str = Field(default="", description="the name of a field")
    frame: str = Field(default="", description="the name of a frame")
    offset: float = number(0.0, least=-1e9, below=1e9)
    radius: float = number(0.3, above=0.0, below=10.0)


class DriveFile(TomlTable):
    """The whole file. Paths are relative to it.

    Attributes:
        planner: Name of the planner that drove the robot.
        bags: The bags, each of which is a case.
        fixed_frame: Frame in which everything is scored.
        tf: Topic of the transforms. Static ones are on the topic with `_static` after this name.
        dt: Length of a step in seconds.
        max_gap: Longest time in seconds without a message over which poses are interpolated.
        map: File `map.yaml` of `map_server`; empty for the map of `map_topic`, or for no obstacles.
        map_topic: Topic of `nav_msgs/OccupancyGrid`, whose last message counts.
        messages: Files `PACKAGE/msg/NAME.msg` with the definitions of messages that the bags do not hold.
        vehicle: The robot.
        people: The pedestrians.
    """

    planner: str = Field(description="the name of a planner")
    bags: list[str] = Field(min_length=1, description="a list of bags, one at least")
    fixed_frame: str = Field(default="map", description="the name of a frame")
    tf: str = Field(default="/tf", description="the name of a topic")
    dt: float = number(0.1, above=0.0, below=1.0)
    max_gap: float = number(0.5, above=0.0, below=10.0)
    map: str = Field(default="", description="the path of a file")
    map_topic: str = Field(default="", description="the name of a topic")
    messages: list[str] = Field(default=[], description="a list of files .msg")
    vehicle: RobotTable = table("vehicle")
    people: PeopleTable = table("people")

    @functools.cached_property
    def message_definitions(self) -> dict[str, str]:
        """The definitions in the files `messages`, by the type of the message."""
        paths = list(map(Path, self.messages))
        for path in paths:
            if not path.is_file() or len(path.parts) < 3:
                raise InputError(f"there is no file {path} of the form PACKAGE/msg/NAME.msg, which `messages` names")
        return {f"{path.parts[-3]}/msg/{path.stem}": read_text(path) for path in paths}


def read_drive_file(path: Path) -> DriveFile:
    """Read the file; paths in it become absolute. Raises InputError if a key is missing, unknown or wrong."""
    drive, folder = parse_table(DriveFile, read_toml(path, "drive"), Location(str(path))), path.resolve().parent
    vehicle = drive.vehicle
    if len(vehicle.goal) == 1 or bool(vehicle.goal) == bool(vehicle.goal_topic):
        raise InputError(f"{path}: [vehicle] needs either goal, as in [8.0, 0.0], or goal_topic")
    if drive.map and drive.map_topic:
        raise InputError(f"{path} has map and map_topic, but needs one of them at most")
    changes = {name: [str(folder / each) for each in getattr(drive, name)] for name in ("bags", "messages")}
    return drive.model_copy(update={**changes, "map": str(folder / drive.map) if drive.map else ""})
