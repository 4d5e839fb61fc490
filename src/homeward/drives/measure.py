"""Odometry and sightings from columns by role, of a table as of messages."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from homeward.drives.cameras.camera import Camera, tag_bearings, tag_directions, tag_ranges
from homeward.drives.drive import Odometry
from homeward.drives.plausibility import odometry_from_poses, without_implausible
from homeward.drives.settings import Wheels
from homeward.drives.wheels import ackermann, swerve


def motion(values: Mapping[str, np.ndarray], wheels: Wheels, remarks: dict[str, int]) -> Odometry:
    """Return the odometry of columns (n,) in SI units; implausible motion is unknown.

    Times `t` increase strictly. The others are v, omega and vy of twists; x, y and heading of
    poses; v and steering; module_1_speed, module_1_angle, ... of swerve modules; or the sums of
    distance and turn.
    """
    t = values["t"]
    if "steering" in values:
        return ackermann(t, values["v"], values["steering"], wheels, remarks)
    if "module_1_speed" in values:
        speeds, angles = (
            np.stack([values[f"module_{k + 1}_{what}"] for k in range(len(wheels.modules))], axis=1)
            for what in ("speed", "angle")
        )
        return swerve(t, speeds, angles, wheels, remarks)
    if "heading" in values:
        poses = np.stack([values[role] for role in ("x", "y", "heading")], axis=1)
        return odometry_from_poses(t, poses, remarks)
    if "distance" in values:
        steps = (np.append(np.diff(values[r]) / np.diff(t), 0.0) for r in ("distance", "turn"))
        return without_implausible(Odometry(t, *steps), remarks)
    twist = (values[role] for role in ("v", "omega", "vy") if role in values)
    return without_implausible(Odometry(t, *twist), remarks)


def bearings(
    values: Mapping[str, np.ndarray], camera: Camera | None = None, shape: tuple[int, int] = (0, 0)
) -> dict[str, np.ndarray]:
    """Return bearing, elevation and sigma [rad], and range [m] of sightings, as far as known.

    Each is (n,). `values` are forward, left (or right) and optionally up of positions [m]; column
    and row of pixels of a `camera`; or corners (n, 4, 2) of tags, with the sigma of their
    coordinates [px] and optionally the size of the tags [m]. A bearing stays as it is. NaN at the
    origin and for pixels without a ray; `shape` is height and width of the image.
    """
    found = {role: values[role] for role in ("bearing", "sigma") if role in values}
    if "forward" in values:
        forward = values["forward"]
        left = values["left"] if "left" in values else -values["right"]
        ranges = np.where((left == 0) & (forward == 0), np.nan, np.hypot(left, forward))
        found |= {"bearing": np.arctan2(left, forward) + 0 * ranges, "range": ranges}
        return found | ({"elevation": np.arctan2(values["up"], ranges)} if "up" in values else {})
    if camera is not None and "corners" in values:
        corners = values["corners"]
        bearing, sigma = tag_bearings(corners, values["sigma"], camera, shape)
        elevation = tag_directions(corners, camera, shape)[1]
        found = {"bearing": bearing, "elevation": elevation, "sigma": sigma}
        if "size" in values:
            found["range"] = tag_ranges(corners, values["size"], camera, shape)
    elif camera is not None:
        seen = camera.directions(values["column"], values["row"], shape)
        found["bearing"], found["elevation"] = seen
    return found
