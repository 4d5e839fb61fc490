"""Messages of types that homeward does not know, and of known types with other fields."""

import math
import re
import sqlite3

import numpy as np
import pytest
from cli.commands import call, done
from drives.ros.build import EPOCH, SECOND, odometry, stamps
from rosbags.typesys import get_types_from_msg
from rosbags.typesys.store import Typestore

from homeward.drives.opening import open_drive
from homeward.drives.ros.log import Log
from homeward.drives.ros.settings import BearingsTopic
from homeward.drives.ros.topics.by_fields import candidates
from homeward.drives.ros.topics.survey import survey
from homeward.drives.ros.writing import typestore, writing
from homeward.errors import InputError

HEADER = "std_msgs/Header header\n"
POSITION = "geometry_msgs/Pose pose\n"


def write_log(path, kind, text, contents, topic="/tags", others=(), with_odometry=True):
    """Write odometry, and messages of a type with such a definition from dicts of their fields."""
    with writing(path) as log:
        log._store.register(get_types_from_msg(text, kind))
        for t in stamps(10) if with_odometry else ():
            log.write("/odom", t, odometry(log, t, 0.2, 0.1))
        for name in (topic, *others):
            for t, fields in zip(stamps(len(contents)), contents, strict=True):
                if "header" in dict(log._store.fielddefs[kind][1]):
                    fields = {
                        "header": log.header(t, fields.get("frame", "camera_optical")),
                        **fields,
                    }
                fields = {name: value for name, value in fields.items() if name != "frame"}
                log.write(name, t, log.make(kind, **_filled(log, kind, fields)))


def _filled(log, kind, fields):
    """Make the messages in lists of dicts."""
    types = dict(log._store.fielddefs[kind][1])
    made = {}
    for name, value in fields.items():
        if isinstance(value, list) and value and isinstance(value[0], dict):
            inner = types[name][1][0][1]
            value = [log.make(inner, **_filled(log, inner, item)) for item in value]
        made[name] = value
    return made


def info(path):
    return " ".join(done(call("info", path)).output.split())


def definition(top, **inner):
    """A definition with those of other types of my_msgs."""
    parts = [f"{'=' * 80}\nMSG: my_msgs/{name}\n{text}" for name, text in inner.items()]
    return "\n".join([top, *parts])


def pose_at(x, y, z=0.0):
    return {"position": {"x": x, "y": y, "z": z}}


def bearings_of(drive):
    seen = drive.sightings
    return dict(zip(seen.landmark, seen.bearing.round(6), strict=True))


LISTS = {
    "id and pose": (
        definition("std_msgs/Header header\nmy_msgs/Tag[] tags", Tag="int32 tag_id\n" + POSITION),
        {"tags": [{"tag_id": 7, "pose": pose_at(-1.0, 0.0, 1.0)}]},
        {"7": math.pi / 4},
        "id = tags[].tag_id, position = tags[].pose.position",
    ),
    "name and stamped pose with covariance, also a centre in pixels": (
        definition(
            "std_msgs/Header header\nmy_msgs/Found[] found",
            Found="string label\ngeometry_msgs/Point center\ngeometry_msgs/Point[4] corners\n"
            "geometry_msgs/PoseWithCovarianceStamped where\n",
        ),
        {"found": [{"label": "door", "where": {"pose": {"pose": pose_at(1.0, 0.0, 1.0)}}}]},
        {"door": -math.pi / 4},
        "id = found[].label, position = found[].where.pose.pose.position",
    ),
    "coordinates in the item": (
        definition(HEADER + "my_msgs/M[] ms", M="uint16 id\nfloat32 x\nfloat32 y\nfloat32 z\n"),
        {"ms": [{"id": 3, "x": -2.0, "y": 0.0, "z": 2.0}]},
        {"3": math.pi / 4},
        "id = ms[].id, position = ms[]",
    ),
    "transform": (
        definition(HEADER + "my_msgs/T[] a", T="string name\ngeometry_msgs/Transform transform\n"),
        {"a": [{"name": "a", "transform": {"translation": {"x": 0.0, "y": 0.0, "z": 1.0}}}]},
        {"a": 0.0},
        "id = a[].name, position = a[].transform.translation",
    ),
    "ids of bundles": (
        definition("std_msgs/Header header\nmy_msgs/B[] bs", B="int32[] id\n" + POSITION),
        {"bs": [{"id": np.array([1, 2], np.int32), "pose": pose_at(0.0, 0.0, 1.0)}]},
        {"1+2": 0.0},
        "id = bs[].id, position = bs[].pose.position",
    ),
    "range and bearing": (
        definition(HEADER + "my_msgs/Z[] zs", Z="uint8 mark_id\nfloat64 range\nfloat64 bearing\n"),
        {"zs": [{"mark_id": 4, "range": 2.0, "bearing": 0.5}]},
        {"4": 0.5},
        "id = zs[].mark_id, bearing = zs[].bearing",
    ),
    "lists with names in the plural": (
        "std_msgs/Header header\nstring[] names\nfloat64[] ranges\nfloat64[] bearings_deg\n",
        {"names": ["a", "b"], "bearings_deg": np.array([90.0, -45.0])},
        {"a": math.pi / 2, "b": -math.pi / 4},
        "id = names[], bearing = bearings_deg[]",
    ),
    "lists next to each other, in degrees": (
        "std_msgs/Header header\nint64[] ids\nfloat64[] ranges\nfloat64[] azimuth_deg\n",
        {"ids": np.array([8, 9]), "azimuth_deg": np.array([90.0, -45.0])},
        {"8": math.pi / 2, "9": -math.pi / 4},
        "id = ids[], bearing = azimuth_deg[]",
    ),
}  # fmt: skip


@pytest.mark.parametrize("suffix", [".mcap", ".bag"])
@pytest.mark.parametrize(("text", "fields", "expected", "layout"), LISTS.values(), ids=LISTS)
def test_lists_of_an_unknown_type_are_read_by_their_fields(
    tmp_path, text, fields, expected, layout, suffix
):
    path = tmp_path / f"log{suffix}"
    write_log(path, "my_msgs/msg/List", text, [fields])
    drive = open_drive(path)
    assert bearings_of(drive) == pytest.approx(expected, abs=1e-6)
    assert any(layout in remark and "my_msgs/msg/List" in remark for remark in drive.remarks)


def test_info_lists_the_fields_and_prints_topics_that_run_accepts(tmp_path):
    text, fields, expected, _ = LISTS["id and pose"]
    write_log(tmp_path / "log.mcap", "my_msgs/msg/List", text, [fields])
    found = info(tmp_path / "log.mcap")
    assert (
        "/tags (my_msgs/msg/List): can be used as bearings: id = tags[].tag_id, position = "
        "tags[].pose.position, axes from frame_id 'camera_optical': optical" in found
    )
    assert "not read yet" not in found
    option = re.search(r"as in ({.*})\.", found)[1]
    (tmp_path / "topics.yaml").write_text(f"bearings: {option}\n")
    drive = open_drive(tmp_path / "log.mcap", topics=tmp_path / "topics.yaml")
    assert bearings_of(drive) == pytest.approx(expected, abs=1e-6)
    plan = done(call("info", tmp_path / "log.mcap")).output.partition("change them):\n")[2]
    plan = plan.partition("Next:")[0]
    (tmp_path / "topics.yaml").write_text(plan)
    drive = open_drive(tmp_path / "log.mcap", topics=tmp_path / "topics.yaml")
    assert bearings_of(drive) == pytest.approx(expected, abs=1e-6)


def test_a_known_type_is_preferred_and_unclear_ones_must_be_named(tmp_path):
    text, fields, expected, _ = LISTS["id and pose"]
    path = tmp_path / "log.mcap"
    write_log(path, "my_msgs/msg/List", text, [fields], others=("/more",))
    assert not open_drive(path).sightings.t.size
    topics = tmp_path / "topics.yaml"
    topics.write_text("bearings: {topic: /more}\n")
    assert bearings_of(open_drive(path, topics=topics)) == pytest.approx(expected, abs=1e-6)


MAPS = {
    "without a frame": definition("my_msgs/Tag[] tags", Tag="int32 tag_id\n" + POSITION),
    "one object": "std_msgs/Header header\nstring name\n" + POSITION,
}


@pytest.mark.parametrize("text", MAPS.values(), ids=MAPS)
def test_messages_that_may_be_a_map_or_the_robot_itself_are_used_only_if_named(tmp_path, text):
    write_log(tmp_path / "log.mcap", "my_msgs/msg/Any", text, [{}])
    assert not open_drive(tmp_path / "log.mcap").sightings.t.size
    assert "/tags (my_msgs/msg/Any): can be used as bearings" in info(tmp_path / "log.mcap")


SEVERAL = definition(
    "std_msgs/Header header\nmy_msgs/Tag[] tags",
    Tag="int32 tag_id\nint32 marker_id\n"
    "geometry_msgs/Pose camera_pose\ngeometry_msgs/Pose map_pose\n",
)


def test_several_possible_fields_are_refused_with_the_choices(tmp_path):
    path, topics = tmp_path / "log.mcap", tmp_path / "topics.yaml"
    tag = {"tag_id": 1, "marker_id": 2, "camera_pose": pose_at(0, 0, 1), "map_pose": pose_at(9, 9)}
    write_log(path, "my_msgs/msg/List", SEVERAL, [{"tags": [tag]}])
    topics.write_text("bearings: {topic: /tags}\n")
    with pytest.raises(InputError, match=r"position: tags.camera_pose.position} or {topic: /tags"):
        open_drive(path, topics=topics)
    topics.write_text("bearings: {topic: /tags, id: tags.tag_id, position: tags.depth}\n")
    with pytest.raises(InputError, match=r"no point tags.depth for position; it has tags.*map"):
        open_drive(path, topics=topics)
    topics.write_text(
        "bearings: {topic: /tags, id: tags.tag_id, position: tags.camera_pose.position}\n"
    )
    assert bearings_of(open_drive(path, topics=topics)) == {"1": 0.0}


def test_a_type_without_landmarks_is_listed_as_not_read(tmp_path):
    path, topics = tmp_path / "log.mcap", tmp_path / "topics.yaml"
    write_log(path, "my_msgs/msg/Battery", "std_msgs/Header header\nfloat32 volts\n", [{}])
    assert "Types that are not read yet: /tags (my_msgs/msg/Battery)" in info(path)
    topics.write_text("bearings: {topic: /tags}\n")
    with pytest.raises(InputError, match="no fields look like an id with a position or bearing"):
        open_drive(path, topics=topics)


def test_lists_of_different_lengths_are_refused(tmp_path):
    text = LISTS["lists next to each other, in degrees"][0]
    fields = {"ids": np.array([8, 9]), "azimuth_deg": np.array([90.0])}
    write_log(tmp_path / "log.mcap", "my_msgs/msg/List", text, [fields])
    with pytest.raises(InputError, match=r"2 values of ids\[\] and 1 of azimuth_deg\[\]"):
        open_drive(tmp_path / "log.mcap")


def test_headers_of_the_items_give_frame_and_time(tmp_path):
    text = definition("my_msgs/Tag[] tags", Tag="std_msgs/Header header\nint32 id\n" + POSITION)
    header = {"stamp": {"sec": EPOCH, "nanosec": 300_000_000}, "frame_id": "left_optical"}
    tag = {"id": 5, "pose": pose_at(-1.0, 0.0, 1.0), "header": header}
    write_log(tmp_path / "log.mcap", "my_msgs/msg/List", text, [{"tags": [tag]}])
    drive = open_drive(tmp_path / "log.mcap")
    assert bearings_of(drive) == pytest.approx({"5": math.pi / 4}, abs=1e-6)
    assert drive.sightings.t.tolist() == [pytest.approx(0.3)]


@pytest.mark.parametrize(
    "text",
    [
        "std_msgs/Header header\nfloat32 v\nfloat32 omega\n",
        "std_msgs/Header header\nfloat64 linear_velocity\nfloat64 yaw_rate\n",
        "std_msgs/Header header\ngeometry_msgs/Twist twist\nint32 battery\n",
        "std_msgs/Header header\nfloat32 vx\nfloat32 wz\nfloat64 vy\n",
    ],
)
def test_odometry_of_an_unknown_type(tmp_path, text):
    path = tmp_path / "log.mcap"
    names = [line.split()[-1] for line in text.splitlines()[1:3]]
    fields = dict(zip(names, (0.5, 0.1), strict=True))
    if "Twist" in text:
        fields = {"twist": {"linear": {"x": 0.5, "y": -0.2}, "angular": {"z": 0.1}}}
    if "vy" in text:
        fields["vy"] = -0.2
    write_log(path, "my_msgs/msg/Wheel", text, [fields] * 10, topic="/wheels", with_odometry=False)
    drive = open_drive(path)
    assert drive.odometry.v.tolist() == pytest.approx([0.5] * 10)
    assert drive.odometry.omega.tolist() == pytest.approx([0.1] * 10)
    strafes = "vy" in text or "Twist" in text
    assert drive.odometry.vy.tolist() == pytest.approx([-0.2 if strafes else 0.0] * 10)
    assert any("read by fields: v = " in remark for remark in drive.remarks)
    assert "/wheels (my_msgs/msg/Wheel): can be used as odometry: v = " in info(path)


def test_an_old_definition_of_a_known_type(tmp_path):
    """aruco_msgs/Marker had a pose without covariance."""
    text = "std_msgs/Header header\naruco_msgs/Marker[] markers\n" + (
        f"{'=' * 80}\nMSG: aruco_msgs/Marker\nstd_msgs/Header header\nuint16 id\n{POSITION}"
    )
    path = tmp_path / "log.bag"
    kind = "aruco_msgs/msg/MarkerArray"
    with writing(path) as log:
        log._store = Typestore()
        fields = dict(typestore(True).fielddefs)
        del fields[kind], fields["aruco_msgs/msg/Marker"]
        log._store.register(fields)
        log._store.register(get_types_from_msg(text, kind))
        for t in stamps(10):
            log.write("/odom", t, odometry(log, t, 0.2, 0.1))
        marker = log.make("aruco_msgs/msg/Marker", id=3, pose=pose_at(-1.0, 0.0, 1.0))
        header = log.header(EPOCH * SECOND, "camera_optical")
        log.write("/m", EPOCH * SECOND, log.make(kind, header=header, markers=[marker]))
    assert bearings_of(open_drive(path)) == pytest.approx({"3": math.pi / 4}, abs=1e-6)


def test_optical_axes_are_found_in_the_values_if_the_frame_does_not_name_them(tmp_path):
    text, _, _, _ = LISTS["id and pose"]
    rng = np.random.default_rng(0)
    ahead, right = rng.uniform(1.0, 5.0, 40), rng.uniform(-3.0, 3.0, 40)
    tags = [
        {"tag_id": i, "pose": pose_at(x, 0.1, z)}
        for i, (x, z) in enumerate(zip(right, ahead, strict=True))
    ]
    content = [{"tags": tags, "frame": "camera"}]
    write_log(tmp_path / "log.mcap", "my_msgs/msg/List", text, content)
    drive = open_drive(tmp_path / "log.mcap")
    assert drive.sightings.bearing == pytest.approx(np.arctan2(-right, ahead))
    assert any("in optical axes" in remark for remark in drive.remarks)
    (tmp_path / "topics.yaml").write_text("bearings: {topic: /tags, axes: body}\n")
    drive = open_drive(tmp_path / "log.mcap", topics=tmp_path / "topics.yaml")
    assert drive.sightings.bearing == pytest.approx(np.arctan2(0.1, right))


def test_a_bag_without_definitions_says_how_to_get_them(tmp_path):
    path = tmp_path / "log.db3"
    text, fields, _, _ = LISTS["id and pose"]
    write_log(path, "my_msgs/msg/List", text, [fields])
    with sqlite3.connect(path) as database:
        database.execute("DELETE FROM message_definitions")
    found = info(path)
    assert "no definition of /tags (my_msgs/msg/List)" in found
    assert "ros2 bag convert" in found


def test_a_recursive_or_huge_type_ends_the_search(tmp_path):
    text = definition("my_msgs/A[] a\n", A="my_msgs/B[] b\n", B="int32 id\n" + POSITION * 1)
    write_log(tmp_path / "log.mcap", "my_msgs/msg/List", text, [{}])
    (found,) = candidates(survey(Log(tmp_path / "log.mcap")), BearingsTopic(topic="/tags"))
    assert str(found.layout) == "id = a[].b[].id, position = a[].b[].pose.position"
