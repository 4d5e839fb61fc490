"""Where the camera sits on the robot, by the transforms of /tf_static."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from homeward.drives.drive import Mount
from homeward.drives.ros.measurements.bearings import IN_IMAGE, axes_of
from homeward.drives.ros.settings import BearingsTopic, MountFrames
from homeward.errors import InputError
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
    """Return where the camera sits, and what is told of its bearings, its tilt included.

    Parameters
    ----------
    transforms : Transforms
        What was heard.
    frames : MountFrames
        Which of them.
    kind : str
        The type of the bearings' messages.
    told : BearingsTopic
        What is said of them.

    Returns
    -------
    tuple or None
        None as long as nothing ties the two frames together.

    Raises
    ------
    InputError
        When the camera is tilted more than bearings of that type can be used with.
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
