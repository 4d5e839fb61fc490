"""The topics file: settings of a log."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, NamedTuple

from homeward.drives.cameras.camera import TagSize, Tilt
from homeward.drives.cameras.lens import Lens
from homeward.drives.settings import (
    HOME_TIMES,
    DriveSettings,
    Finite,
    HomeWhen,
    Mount,
    Positive,
    Wheels,
)
from homeward.io.checks import BeforeValidator, Field
from homeward.io.models import Strict, model_validator

PICTURES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")


def wildcard_part(pattern: str, name: str) -> str | None:
    """Return the part of a name that matches the ``*`` of a pattern; None without a match.

    Without ``*`` the part is the whole name. It contains no slash.
    """
    before, star, after = pattern.partition("*")
    part = name[len(before) : len(name) - len(after)]
    if not star or not part or "/" in part or name != before + part + after:
        return name if name == pattern else None
    return part


FieldPath = Annotated[str, Field(pattern=r"^(\.|[A-Za-z]\w*(\[\])?(\.[A-Za-z]\w*(\[\])?)*)$")]
"""Names of fields from the message down, with ``[]`` after a list; ``.`` is the message itself."""


class Layout(NamedTuple):
    """Paths of the id and of the position, bearing or pixels of each landmark in a message."""

    id: str = ""
    """Empty: the place in the list, or a name of the topic."""
    position: str = ""
    bearing: str = ""
    corners: str = ""
    """Of tags in an image, in order."""
    pixel: str = ""
    sigma: str = ""
    """Standard deviation of the bearing."""
    errors: str = ""
    """Number of wrong bits of a tag."""
    axes: str = ""
    """Axes of positions in any frame: body or optical; empty: as the frame's name implies."""
    origin: float = 0.0
    """Column and row of the centre of the first pixel [px]."""

    def __str__(self) -> str:
        kind = "position" if self.position else "bearing"
        return f"id = {self.id}, {kind} = {self.position or self.bearing}"

    @property
    def place(self) -> str:
        """The path of what locates the landmark."""
        return self.position or self.bearing or self.corners or self.pixel

    @property
    def list_name(self) -> str:
        """Name of the list whose items have the id and the place; empty without such a list."""
        name, mark, rest = self.id.partition("[].")
        return name if mark and "[]" not in rest and self.place.startswith(f"{name}[]") else ""


class OdometryTopic(Wheels):
    """The topic of odometry, with the geometry of the wheels for wheel angles and steering."""

    topic: str
    v: FieldPath | None = None
    """Path of the forward speed [m/s] in a message of another type, as in ``twist.linear.x``."""
    omega: FieldPath | None = None
    """Path of the yaw rate [rad/s]."""
    vy: FieldPath | None = None
    """Path of the speed to the left [m/s]."""
    use: Literal["twist", "pose"] | None = None
    """Part of a nav_msgs/Odometry: the twist, or differentiated poses; None: the twist, unless the
    poses contradict it and are usable."""
    left: tuple[str, ...] = ()
    """Joints of the left wheels in a sensor_msgs/JointState; empty: every name with left in it."""
    right: tuple[str, ...] = ()
    """Joints of the right wheels, as `left`."""
    omni: tuple[str, ...] = ()
    """Joints of three or four omni wheels, anti-clockwise; see `omni_radius`."""
    frames: tuple[str, str] = ("odom", "base_link")
    """Frames of odometry and robot in a tf2_msgs/TFMessage; base_footprint is the same as
    base_link."""
    yaw_rate: str | None = None
    """A topic of sensor_msgs/Imu, whose yaw rate replaces that of the odometry."""


class BearingsTopic(Strict):
    """A topic of sightings of landmarks."""

    topic: str
    """With one ``*`` for the landmark id in its name: a topic for each landmark."""
    landmark: str | None = None
    """Id of the landmark in a topic of one landmark; None: the last part of the topic of a
    geometry_msgs/PointStamped."""
    id: FieldPath | None = None
    """Path of the landmark id in a message, as in ``tags[].id``; None: as known for its type, or
    found by the names of its fields."""
    position: FieldPath | None = None
    """Path of the landmark's position (x, y, z) [m]; ``.`` is the message itself."""
    bearing: FieldPath | None = None
    """Path of the bearing [rad], or [deg] where its name ends in deg."""
    frames: Annotated[str, Field(min_length=1)] | None = None
    """For a tf2_msgs/TFMessage: names of the landmarks' frames, with ``*`` for the landmark id."""
    camera: str | Lens | None = None
    """For points in an image: the topic of the sensor_msgs/CameraInfo, a calibration file in the
    folder of the topics file (``FILE``, or ``FILE#cam1`` of several cameras), or the model."""
    roll: Tilt | None = None
    """Roll of the camera, as in `Camera` [rad]; None: as in its model, or 0 for positions."""
    pitch: Tilt | None = None
    tilt_sigma: Annotated[float, Field(gt=0, le=0.5)] | None = None
    pixel_sigma: Positive = 0.5
    """Standard deviation of each coordinate of a tag's corner [px], where the message has none:
    detectors find corners to a fraction of a pixel."""
    tag_size: TagSize | None = None
    """Length of the sides of tags [m], of all or by id, for ranges from their corners; None:
    no ranges. For tags on vertical surfaces."""
    rectified: bool = False
    """Whether points are in the rectified image."""
    axes: Literal["body", "optical"] | None = None
    """For points in space: x ahead and y to the left, or z ahead and x to the right; None: optical
    where the frame's name ends in optical."""
    sigma: Positive | None = None
    """Standard deviation of a bearing where the message has none [rad]."""
    sensor: Mount | None = None
    """Extrinsics of the camera of this topic; None: as `LogSettings.mount` or `drive` specify."""

    @model_validator(mode="after")
    def _one_source_of_ids(self) -> BearingsTopic:
        if self.position and self.bearing:
            raise ValueError("give either position or bearing")
        for pattern in (self.topic, self.frames or ""):
            if pattern.count("*") > 1:
                raise ValueError(f"{pattern} has more than one *")
            if "*" in pattern and self.landmark is not None:
                raise ValueError(f"the landmark id is the * in {pattern}; remove landmark")
        return self

    @property
    def layout(self) -> Layout | None:
        """The given fields; None while the id, or position and bearing, are missing."""
        if self.id is None or not (self.position or self.bearing):
            return None
        return Layout(self.id, self.position or "", self.bearing or "")

    @property
    def tilt(self) -> dict[str, float]:
        """The given keys of the camera's tilt."""
        return self.model_dump(include={"roll", "pitch", "tilt_sigma"}, exclude_none=True)


NAME_BEARINGS = "name its topics under bearings in a topics file; homeward info lists them"
"""Advice for a log without a known topic of bearings."""
NAME_HOME = f"name a file or topic under home in a topics file; or use {HOME_TIMES}"
"""Advice for a log without home bearings."""


class MountFrames(Strict):
    """Frames of /tf_static for the camera extrinsics."""

    camera: Annotated[str, Field(min_length=1)] | None = None
    """Frame of the camera; optical according to its name or the bearings' `axes`. None: the
    frame_id of the bearings. Where these have several frames, each is looked up."""
    base: Annotated[str, Field(min_length=1)] = "base_link"
    """Frame of the robot."""


class HomeFrom(HomeWhen):
    """Source of the home bearings, or time at which the robot was at home: one of these."""

    topic: str | None = None
    """A topic of homeward_msgs/Bearings at home; its first message counts."""
    csv: str | None = None
    """A home.csv, in the folder of the topics file or absolute."""


class TruthTopic(Strict):
    """A topic of ground-truth poses, for scoring only."""

    topic: str
    home: tuple[Finite, Finite, Finite] | None = None
    """Home in the frame of these poses: x [m], y [m], heading [rad]; None: the home frame."""


class LogSettings(Strict):
    """The keys of the topics file; absent ones are guessed."""

    clock: Literal["header", "receive"] = "header"
    """Source of times: header stamps, or receive times of the recorder."""
    odometry: OdometryTopic | None = None
    bearings: Annotated[
        tuple[BearingsTopic, ...], BeforeValidator(lambda v: [v] if isinstance(v, dict) else v)
    ] = ()
    home: HomeFrom | None = None
    truth: TruthTopic | None = None
    tilt: str | None = None
    """A topic of sensor_msgs/Imu or nav_msgs/Odometry whose orientation has the roll and pitch of
    the robot, for which bearings are corrected."""
    mount: MountFrames | None = None
    """Camera extrinsics from /tf_static; None: as `drive` specifies."""
    drive: DriveSettings | None = None
    """The keys of drive.yaml in a drive folder."""


def calibrated(settings: LogSettings, source: Path) -> LogSettings:
    """Return settings with calibration files replaced by camera models.

    Their paths are relative to the folder of the file `source`.
    """
    from homeward.drives.cameras.calibration import is_calibration, read_calibration  # rarely used

    topics = tuple(
        topic.model_copy(update={"camera": read_calibration(source.parent, topic.camera)})
        if isinstance(topic.camera, str) and is_calibration(topic.camera)
        else topic
        for topic in settings.bearings
    )
    return settings.model_copy(update={"bearings": topics}) if topics else settings
