"""Extrinsics of the cameras of a log: given by the topics file, or by /tf_static."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from homeward.drives.ros.measurements.bearings import IN_IMAGE, IN_SPACE, SightingRows, axes_of
from homeward.drives.ros.settings import BearingsTopic, LogSettings, MountFrames
from homeward.drives.settings import Mount
from homeward.errors import InputError
from homeward.geometry.frames import between
from homeward.io.settings import validated

TF_STATIC = "/tf_static"
LEVEL = 0.05
"""Bearings of points in space take the camera as level. Tilted by this, one of a landmark 10 deg
above or below it is off by up to tan(10 deg) of it, 0.5 deg [rad]."""
BODY_IN_OPTICAL = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
"""Axes of a camera's body frame (x ahead, y left, z up) in its optical one (z ahead, x right)."""


class Placed(NamedTuple):
    """A frame in another one."""

    rotation: np.ndarray
    """(3, 3)"""
    shift: np.ndarray
    """(3,) [m]"""

    def after(self, other: Placed) -> Placed:
        """Return this one, which is in the other, in what the other is in."""
        turned = other.rotation @ self.rotation
        return Placed(turned, other.rotation @ self.shift + other.shift)


class Transforms:
    """The tree of frames, as far as it was told."""

    def __init__(self) -> None:
        self._parents: dict[str, tuple[str, Placed]] = {}

    def add(self, _: float, message: Any) -> None:
        """Take a tf2_msgs/TFMessage."""
        for told in message.transforms:
            shift, q = told.transform.translation, told.transform.rotation
            child, parent = told.child_frame_id.strip("/"), told.header.frame_id.strip("/")
            place = Placed(_rotation(q), np.array([shift.x, shift.y, shift.z]))
            self._parents[child] = parent, place

    def find(self, base: str, frame: str) -> Placed | None:
        """Return a frame in the base's; None where nothing ties them together as yet."""
        here, there = self._above(frame), self._above(base)
        for above, place in here.items():
            if above in there:
                turn, shift = there[above]
                return place.after(Placed(turn.T, -turn.T @ shift))
        return None

    def _above(self, frame: str) -> dict[str, Placed]:
        """Return a frame in itself and in each one above it."""
        frame = frame.strip("/")
        found = {frame: Placed(np.eye(3), np.zeros(3))}
        while frame in self._parents:
            parent, place = self._parents[frame]
            if parent in found:
                raise InputError(f"{TF_STATIC}: {parent} is a frame in itself")
            found[parent] = found[frame].after(place)
            frame = parent
        return found


def mount(
    transforms: Transforms, frames: MountFrames, kind: str, told: BearingsTopic
) -> tuple[Mount, BearingsTopic] | None:
    """Return camera extrinsics from /tf_static, and the settings of bearings with the tilt.

    None as long as no transform ties the two `frames` together. `kind` is the message type of the
    bearings. `InputError` where the camera is tilted more than bearings of that type allow.
    """
    assert frames.camera is not None
    place = transforms.find(frames.base, frames.camera)
    if place is None:
        return None
    turn, shift = place
    if axes_of(frames.camera, told) == "optical":
        turn = turn @ BODY_IN_OPTICAL
    # Rz(yaw) Ry(pitch) Rx(roll), as `tilt_matrix` has it.
    yaw, pitch = math.atan2(turn[1, 0], turn[0, 0]), -math.asin(np.clip(turn[2, 0], -1.0, 1.0))
    roll = math.atan2(turn[2, 1], turn[2, 2])
    sits = Mount(x=float(shift[0]), y=float(shift[1]), yaw=yaw)
    tilt = math.acos(np.clip(turn[2, 2], -1.0, 1.0))
    if kind in IN_IMAGE:
        words = {"roll": roll, "pitch": pitch}
        return sits, validated(BearingsTopic, told.model_dump(exclude_none=True) | words)
    if tilt > LEVEL:
        raise InputError(
            f"{frames.camera} is tilted by {math.degrees(tilt):.1f} deg in {frames.base}, and "
            f"{kind} tells no bearings then: at most {math.degrees(LEVEL):.1f} deg, or corners of "
            "tags in an image"
        )
    return sits, told


def not_tied(frames: MountFrames) -> str:
    """Say that no transform was heard."""
    return f"nothing on {TF_STATIC} ties {frames.camera} to {frames.base}"


def _rotation(q: Any) -> np.ndarray:
    """Return the matrix (3, 3) of a quaternion."""
    u, w = np.array([q.x, q.y, q.z], float), float(q.w)
    norm = float(u @ u) + w * w
    if not (norm > 0 and math.isfinite(norm)):
        raise InputError(f"{TF_STATIC}: a rotation that is none")
    cross = np.array([[0.0, -u[2], u[1]], [u[2], 0.0, -u[0]], [-u[1], u[0], 0.0]])
    turn = (w * w - u @ u) * np.eye(3) + 2.0 * np.outer(u, u) + 2.0 * w * cross
    return np.asarray(turn / norm)


MAX_APART = 0.01
"""Cameras this near to each other are in one place [m]: the bearing of a landmark at a distance of
1 m then has an error of at most 0.01 rad, which is the usual noise of a bearing."""


class TopicSightings(NamedTuple):
    """The sightings of one topic in one frame."""

    frame: str
    """As the messages name it; empty where they do not."""
    rows: SightingRows

    @property
    def name(self) -> str:
        """The topic and the frame, for messages."""
        return f"{self.rows.told.topic} (frame {self.frame or 'not named'})"


def extrinsics(
    cameras: Sequence[TopicSightings], transforms: Transforms, plan: LogSettings
) -> Mount | None:
    """Return the extrinsics of the first camera, and relate the others to it.

    Cameras are in the order of the topics file. Points in space are transformed exactly. Bearings
    alone can only be turned, so these cameras must be in one place. None where the log has one
    camera whose extrinsics its topics and `mount` do not specify. `InputError` where one of several
    cameras has no extrinsics, or cannot be related to the first.
    """
    several = len({(camera.frame, camera.rows.told.sensor) for camera in cameras}) > 1
    found = [_specified(camera, transforms, plan, several) for camera in cameras]
    lacking = [camera for camera, sits in zip(cameras, found, strict=True) if sits is None]
    if not several:
        return found[0] if found else None
    drive = plan.drive
    if drive and "sensor" in drive.model_fields_set and len({c.frame for c in lacking}) == 1:
        own = Mount(**drive.sensor.model_dump(include=set(Mount.model_fields)))
        found, lacking = [sits or own for sits in found], []
    if lacking:
        ways = "add sensor: {x: ..., y: ..., yaw: ...} to its topic in the topics file"
        raise InputError(
            f"{lacking[0].name} is one of several cameras and has no extrinsics: {ways}, or record "
            f"{TF_STATIC} and name the robot's frame there, as in mount: {{base: base_link}}"
        )
    (first, *_), sits = cameras, [each for each in found if each is not None]
    for camera, its in zip(cameras, sits, strict=True):
        apart = math.hypot(its.x - sits[0].x, its.y - sits[0].y)
        if apart > MAX_APART and not {camera.rows.kind, first.rows.kind} <= set(IN_SPACE):
            raise InputError(
                f"{camera.name} is {apart:.2f} m from {first.name}: bearings of several cameras "
                f"are used together only where these are less than {MAX_APART:g} m apart; name "
                "the topic of one of them under bearings in a topics file"
            )
        camera.rows.in_reference = between(sits[0].pose, its.pose)
    return sits[0]


def _specified(
    camera: TopicSightings, transforms: Transforms, plan: LogSettings, several: bool
) -> Mount | None:
    """Return what the topic or the transforms specify; the tilt is set where these have one."""
    if (sits := camera.rows.told.sensor) is not None:
        return sits
    asked = plan.mount
    if asked is None and not several:
        return None
    frames = asked or MountFrames()
    if several or frames.camera is None:
        frames = frames.model_copy(update={"camera": camera.frame})
    found = mount(transforms, frames, camera.rows.kind, camera.rows.told)
    if found is None:
        if several:
            return None
        raise InputError(not_tied(frames))
    sits, camera.rows.told = found
    return sits
