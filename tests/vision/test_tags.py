"""Tags from pixels to bearings: exact pictures, all kinds of recordings, and left-out tags."""

import json
import re
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from cli.commands import call, done, refused
from drives.ros.rig import NANO
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore
from vision.drawn import picture, placed, tag
from vision_scene import write_pictures

from homeward.drives.cameras.camera import angles
from homeward.drives.cameras.lens import Lens
from homeward.drives.folder import read_folder
from homeward.drives.opening import open_drive
from homeward.errors import InputError
from homeward.estimator import Status
from homeward.localizer.localizer import Localizer
from homeward.vision.recorded.recording import see_recording
from homeward.vision.tags.front_end import TagFrontEnd
from homeward.vision.tags.messages import picture_of

DOCS = Path(__file__).parents[2] / "docs"
SHAPE = (240, 320)
PINHOLE = Lens(fx=250, fy=252, cx=161, cy=118, width=320, height=240, tilt_sigma=1e-6)
FISHEYE = Lens(
    fx=140, fy=140, cx=158, cy=121, model="fisheye", distortion=(-0.02, 0.01, 0, 0), tilt_sigma=1e-6
)
TYPES = get_typestore(Stores.ROS1_NOETIC)


def drawn(lens, number=7, middle=(1.0, 0.2, 0.1), size=0.3, yaw=0.4, seed=0, **more):
    at = placed(middle, (size, size), yaw, 0.2, 0.1)
    return picture(lens, SHAPE, tag(number), *at, seed=seed, **more), angles(np.array(middle))[0]


@pytest.mark.parametrize("lens", [PINHOLE, FISHEYE], ids=["pinhole", "fisheye"])
def test_bearings_and_their_sigmas_are_consistent(lens):
    eye, rng, errors, sigmas = TagFrontEnd(lens), np.random.default_rng(1), [], []
    for k in range(30):
        middle = rng.uniform([0.8, -0.35, -0.25], [1.4, 0.35, 0.25])
        yaw = float(rng.uniform(-0.8, 0.8))
        image, true = drawn(lens, k, middle, 0.25, yaw, seed=k, noise=4.0)
        seen = eye.see(image)
        if seen.bearings:
            assert list(seen.bearings) == [str(k)]
            errors.append(seen.bearings[str(k)] - true)
            sigmas.append(seen.sigmas[str(k)])
    assert len(errors) > 20
    # Three hundredths of a pixel.
    assert np.sqrt(np.mean(np.square(errors))) < 0.03 / lens.fx
    # Bounds of chi-square at 1e-4 for 20 and more; too large is worse than too small.
    assert 0.15 < np.mean(np.square(np.divide(errors, sigmas))) < 2.2


def test_a_code_with_a_wrong_cell_is_left_out():
    image, _ = drawn(PINHOLE, 7, yaw=0.0)
    assert TagFrontEnd(PINHOLE).see(image).bearings
    sheet = tag(7)
    cell = sheet[4 * 30 : 5 * 30, 4 * 30 : 5 * 30]
    cell[:] = 255 - cell
    wrong = picture(PINHOLE, SHAPE, sheet, *placed((1.0, 0.2, 0.1), (0.3, 0.3)))
    options = cv2.aruco.DetectorParameters()
    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    found = cv2.aruco.ArucoDetector(family, options).detectMarkers(wrong)[1]
    assert found.ravel().tolist() == [7]  # OpenCV corrects it
    assert not TagFrontEnd(PINHOLE).see(wrong).bearings


def test_a_number_that_occurs_twice_is_reported_and_left_out():
    left, _ = drawn(PINHOLE, 3, (1.0, 0.35, 0.0), yaw=0.0)
    right, _ = drawn(PINHOLE, 3, (1.0, -0.35, 0.0), yaw=0.0)
    both = np.hstack([left[:, :160], right[:, 160:]])
    seen = TagFrontEnd(PINHOLE).see(both)
    assert seen.tags.twice == ("3",)
    assert not seen.bearings


@pytest.mark.parametrize(
    "family", ["16h5", "tag25h9", "36H11", "4x4_50", "7X7_1000", "aruco_mip_36h12"]
)
def test_families(family):
    image = picture(PINHOLE, SHAPE, tag(11, family), *placed((1.0, 0, 0), (0.4, 0.4)))
    assert list(TagFrontEnd(PINHOLE, family).see(image).bearings) == ["11"]


def test_no_such_family():
    with pytest.raises(InputError, match=r"unknown tag family '37h11'; use one of .*36h11"):
        TagFrontEnd(PINHOLE, "37h11")


def test_pictures_of_another_size():
    with pytest.raises(InputError, match="calibrated for 320x240"):
        TagFrontEnd(PINHOLE).see(np.zeros((480, 640), np.uint8))


@pytest.fixture(scope="module")
def record(tmp_path_factory):
    """A folder with pictures along a drive, home's, and what else there must be."""
    folder = tmp_path_factory.mktemp("tags")
    seen = [drawn(PINHOLE, k, (1.0 + 0.1 * k, 0.2, 0.1), seed=k)[0] for k in range(4)]
    write_pictures(folder, seen, 0.25)
    cv2.imwrite(str(folder / "home.png"), drawn(PINHOLE, 2)[0])
    (folder / "odometry.csv").write_text("t,v,omega\n0,0.1,0\n1,0.1,0\n")
    (folder / "camera.yaml").write_text("{fx: 250, fy: 252, cx: 161, cy: 118, width: 320}\n")
    (folder / "images.yaml").write_text("camera: {file: camera.yaml, pitch: 0.0}\n")
    return folder


def test_a_folder_by_command(record, tmp_path):
    asked = ["see", str(record), "--tags", "36h11", "--out", str(tmp_path / "drive")]
    summary = json.loads(done(call(*asked, "--json")).stdout)
    drive = read_folder(tmp_path / "drive")
    assert drive.sightings.landmark.tolist() == ["0", "1", "2", "3"]
    assert summary["landmarks"] == {"0": 1, "1": 1, "2": 1, "3": 1}
    assert summary["home"] == [*drive.home]
    true = np.arctan2(0.2, 1.0 + 0.1 * np.arange(4))
    assert drive.sightings.bearing == pytest.approx(true, abs=2e-4)
    assert drive.home["2"].bearing == pytest.approx(np.arctan2(0.2, 1.0), abs=2e-4)


def test_the_size_of_tags_gives_ranges(record, tmp_path):
    folder = shutil.copytree(record, tmp_path / "sized")
    with (folder / "images.yaml").open("a") as stream:
        stream.write("tag_size: 0.24\n")  # the black square of a sheet of 0.3 m
    for k in range(4):
        upright = placed((1.0 + 0.1 * k, 0.2, 0.1), (0.3, 0.3), 0.4)
        cv2.imwrite(str(folder / f"{k}.png"), picture(PINHOLE, SHAPE, tag(k), *upright, seed=k))
    done(call("see", str(folder), "--tags", "36h11", "--out", str(tmp_path / "drive")))
    true = np.hypot(1.0 + 0.1 * np.arange(4), 0.2)
    assert read_folder(tmp_path / "drive").sightings.range == pytest.approx(true, rel=0.01)


@pytest.fixture
def homeless(record, tmp_path):
    folder = shutil.copytree(record, tmp_path / "homeless")
    (folder / "home.png").unlink()
    return folder


def test_a_folder_that_specifies_when_home_was_needs_no_picture_of_it(homeless, tmp_path):
    (homeless / "drive.yaml").write_text("home: {spin: [0, 1]}\n")
    done(call("see", homeless, "--tags", "36h11", "--out", tmp_path / "drive"))
    assert set(open_drive(tmp_path / "drive").home) == {"0", "1", "2", "3"}


@pytest.mark.parametrize(("option", "number"), [("spin:0,1", 4), ("during:0,0.3", 2)])
def test_options_specify_when_home_was_seen(homeless, tmp_path, option, number):
    asked = "see", homeless, "--tags", "36h11", "--out", tmp_path / "drive"
    assert "must be two numbers" in refused(call(*asked, "--home", "spin:3"))
    done(call(*asked, "--home", option))
    assert len(read_folder(tmp_path / "drive").home) == number


def test_a_folder_of_tags_takes_home_from_home_csv(homeless, tmp_path):
    (homeless / "home.csv").write_text("landmark,bearing\n2,0.1\n3,1.5\n7,-1\n")
    (homeless / "images.yaml").write_text("tags: 36h11\ncamera: {file: camera.yaml, pitch: 0.0}\n")
    done(call("see", homeless, "--out", tmp_path / "drive"))
    assert set(read_folder(tmp_path / "drive").home) == {"2", "3", "7"}
    assert set(open_drive(homeless).home) == {"2", "3", "7"}


def test_a_later_drive_of_tags_needs_no_home(homeless, tmp_path):
    done(call("see", homeless, "--tags", "36h11", "--out", tmp_path / "drive"))
    assert read_folder(tmp_path / "drive").home == {}


def test_a_forward_camera_without_tags_and_size_is_refused(record, tmp_path):
    made = call("see", record, "--out", tmp_path / "drive")
    assert "needs width and height, or tags" in refused(made)


def test_a_video(record):
    path = record / "drive.avi"
    kind = cv2.VideoWriter.fourcc(*"MJPG")
    video = cv2.VideoWriter(str(path), kind, 4.0, SHAPE[::-1])
    for k in range(4):
        video.write(cv2.imread(str(record / f"{k}.png")))
    video.release()
    by_container = see_recording(path, tags="36h11")
    assert by_container.sightings.t.tolist() == [0.0, 0.25, 0.5, 0.75]
    assert by_container.sightings.landmark.tolist() == ["0", "1", "2", "3"]
    (record / "drive.csv").write_text("t\n0.1\n0.2\n0.5\n0.6\n")
    assert see_recording(path, tags="36h11").sightings.t.tolist() == [0.1, 0.2, 0.5, 0.6]
    (record / "drive.csv").write_text("t\n0.1\n0.2\n")
    with pytest.raises(InputError, match="but 2 stamps"):
        see_recording(path, tags="36h11")
    (record / "broken.mp4").write_bytes(b"no video")
    with pytest.raises(InputError, match="not a readable video"):
        see_recording(record / "broken.mp4", tags="36h11")


def message(kind, **fields):
    return TYPES.types[kind](**fields)


def header(t):
    stamp = message("builtin_interfaces/msg/Time", sec=int(t), nanosec=int(t % 1 * NANO))
    return message("std_msgs/msg/Header", seq=0, stamp=stamp, frame_id="camera")


def image_message(grey, encoding="mono8", t=0.0):
    pixels = np.frombuffer(np.ascontiguousarray(grey).tobytes(), np.uint8)
    height, width = grey.shape[:2]
    return message(
        "sensor_msgs/msg/Image",
        header=header(t),
        height=height,
        width=width,
        encoding=encoding,
        is_bigendian=0,
        step=pixels.size // height,
        data=pixels,
    )


@pytest.mark.parametrize("large", [False, True])
def test_pictures_in_a_log(record, tmp_path, large):
    path = tmp_path / "drive.bag"
    with Writer(path) as bag:

        def write(topic, kind, t, filled, known={}):  # noqa: B006
            if topic not in known:
                known[topic] = bag.add_connection(topic, kind, typestore=TYPES)
            data = TYPES.serialize_ros1(filled, kind)
            bag.write(known[topic], int((t + 1) * NANO), data)

        for k in range(4):
            grey = cv2.imread(str(record / f"{k}.png"), 0)
            colour = cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)
            if large:  # beyond what other messages may hold
                colour = cv2.resize(colour, None, fx=3, fy=3, interpolation=cv2.INTER_CUBIC)
            picture = image_message(colour, "bgr8", 1.0 + k)
            write("/camera/image_raw", "sensor_msgs/msg/Image", k, picture)
            vector = TYPES.types["geometry_msgs/msg/Vector3"]
            still, way = vector(x=0.0, y=0.0, z=0.0), vector(x=0.1, y=0.0, z=0.0)
            twist = message("geometry_msgs/msg/Twist", linear=way, angular=still)
            kind = "geometry_msgs/msg/TwistStamped"
            write("/odom", kind, k, message(kind, header=header(1.0 + k), twist=twist))
    times = 3 if large else 1
    shift = (times - 1) / 2
    (tmp_path / "topics.yaml").write_text(
        "bearings: {topic: /camera/image_raw, camera: "
        f"{{fx: {250 * times}, fy: {252 * times}, cx: {161 * times + shift}, "
        f"cy: {118 * times + shift}}}}}\n"
    )
    drive = see_recording(path, tags="36h11", topics=tmp_path / "topics.yaml")
    assert drive.sightings.landmark.tolist() == ["0", "1", "2", "3"]
    true = np.arctan2(0.2, 1.0 + 0.1 * np.arange(4))
    assert drive.sightings.bearing == pytest.approx(true, abs=4e-4)
    assert (drive.sightings.sigma < 0.01).all()
    with pytest.raises(InputError, match="--tags"):
        see_recording(path)


GREY = np.random.default_rng(0).integers(0, 255, (64, 96), dtype=np.uint8)


@pytest.mark.parametrize(
    ("encoding", "pixels"),
    [
        ("mono8", GREY),
        ("8UC1", GREY),
        ("mono16", GREY.astype(np.uint16) << 8 | 255),
        ("bgr8", np.dstack([GREY] * 3)),
        ("rgb8", np.dstack([GREY] * 3)),
        ("rgba8", np.dstack([GREY] * 4)),
        ("yuv422", np.dstack([np.full_like(GREY, 128), GREY])),
        ("yuv422_yuy2", np.dstack([GREY, np.full_like(GREY, 128)])),
    ],
)
def test_encodings(encoding, pixels):
    got = picture_of(image_message(pixels, encoding))
    assert np.abs(got.astype(int) - GREY).max() <= 1


def test_compressed():
    data = np.frombuffer(cv2.imencode(".png", GREY)[1].tobytes(), np.uint8)
    kind = "sensor_msgs/msg/CompressedImage"
    assert (picture_of(message(kind, header=header(0), format="png", data=data)) == GREY).all()
    with pytest.raises(InputError, match="png"):
        picture_of(message(kind, header=header(0), format="png", data=data[:99]))


@pytest.mark.parametrize(
    "wrong",
    [
        {"encoding": "32FC7"},
        {"height": 10**6},
        {"step": 3},
        {"width": 0},
        {"width": 2**31, "step": 2**32 - 1},
        {"data": np.zeros(5, np.uint8)},
    ],
)
def test_hostile_pictures(wrong):
    bad = image_message(GREY)
    for name, value in wrong.items():
        object.__setattr__(bad, name, value)
    with pytest.raises(InputError):
        picture_of(bad)


def test_the_manuals_python_runs(tmp_path):
    page = (DOCS / "do" / "cameras.md").read_text()
    code, of_poses = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    camera = "fx: 250\nfy: 252\ncx: 161\ncy: 118\nwidth: 320\nheight: 240\n"
    (tmp_path / "camera.yaml").write_text(camera)
    localizer = Localizer({"7": 0.1})
    localizer.odometry(0.0, 0.1, 0.0)
    names = {"folder": tmp_path, "image": drawn(PINHOLE)[0], "localizer": localizer, "t": 0.1}
    exec(code, names)
    assert list(names["seen"].bearings) == ["7"]
    assert names["answer"].status is Status.MAPPING
    corners = np.array([[[600, 340], [660, 340], [660, 400], [600, 400]]], float)
    lens = Lens(fx=600, fy=600, cx=640, cy=360)
    names |= {"corners": corners, "sizes": np.array([0.16]), "lens": lens}
    exec(of_poses, names)
    assert names["poses"][0].position[0] == pytest.approx(1.6, abs=0.1)


def test_a_log_without_pictures_is_refused_and_nothing_is_written(tmp_path):
    log = tmp_path / "sample.bag"
    done(call("convert", "sample", log))
    said = refused(call("see", log, "--tags", "36h11", "--out", tmp_path / "drive"))
    assert "the log contains no images; use homeward run for a log with detected tags" in said
    assert not (tmp_path / "drive").exists()
