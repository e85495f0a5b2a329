"""Bags as robots record them: clocks, orders, frames, types and files of many kinds."""

import json
import subprocess
import sys

import numpy as np
import pytest

from crowdbench.core.types import Outcome
from crowdbench.utils.errors import InputError

rosbag2 = pytest.importorskip("rosbags.rosbag2")

from ros_bags import (  # noqa: E402
    FOLDER,
    STORE,
    TOPICS,
    VEHICLE,
    bag_of,
    drive_file,
    header,
    make,
    odometry,
    people,
    pose,
    straight,
    trace_of,
    transform,
)
from rosbags.typesys import get_types_from_msg  # noqa: E402

TIMES = np.arange(0.0, 4.05, 0.1).tolist()
MORE = {
    "vision_msgs/msg/BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size",
    "vision_msgs/msg/Detection3D": "std_msgs/Header header\nvision_msgs/BoundingBox3D bbox\nstring id",
    "vision_msgs/msg/Detection3DArray": "std_msgs/Header header\nvision_msgs/Detection3D[] detections",
    "spencer_tracking_msgs/msg/TrackedPerson": "uint64 track_id\ngeometry_msgs/PoseWithCovariance pose",
    "spencer_tracking_msgs/msg/TrackedPersons": (
        "std_msgs/Header header\nspencer_tracking_msgs/TrackedPerson[] tracks"
    ),
}
for _name, _text in MORE.items():
    STORE.register(get_types_from_msg(_text, _name))


def drive(tmp_path, messages, more="", vehicle=VEHICLE, **options):
    """The trace of a bag, and the notes without its name."""
    bag_of(tmp_path / "a", messages, **options)
    trace, notes = trace_of(drive_file(tmp_path, ["a"], more + vehicle))
    return trace, [note.partition(": ")[2] for note in notes]


def refusal(tmp_path, messages, more="", vehicle=VEHICLE):
    with pytest.raises(InputError) as error:
        drive(tmp_path, messages, more, vehicle)
    assert "\n" not in str(error.value)
    return str(error.value).partition(": ")[2]


def in_odom(move=lambda t: (0.0, 0.0), times=TIMES, parent="map", child="odom", topic="/tf"):
    """The drive of `straight` in a frame whose transforms are on a topic."""
    return straight(frame="odom") + [(topic, t, transform(100.0 + t, parent, child, *move(t), 0.0)) for t in times]


@pytest.mark.parametrize("stamp", [40.0, 0.0, 5000.0])
def test_static_transforms_have_no_time(tmp_path, stamp):
    static = ("/tf_static", 0.0, transform(stamp, "base_link", "laser", 0.2, 0.0, 0.0))
    trace, notes = drive(tmp_path, [static, *in_odom()])
    assert trace.outcome.tolist() == [Outcome.SUCCESS]
    assert notes == []


def test_stamps_of_a_simulation_and_times_of_a_wall_clock_fit_together(tmp_path):
    late = [(topic, t + 1e6, message) for topic, t, message in in_odom()]
    trace, notes = drive(tmp_path, late)
    np.testing.assert_allclose(trace.position[0, 4, 0], [1.0, 0.0], atol=1e-6)
    assert notes == []


def test_transforms_of_another_clock_are_said(tmp_path):
    wrong = [("/tf", t, transform(9000.0 + t, "map", "odom", 0.0, 0.0, 0.0)) for t in TIMES]
    said = refusal(tmp_path, straight(frame="odom") + wrong)
    assert said.startswith("the clock of /tf differs by 8900.00 s from that of /odom: record the bag with one clock")


@pytest.mark.parametrize(
    ("wrong", "expected"),
    [
        (("/odom", 1.2, odometry(101.2, np.nan, 0.0)), "the robot in /odom has no valid pose at 1.20 s"),
        (("/odom", 1.2, odometry(101.2, np.inf, 0.0)), "the robot in /odom has no valid pose at 1.20 s"),
        (
            ("/people", 1.2, people(101.2, ("a", np.nan, 2.0))),
            "a position in /people is no number (NaN or infinite) at 1.20 s",
        ),
    ],
)
def test_a_pose_that_is_no_number_is_an_error_that_names_topic_and_time(tmp_path, wrong, expected):
    messages = [one if one[:2] != (wrong[0], pytest.approx(1.2)) else wrong for one in straight()]
    assert wrong in messages
    assert refusal(tmp_path, messages).startswith(expected)


def test_a_transform_that_is_no_number_is_an_error(tmp_path):
    said = refusal(tmp_path, in_odom(lambda t: (np.nan if 1.0 < t < 1.25 else 0.0, 0.0)))
    assert said.startswith("the transform map -> odom in /tf has no valid pose at 1.10 s")


def test_messages_in_another_order_are_sorted(tmp_path):
    swapped = straight()
    odom = [k for k, (topic, _, _) in enumerate(swapped) if topic == "/odom"]
    for here, there in ((odom[3], odom[4]), (odom[10], odom[12])):
        early, late = swapped[here], swapped[there]
        swapped[here], swapped[there] = (early[0], early[1], late[2]), (late[0], late[1], early[2])
    np.testing.assert_array_equal(
        drive(tmp_path, swapped)[0].position[0], _position_of(tmp_path / "in_order", straight())
    )


def _position_of(folder, messages):
    folder.mkdir()
    return drive(folder, messages)[0].position[0]


def test_a_clock_that_starts_again_is_refused(tmp_path):
    again = [(topic, t + 4.1, message) for topic, t, message in straight()]
    assert "the stamps of the robot in /odom go back by 4.00 s at" in refusal(tmp_path, straight() + again)


def test_a_drive_begins_and_ends_where_transforms_are_known(tmp_path):
    trace, notes = drive(tmp_path, in_odom(times=[t for t in TIMES if 1.45 < t < 3.05]))
    np.testing.assert_allclose(trace.position[0, 0, 0], [1.5, 0.0], atol=1e-6)
    assert trace.steps.tolist() == [6]
    assert notes == [
        "the drive begins at 1.50 s, because the transform map -> odom is not known before",
        "the drive ends at 3.00 s, because the transform map -> odom is not known afterwards",
    ]


def test_transforms_that_are_never_known_together_are_said(tmp_path):
    early = [("/tf", t, transform(100.0 + t, "map", "hall", 0.0, 0.0, 0.0)) for t in TIMES[:10]]
    late = [("/tf", t, transform(100.0 + t, "hall", "odom", 0.0, 0.0, 0.0)) for t in TIMES[20:]]
    said = refusal(tmp_path, straight(frame="odom") + early + late)
    assert said == "the transform hall -> odom begins at 2.00 s, after the end of the transform map -> hall at 0.90 s"


@pytest.mark.parametrize("links", [[("odom", "body"), ("body", "odom")], [("odom", "odom")]])
def test_a_loop_of_frames_is_named(tmp_path, links):
    loop = [("/tf", t, transform(100.0 + t, a, b, 0.0, 0.0, 0.0)) for t in TIMES for a, b in links]
    assert "form a loop: odom -> " in refusal(tmp_path, straight(frame="odom") + loop)


def test_a_frame_with_two_parents_is_said(tmp_path):
    other = [("/tf", t, transform(100.0 + t, "world", "odom", 0.0, 0.0, 0.0)) for t in TIMES]
    assert refusal(tmp_path, in_odom() + other) == "/tf gives the frame 'odom' several parents: map and world"


def test_a_fixed_frame_below_the_frame_of_the_robot_is_reached(tmp_path):
    # map -> odom is known, and the drive is scored in odom, whose x axis begins at x = 10 in the map.
    moved = [("/tf", t, transform(100.0 + t, "map", "odom", 10.0, 0.0, np.pi / 2)) for t in TIMES]
    trace, _ = drive(
        tmp_path, straight() + moved, 'fixed_frame = "odom"\n', VEHICLE.replace("[4.0, 0.0]", "[0.0, 6.0]")
    )
    np.testing.assert_allclose(trace.position[0, 4, 0], [0.0, 9.0], atol=1e-6)


@pytest.mark.parametrize(("parent", "child", "fixed"), [("/map", "/odom", "map"), ("map", "odom", "/map")])
def test_a_leading_slash_changes_no_frame(tmp_path, parent, child, fixed):
    trace, _ = drive(tmp_path, in_odom(parent=parent, child=child), f'fixed_frame = "{fixed}"\n')
    assert trace.outcome.tolist() == [Outcome.SUCCESS]


def test_the_topic_of_transforms_has_a_key(tmp_path):
    TOPICS["/robot1/tf"] = TOPICS["/robot1/tf_static"] = TOPICS["/tf"]
    static = ("/robot1/tf_static", 0.0, transform(0.0, "map", "hall", 0.0, 0.0, 0.0))
    messages = [static, *in_odom(topic="/robot1/tf", parent="hall")]
    assert drive(tmp_path, messages, 'tf = "/robot1/tf"\n')[0].outcome.tolist() == [Outcome.SUCCESS]
    (tmp_path / "b").mkdir()
    assert "has no transform from 'odom' to 'map'" in refusal(tmp_path / "b", messages)


def test_a_robot_is_known_by_its_transforms_alone(tmp_path):
    moved = [("/tf", t, transform(100.0 + t, "map", "base_link", t, 0.0, 0.0)) for t in TIMES]
    seen = [one for one in straight() if one[0] == "/people"]
    trace, notes = drive(tmp_path, moved + seen, vehicle="[vehicle]\ngoal = [4.0, 0.0]\n")
    assert trace.outcome.tolist() == [Outcome.SUCCESS]
    assert notes == []


@pytest.mark.parametrize("kind", ["PoseStamped", "PoseWithCovarianceStamped"])
def test_poses_of_motion_capture_and_localisation_are_read(tmp_path, kind):
    def message(t):
        at = pose(t, 0.0)
        with_covariance = make("geometry_msgs/msg/PoseWithCovariance", at, np.zeros(36))
        return make(f"geometry_msgs/msg/{kind}", header(100.0 + t), at if kind == "PoseStamped" else with_covariance)

    TOPICS["/pose"] = f"geometry_msgs/msg/{kind}"
    seen = [one for one in straight() if one[0] == "/people"]
    poses = [("/pose", t, message(t)) for t in TIMES]
    trace, _ = drive(tmp_path, seen + poses, vehicle=VEHICLE.replace("/odom", "/pose"))
    np.testing.assert_allclose(trace.position[0, 4, 0], [1.0, 0.0], atol=1e-6)


def test_a_topic_of_another_type_is_named(tmp_path):
    said = refusal(tmp_path, straight(), vehicle=VEHICLE.replace("/odom", "/people"))
    assert said.startswith("/people has messages people_msgs/msg/People, but must have nav_msgs/msg/Odometry or ")
    said = refusal(tmp_path / "b", straight(), vehicle=VEHICLE + '[people]\ntopic = "/odom"\n')
    assert said.startswith("/odom has messages nav_msgs/msg/Odometry: give list, position and id in [people]")


def detections(t, *at):
    box = [
        make("vision_msgs/msg/BoundingBox3D", pose(x, y), make("geometry_msgs/msg/Vector3", 1.0, 1.0, 1.0))
        for x, y in at
    ]
    each = [make("vision_msgs/msg/Detection3D", header(100.0 + t), one, str(k)) for k, one in enumerate(box)]
    return make("vision_msgs/msg/Detection3DArray", header(100.0 + t), each)


def tracked(t, *at):
    poses = [make("geometry_msgs/msg/PoseWithCovariance", pose(x, y), np.zeros(36)) for x, y in at]
    each = [make("spencer_tracking_msgs/msg/TrackedPerson", k, one) for k, one in enumerate(poses)]
    return make("spencer_tracking_msgs/msg/TrackedPersons", header(100.0 + t), each)


def markers(t, *at):
    def marker(k, x, y, action=0):
        vector, duration = (
            make("geometry_msgs/msg/Vector3", 1.0, 1.0, 1.0),
            make("builtin_interfaces/msg/Duration", 0, 0),
        )
        color = make("std_msgs/msg/ColorRGBA", 1.0, 1.0, 1.0, 1.0)
        image = make("sensor_msgs/msg/CompressedImage", header(100.0 + t), "", np.zeros(0, np.uint8))
        mesh = make("visualization_msgs/msg/MeshFile", "", np.zeros(0, np.uint8))
        rest = [color, duration, False, [], [], "", image, [], "", "", mesh, False]
        return make(
            "visualization_msgs/msg/Marker", header(100.0 + t), "people", k, 3, action, pose(x, y), vector, *rest
        )

    deleted = marker(9, 0.0, 0.0, 2)  # DELETE
    return make("visualization_msgs/msg/MarkerArray", [deleted, *(marker(k, x, y) for k, (x, y) in enumerate(at))])


def pose_array(t, *at):
    # Without identities, and in another order in every second message.
    poses = [pose(x, y) for x, y in at]
    return make("geometry_msgs/msg/PoseArray", header(100.0 + t), poses[:: -1 if round(10 * t) % 2 else 1])


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("vision_msgs/msg/Detection3DArray", detections),
        ("spencer_tracking_msgs/msg/TrackedPersons", tracked),
        ("visualization_msgs/msg/MarkerArray", markers),
        ("geometry_msgs/msg/PoseArray", pose_array),
    ],
)
def test_pedestrians_are_read_from_messages_of_known_types(tmp_path, kind, message):
    TOPICS["/tracks"] = kind
    robot = [one for one in straight() if one[0] == "/odom"]
    seen = [("/tracks", t, message(t, (2.0, 2.0), (4.0 - t, -2.0))) for t in TIMES]
    trace, notes = drive(tmp_path, robot + seen, vehicle=VEHICLE + '[people]\ntopic = "/tracks"\n', storage="MCAP")
    places = np.sort(trace.position[0, 4, 1:], axis=0)
    np.testing.assert_allclose(places, [[2.0, -2.0], [3.0, 2.0]], atol=1e-6)
    assert trace.position.shape[2] == 3
    guess = ["/tracks does not tell its pedestrians apart: their identities are guessed from their positions"]
    assert notes == (guess if kind == "geometry_msgs/msg/PoseArray" else [])


def test_pedestrians_of_one_name_are_told_apart_by_their_positions(tmp_path):
    robot = [one for one in straight() if one[0] == "/odom"]
    seen = [("/people", t, people(100.0 + t, ("", 2.0, 2.0), ("", 4.0 - t, -2.0))) for t in TIMES]
    trace, notes = drive(tmp_path, robot + seen)
    assert trace.position.shape[2] == 3
    assert notes[0].startswith("/people does not tell its pedestrians apart")


def test_messages_without_stamps_have_the_times_of_their_recording(tmp_path):
    unstamped = [one if one[0] == "/odom" else (*one[:2], people(0.0, ("a", 2.0, 2.0))) for one in straight()]
    trace, notes = drive(tmp_path, unstamped)
    assert trace.outcome.tolist() == [Outcome.SUCCESS]
    assert notes == ["messages of /people have no stamps: the times of their recording count"]


def test_a_map_and_a_goal_may_be_older_than_the_recording(tmp_path):
    old = make("geometry_msgs/msg/PoseStamped", header(1.0), pose(3.0, 0.0))
    trace, _ = drive(
        tmp_path,
        [("/goal_pose", 0.0, old), *straight()],
        vehicle='[vehicle]\nodometry = "/odom"\ngoal_topic = "/goal_pose"\n',
    )
    assert trace.outcome.tolist() == [Outcome.SUCCESS]
    np.testing.assert_allclose(trace.goal[0, 0, 0], [3.0, 0.0])


@pytest.mark.slow
@pytest.mark.parametrize("storage", ["MCAP", "SQLITE3"])
def test_bags_are_read_without_metadata_and_in_parts(tmp_path, storage):
    messages = straight()
    bag_of(tmp_path / "whole", messages, storage)
    (tmp_path / "whole" / "metadata.yaml").unlink()
    (tmp_path / "parts").mkdir()
    for name, part in (("one", messages[:40]), ("two", messages[40:])):
        bag_of(tmp_path / name, part, storage)
        (file,) = (path for path in (tmp_path / name).iterdir() if path.suffix in (".mcap", ".db3"))
        file.rename(tmp_path / "parts" / file.name)
    bag_of(tmp_path / "usual", messages, storage)
    trace, _ = trace_of(drive_file(tmp_path, ["whole", "parts", "usual"], VEHICLE))
    for row in (0, 1):
        np.testing.assert_array_equal(trace.position[row], trace.position[2])


@pytest.mark.parametrize(("mode", "storage"), [("MESSAGE", "SQLITE3"), ("FILE", "SQLITE3"), ("STORAGE", "MCAP")])
def test_compressed_bags_are_read(tmp_path, mode, storage):
    bag_of(tmp_path / "plain", straight(), storage)
    bag_of(tmp_path / "small", straight(), storage, compression=mode)
    trace, _ = trace_of(drive_file(tmp_path, ["plain", "small"], VEHICLE))
    np.testing.assert_array_equal(trace.position[0], trace.position[1])


def test_an_empty_folder_is_no_bag(tmp_path):
    (tmp_path / "a").mkdir()
    with pytest.raises(InputError, match=r"there is no file .mcap, .db3 or .bag in this folder"):
        trace_of(drive_file(tmp_path, ["a"], VEHICLE))


@pytest.mark.slow
def test_the_result_lists_what_was_left_out_and_guessed(tmp_path):
    bag_of(tmp_path / "a", in_odom(times=[t for t in TIMES if t > 1.45]))
    drive_file(tmp_path, ["a"], VEHICLE)
    script = [sys.executable, FOLDER / "score_bags.py", tmp_path / "drive.toml", "--out", tmp_path / "run"]
    subprocess.run(script, check=True, capture_output=True)
    (note,) = json.loads((tmp_path / "run" / "result.json").read_text())["stated"]["notes"]
    assert note.endswith("the drive begins at 1.50 s, because the transform map -> odom is not known before")
