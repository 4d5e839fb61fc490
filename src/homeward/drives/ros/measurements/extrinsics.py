"""Extrinsics of the cameras of a log, from the topics file or /tf_static."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from homeward.drives.ros.measurements.sightings import SightingRows, axes_of, form_of
from homeward.drives.ros.presets import TRANSFORMS
from homeward.drives.ros.settings import BearingsTopic, LogSettings, MountFrames
from homeward.drives.settings import Mount, OtherCamera
from homeward.errors import InputError
from homeward.geometry.frames import Pose, between
from homeward.io.settings import validated

TF, TF_STATIC = "/tf", "/tf_static"
MAX_CHANGE = 1e-3
"""Maximum change of a constant transform on /tf [m], or in each part of its quaternion [1]."""
LEVEL = 0.05
"""Maximum tilt of a camera for bearings without positions, which assume a level camera [rad]. The
bearing of a landmark 10 deg above or below then has an error of up to 0.5 deg."""
BODY_IN_OPTICAL = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
"""Axes of a camera's body frame (x ahead, y left, z up) in its optical one (z ahead, x right)."""


class Transforms:
    """The tree of frames from /tf_static, and the constant ones from /tf."""

    def __init__(self) -> None:
        self._parents: dict[str, tuple[str, np.ndarray]] = {}
        """Parent of each frame, and the pose in it as a matrix (4, 4)."""
        self._followed: dict[str, tuple[Any, ...]] = {}
        self._moving: set[str] = set()

    def offer(self, given: Any) -> None:
        """Add a transform that nobody asked for, if it is valid."""
        with suppress(InputError):
            self.put(given)

    def put(self, given: Any) -> None:
        """Add a geometry_msgs/TransformStamped."""
        parent, shift, q = _values(given)
        if not 0.0 < q @ q < math.inf:
            raise InputError("a quaternion is zero or not finite", part=TF_STATIC)
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = Rotation.from_quat(q).as_matrix(), shift
        self._parents[given.child_frame_id.strip("/")] = parent, pose

    def follow(self, given: Any) -> None:
        """Add a geometry_msgs/TransformStamped of /tf, which may change during the drive."""
        child, values = given.child_frame_id.strip("/"), _values(given)
        if child in self._moving:
            return
        first = self._followed.setdefault(child, values)
        if first is values and values[2].any():
            self.put(given)
        elif first[0] != values[0] or any(
            np.abs(a - b).max() > MAX_CHANGE for a, b in zip(first[1:], values[1:], strict=True)
        ):
            self._moving.add(child)

    def is_known(self, frame: str) -> bool:
        """Return whether a frame has a parent."""
        return frame.strip("/") in self._parents

    def find(self, base: str, frame: str) -> np.ndarray | None:
        """Return the pose (4, 4) of a frame in the base frame; None while none connect them.

        A frame above it with a prefix, as `robot1/base_link`, counts where the base has none.
        """
        here = self._above(frame)
        base = next((above for above in here if above.endswith(f"/{base.strip('/')}")), base)
        there = self._above(base)
        for above, pose in here.items():
            if above in there:
                path = [*here][: [*here].index(above)] + [*there][: [*there].index(above)]
                if moving := self._moving.intersection(path):
                    raise InputError(
                        f"{min(moving)} moves between {frame} and {base}, but "
                        "the camera extrinsics must be constant",
                        part=TF,
                        advice="use a camera that is fixed on the robot",
                    )
                return np.asarray(np.linalg.inv(there[above]) @ pose)
        return None

    def _above(self, frame: str) -> dict[str, np.ndarray]:
        """Return the pose of a frame in itself and in each of its ancestors."""
        frame = frame.strip("/")
        found = {frame: np.eye(4)}
        while frame in self._parents:
            parent, pose = self._parents[frame]
            if parent in found:
                raise InputError(f"the frames form a loop through {parent}", part=TF_STATIC)
            found[parent] = pose @ found[frame]
            frame = parent
        return found


def _values(given: Any) -> tuple[str, np.ndarray, np.ndarray]:
    """Return parent, translation (3,) [m] and quaternion (4,) of a TransformStamped."""
    shift, q = given.transform.translation, given.transform.rotation
    parts = np.array([shift.x, shift.y, shift.z]), np.array([q.x, q.y, q.z, q.w], float)
    return given.header.frame_id.strip("/"), *parts


def mount(
    transforms: Transforms, frames: MountFrames, kind: str, given: BearingsTopic
) -> tuple[Mount, BearingsTopic] | None:
    """Return camera extrinsics from /tf_static, and the settings of bearings with the tilt.

    None while no transforms connect the two `frames`. `kind` is the message type of the
    bearings. `InputError` where they are plain bearings, and the camera is not level.
    """
    assert frames.camera is not None
    place = transforms.find(frames.base, frames.camera)
    if place is None:
        return None
    turn, shift = place[:3, :3], place[:3, 3]
    if axes_of(frames.camera, given) == "optical":
        turn = turn @ BODY_IN_OPTICAL
    # Rz(yaw) Ry(pitch) Rx(roll), as in `tilt_matrix`.
    yaw, pitch = math.atan2(turn[1, 0], turn[0, 0]), -math.asin(np.clip(turn[2, 0], -1.0, 1.0))
    roll = math.atan2(turn[2, 1], turn[2, 2])
    found = Mount(x=float(shift[0]), y=float(shift[1]), yaw=yaw)
    tilt = math.acos(np.clip(turn[2, 2], -1.0, 1.0))
    if form_of(kind, given) == "bearing":
        if tilt > LEVEL:
            raise InputError(
                f"{frames.camera} is tilted by {math.degrees(tilt):.1f} deg in {frames.base}, but "
                f"{kind} allows at most {math.degrees(LEVEL):.1f} deg",
                advice="use a topic with pixels or positions, whose tilt is corrected",
            )
        return found, given
    angles = {"roll": roll, "pitch": pitch}
    return found, validated(BearingsTopic, given.model_dump(exclude_none=True) | angles)


def not_connected(frames: MountFrames) -> str:
    """Return the message for missing transforms."""
    return f"no transforms on {TF_STATIC} or {TF} connect {frames.camera} to {frames.base}"


LINKED = (
    "sightings with the camera extrinsics that /tf_static gives for {0} (x {1:.3f} m, y {2:.3f} m, "
    "yaw {3:.3f} rad), as with mount: {{base: base_link}}; sensor in the topics file replaces them"
)
MAX_DISTANCE = 0.01
"""Maximum distance of cameras that count as one [m]: the bearing of a landmark at 1 m then has an
error of at most 0.01 rad, the usual noise of a bearing."""


def extrinsics(
    cameras: Sequence[SightingRows],
    transforms: Transforms,
    plan: LogSettings,
    others: dict[str, OtherCamera],
) -> Mount | None:
    """Return the extrinsics of the first camera, and relate the others to it.

    Cameras are in the order of the topics file. Points in space are transformed to the first
    exactly, and bearings of cameras in one place are rotated; other cameras get a name (`others`
    has their extrinsics by it). None for a single camera without given extrinsics. `InputError`
    where one of several cameras has no extrinsics.
    """
    several = len({(camera.frame, camera.given.sensor) for camera in cameras}) > 1
    found = [_specified(camera, transforms, plan, several) for camera in cameras]
    lacking = [camera for camera, mount in zip(cameras, found, strict=True) if mount is None]
    if not several:
        return found[0] if found else None
    drive = plan.drive
    if drive and "sensor" in drive.model_fields_set and len({c.frame for c in lacking}) == 1:
        own = Mount(**drive.sensor.model_dump(include=set(Mount.model_fields)))
        found, lacking = [mount or own for mount in found], []
    if lacking:
        advice = "add sensor: {x: ..., y: ..., yaw: ...} to its topic in the topics file"
        raise InputError(
            "one of several cameras, without extrinsics",
            part=lacking[0].name,
            advice=f"{advice}, or record {TF_STATIC} and name the robot's frame there, as in "
            "mount: {base: base_link}",
        )
    (first, *_), mounts = cameras, [mount for mount in found if mount is not None]
    for camera, own in zip(cameras, mounts, strict=True):
        place = between(mounts[0].pose, own.pose)
        is_exact = camera.form == first.form == "position"
        if is_one_camera(place, is_exact):
            camera.in_reference = place
            continue
        topic = camera.given.topic
        is_alone = sum(each.given.topic == topic for each in cameras) == 1
        camera.camera = topic if is_alone or not camera.frame else camera.frame
        others[camera.camera] = OtherCamera(**dict(own))
    return mounts[0]


def is_one_camera(place: Pose, is_exact: bool) -> bool:
    """Return whether bearings of a camera at `place` in the frame of the first become its own.

    `is_exact`: they have positions.
    """
    return is_exact or math.hypot(place.x, place.y) <= MAX_DISTANCE


def _specified(
    camera: SightingRows, transforms: Transforms, plan: LogSettings, several: bool
) -> Mount | None:
    """Return the extrinsics from the topic or the transforms; set the tilt from the latter."""
    if camera.given.sensor is not None:
        return camera.given.sensor
    is_given = plan.drive is not None and not plan.drive.sensor.model_fields_set.isdisjoint(
        Mount.model_fields
    )
    is_tag = camera.kind in TRANSFORMS and not is_given  # in the tree of its own frames
    if plan.mount is not None or several or is_tag:
        frames = plan.mount or MountFrames()
        if several or frames.camera is None:
            frames = frames.model_copy(update={"camera": camera.frame})
        found = mount(transforms, frames, camera.kind, camera.given)
        if found is None and plan.mount is not None and not several:
            raise InputError(not_connected(frames))
    elif is_given or not camera.frame or not transforms.is_known(camera.frame):
        return None
    else:  # nobody asked for them, so what cannot be used is no error
        found = None
        with suppress(InputError):
            frames = MountFrames(camera=camera.frame)
            found = mount(transforms, frames, camera.kind, camera.given)
    if found is None:
        return None
    own, camera.given = found
    return own
