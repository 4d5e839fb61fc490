"""Camera extrinsics for filters that assume the camera at the robot's centre.

A camera away from the centre is itself a unicycle: it moves on an arc, in a direction that differs
from the robot's heading by a known angle. `of_camera` describes a drive as that of its camera,
sample by sample, and `of_robot` returns the poses of the robot. Both are exact: where the angle
changes, the drive has a rotation on the spot of `TURN_S`.
"""

import math
from dataclasses import replace

import numpy as np

from homeward.drives.drive import Drive, Odometry
from homeward.drives.settings import Mount, Sensor, Start
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, compose, from_polar, inverse, to_polar
from homeward.track import Track

TURN_S = 1e-6  # duration of a rotation on the spot [s]


def is_offset(drive: Drive) -> bool:
    mounts = drive.settings.sensor, drive.settings.home_mount
    return any(mount.x or mount.y for mount in mounts)


def _directions(drive: Drive) -> np.ndarray:
    """Return the camera's direction of motion from the robot's heading at each twist [rad]."""
    o, mount = drive.odometry.bridged, drive.settings.sensor
    ahead, left = o.v - o.omega * mount.y, o.omega * mount.x
    moves = np.hypot(ahead, left) > 0.0
    angle = np.where(ahead < 0.0, np.arctan2(-left, -ahead), np.arctan2(left, ahead))
    last = np.maximum.accumulate(np.where(moves, np.arange(o.t.size), -1))
    return np.where(last < 0, 0.0, angle[last])


def _at(drive: Drive, t: np.ndarray) -> np.ndarray:
    """Return that direction at times (n,) [s]; at a twist's stamp, that of the twist before."""
    before = np.searchsorted(drive.odometry.t + TURN_S / 2, t) - 1
    return _directions(drive)[np.maximum(before, 0)]


def of_camera(drive: Drive) -> Drive:
    """Return the drive of the camera, whose home is where the camera was at home."""
    o, mount, turned = drive.odometry.bridged, drive.settings.sensor, _directions(drive)
    ahead, left = o.v - o.omega * mount.y, o.omega * mount.x
    speed = np.where(ahead < 0.0, -1.0, 1.0) * np.hypot(ahead, left)
    turns = np.flatnonzero(np.diff(turned, prepend=turned[:1]))
    spin = wrap(turned[turns] - turned[turns - 1]) / TURN_S
    later = o.t.copy()
    later[turns] += TURN_S
    t = np.concatenate([later, o.t[turns]])
    v, omega = np.concatenate([speed, 0.0 * spin]), np.concatenate([o.omega, spin])
    order = np.argsort(t, kind="stable")
    seen = drive.sightings
    yaw, home_yaw = mount.yaw, drive.settings.home_mount.yaw
    home = {i: replace(b, bearing=float(wrap(b.bearing + home_yaw))) for i, b in drive.home.items()}
    known = drive.settings.sensor
    settings = drive.settings.model_copy(
        update={
            "sensor": Sensor(bearing_sigma=known.bearing_sigma, field_of_view=known.field_of_view),
            "home_sensor": Mount(),
            "start": _start(drive),
        }
    )
    return replace(
        drive,
        odometry=Odometry(t[order], v[order], omega[order]),
        sightings=replace(seen, bearing=wrap(seen.bearing + yaw - _at(drive, seen.t))),
        home=home,
        settings=settings,
    )


def camera_pose(drive: Drive, robot: Pose, t: float) -> Pose:
    """Return the camera's position and direction of motion at `t` [s], from the camera at home."""
    mount, at_home = drive.settings.sensor, drive.settings.home_mount
    x, y, heading = compose(robot, Pose(mount.x, mount.y, float(_at(drive, np.array([t]))[0])))
    return Pose(x - at_home.x, y - at_home.y, heading)


def _start(drive: Drive) -> Start | None:
    """Return the start prior of the camera, as wide as that of the robot."""
    start, mount = drive.settings.start, drive.settings.sensor
    if start is None:
        return None
    polar = to_polar(camera_pose(drive, from_polar(start.polar), drive.span[0]))
    lever = math.hypot(mount.x, mount.y) * start.sigma_alpha
    across = math.hypot(start.R * start.sigma_theta, lever)
    return Start(
        R=float(polar.R),
        theta=float(polar.theta),
        alpha=float(polar.alpha),
        sigma_R=math.hypot(start.sigma_R, lever),
        sigma_theta=across / max(float(polar.R), 1e-3),
        sigma_alpha=start.sigma_alpha,
    )


def of_robot(track: Track, drive: Drive) -> Track:
    """Return the track of the robot from that of the camera, `of_camera(drive)`."""
    mount, at_home = drive.settings.sensor, drive.settings.home_mount
    camera = Pose(track.x + at_home.x, track.y + at_home.y, track.heading)
    x, y, heading = compose(camera, inverse(Pose(mount.x, mount.y, _at(drive, track.t))))
    lever = np.tile(np.eye(3), (track.t.size, 1, 1))
    lever[:, 0, 2], lever[:, 1, 2] = camera.y - y, x - camera.x
    covariance = lever @ track.covariance @ np.swapaxes(lever, 1, 2)
    return replace(track, x=x, y=y, heading=heading, covariance=covariance)
