"""What a user can say of a log: which topics, what of them, and where home is."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, field_validator

from homeward.drives.cameras.camera import Tilt
from homeward.drives.cameras.lens import Lens
from homeward.drives.settings import DriveSettings, Finite, HomeWhen, Mount, Positive
from homeward.io.keys import Strict

ODOMETRY = "homeward_msgs/msg/Odometry"
BEARINGS = "homeward_msgs/msg/Bearings"
POSE = "homeward_msgs/msg/Pose"
PICTURES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")


class OdometryTopic(Strict):
    """Where the odometry is."""

    topic: str
    use: Literal["twist", "pose"] | None = None
    """What of a nav_msgs/Odometry: its twist, or its poses, differentiated; None: the twist, unless
    the poses contradict it and are usable."""
    left: tuple[str, ...] = ()
    """Joints of the left wheels in a sensor_msgs/JointState; none: every name with left in it."""
    right: tuple[str, ...] = ()
    """And of the right ones."""
    wheel_radius: Positive | None = None
    """[m]"""
    track_width: Positive | None = None
    """Between left and right wheels [m]."""


class BearingsTopic(Strict):
    """Where sightings of landmarks are."""

    topic: str
    landmark: str | None = None
    """Id of the landmark of a geometry_msgs/PointStamped; None: the last part of the topic."""
    camera: str | Lens | None = None
    """For points in an image: the topic of the sensor_msgs/CameraInfo, a calibration beside the
    topics file (``FILE.yaml``, or ``FILE.yaml#cam1`` of several), or the model itself."""
    roll: Tilt | None = None
    """Of that camera, as in `Camera` [rad]; None: as its model says."""
    pitch: Tilt | None = None
    tilt_sigma: Annotated[float, Field(gt=0, le=0.5)] | None = None
    pixel_sigma: Positive = 0.5
    """Standard deviation of each coordinate of a tag's corner [px]: detectors that do not tell it
    find corners to a fraction of a pixel."""
    rectified: bool = False
    """Whether they are points of the rectified image."""
    axes: Literal["body", "optical"] | None = None
    """For points in space: x ahead and y to the left, or z ahead and x to the right; None: optical
    where the name of the frame says so."""
    sigma: Positive | None = None
    """Standard deviation of a bearing that has none of its own [rad]."""
    sensor: Mount | None = None
    """Extrinsics of the camera of this topic; None: as `LogSettings.mount` or `drive` specify."""

    @property
    def tilt(self) -> dict[str, float]:
        """What is said of the camera's tilt here."""
        told = self.model_dump(include={"roll", "pitch", "tilt_sigma"})
        return {key: value for key, value in told.items() if value is not None}


NAME_BEARINGS = "name its topics under bearings in a topics file; homeward info lists them"
"""The way out where no topic of a log is known to tell bearings."""
NAME_HOME = "name it under home in a topics file (csv, topic, during or spin: [from, until])"
"""The way out where nothing in a log tells what the camera saw at home."""


class MountFrames(Strict):
    """Frames of /tf_static that tell where the camera sits."""

    camera: Annotated[str, Field(min_length=1)] | None = None
    """The camera's; optical where its name says so, or the bearings' `axes`. None: the frame_id of
    the bearings. Where these have several frames, each is looked up."""
    base: Annotated[str, Field(min_length=1)] = "base_link"
    """The robot's."""


class HomeFrom(HomeWhen):
    """Where the home bearings are, or when the robot was at home: one of these."""

    topic: str | None = None
    """A homeward_msgs/Bearings of what the camera saw at home; its first message counts."""
    csv: str | None = None
    """A home.csv, beside the YAML file or absolute."""


class TruthTopic(Strict):
    """Where true poses are, for scoring alone."""

    topic: str
    home: tuple[Finite, Finite, Finite] | None = None
    """Home in the frame of these poses: x [m], y [m], heading [rad]; None: they are in home's."""


class LogSettings(Strict):
    """Everything that the topics file may say; every key may be absent, and is guessed then."""

    clock: Literal["header", "receive"] = "header"
    """Whether header stamps are the times, or when the recorder received a message."""
    odometry: OdometryTopic | None = None
    bearings: tuple[BearingsTopic, ...] = ()
    home: HomeFrom | None = None
    truth: TruthTopic | None = None
    mount: MountFrames | None = None
    """Where the camera sits on the robot; None: as `drive` says."""
    drive: DriveSettings | None = None
    """What drive.yaml says of a drive folder."""

    @field_validator("bearings", mode="before")
    @classmethod
    def _one_or_several(cls, value: Any) -> Any:
        return [value] if isinstance(value, dict) else value
