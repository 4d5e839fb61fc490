"""Extrinsics of the cameras of a log, one for each topic and frame."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from homeward.drives.drive import Mount
from homeward.drives.ros.measurements.bearings import IN_SPACE, SightingRows
from homeward.drives.ros.measurements.mount import TF_STATIC, Transforms, mount, not_tied
from homeward.drives.ros.settings import LogSettings, MountFrames
from homeward.errors import InputError
from homeward.geometry.frames import between

MAX_APART = 0.01
"""Cameras this near to each other are in one place [m]: the bearing of a landmark at a distance of
1 m then has an error of at most 0.01 rad, which is the usual noise of a bearing."""


class Camera(NamedTuple):
    """The sightings of one topic in one frame."""

    frame: str
    """As the messages name it; empty where they do not."""
    rows: SightingRows

    @property
    def name(self) -> str:
        """The topic and the frame, for messages."""
        return f"{self.rows.told.topic} (frame {self.frame or 'not named'})"


def extrinsics(
    cameras: Sequence[Camera], transforms: Transforms, plan: LogSettings
) -> Mount | None:
    """Return the extrinsics of the first camera, and relate the others to it.

    Points in space are transformed exactly. Bearings alone can only be turned, so these cameras
    must be in one place.

    Parameters
    ----------
    cameras : sequence of Camera
        In the order of the topics file; their rows are changed.
    transforms : Transforms
        Of /tf_static.
    plan : LogSettings
        `mount`, and `drive` for the only camera without other extrinsics.

    Returns
    -------
    Mount or None
        None where the log has one camera whose extrinsics its topics and `mount` do not specify.

    Raises
    ------
    InputError
        When one of several cameras has no extrinsics, or cannot be related to the first.
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
    camera: Camera, transforms: Transforms, plan: LogSettings, several: bool
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
