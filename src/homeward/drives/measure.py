"""Odometry and sightings from columns by role, of a table as of messages, levelled for tilt.

A robot tilted by a small angle w turns the bearing of a landmark at elevation e by up to w tan e.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from homeward.drives.cameras.camera import (
    tag_bearings,
    tag_directions,
    tag_ranges,
    unit_vectors,
)
from homeward.drives.cameras.lens import Lens
from homeward.drives.drive import Odometry, Sightings, Tilt
from homeward.drives.plausibility import odometry_from_poses, without_implausible
from homeward.drives.settings import DriveSettings, Wheels
from homeward.drives.wheels import swerve
from homeward.errors import InputError
from homeward.geometry.angles import wrap
from homeward.odometry.validity import TWIST_VALIDITY_S


def motion(values: Mapping[str, np.ndarray], wheels: Wheels, remarks: dict[str, int]) -> Odometry:
    """Return the odometry of columns (n,) in SI units; implausible motion is unknown.

    Times `t` increase strictly. The others are v, omega and vy of twists; x, y and heading of
    poses; v and steering; module_1_speed, module_1_angle, ... of swerve modules; or the sums of
    distance and turn.
    """
    t = values["t"]
    if "steering" in values:
        # The speed is that of the rear axle's centre, and steering is positive to the left.
        omega = values["v"] * np.tan(values["steering"]) / (wheels.wheelbase or math.nan)
        return without_implausible(Odometry(t, values["v"], omega), remarks)
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


POINT = ("column", "row")
CORNERS = tuple(f"{role}{k}" for k in range(4) for role in POINT)
"""Roles of the corners of tags, in order round each."""


def corners_of(values: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the corners of tags, (n, 4, 2) [px]."""
    return np.stack([values[role] for role in CORNERS], axis=1).reshape(-1, 4, 2)


def bearings(values: Mapping[str, np.ndarray], lens: Lens | None = None) -> dict[str, np.ndarray]:
    """Return bearing, elevation and sigma [rad], and range [m] of sightings, as far as known.

    Each is (n,). `values` are forward, left (or right) and optionally up of positions [m]; column
    and row of pixels of a `lens`; or `CORNERS` of tags, with the sigma of their coordinates [px]
    and optionally the size of the tags [m]. A bearing stays as it is. NaN at the origin and for
    pixels without a ray.
    """
    found = {role: values[role] for role in ("bearing", "sigma") if role in values}
    if "forward" in values:
        forward = values["forward"]
        left = values["left"] if "left" in values else -values["right"]
        ranges = np.where((left == 0) & (forward == 0), np.nan, np.hypot(left, forward))
        found |= {"bearing": np.arctan2(left, forward) + 0 * ranges, "range": ranges}
        return found | ({"elevation": np.arctan2(values["up"], ranges)} if "up" in values else {})
    if lens is not None and "column0" in values:
        corners, shape = corners_of(values), (0, 0)  # on which a lens does not depend
        bearing, sigma = tag_bearings(corners, values["sigma"], lens, shape)
        elevation = tag_directions(corners, lens, shape)[1]
        found = {"bearing": bearing, "elevation": elevation, "sigma": sigma}
        if "size" in values:
            found["range"] = tag_ranges(corners, values["size"], lens, shape)
    elif lens is not None:
        found["bearing"], found["elevation"] = lens.directions(values["column"], values["row"])
    return found


WINDOW_S = 1.0
"""Duration over which rotations are compared [s]."""
MIN_TURN_RATE = 0.02
"""Minimum standard deviation of the odometry's yaw rate for a comparison [rad/s]."""
MIN_WINDOWS = 10
MIN_CORRELATION = 0.5
MAX_RATIO = 4.0
"""Maximum ratio of the two yaw rates: robots that skid have 3."""
UNITS = {1.0: "", math.radians(1.0): ", converted from deg/s"}
"""Factors to rad/s that are tried, and how they are shown to the user."""
REPLACED = "yaw rates of the odometry replaced by those of {} ({})"
KEPT = "yaw rates of the odometry kept where {} has gaps"
NOT_COMPARED = "in rad/s, anti-clockwise: the odometry turns too little for a comparison"


def with_yaw_rate(
    odometry: Odometry,
    t: np.ndarray,
    rate: np.ndarray,
    source: str,
    remarks: dict[str, int],
    may_be_deg: bool = True,
) -> Odometry:
    """Return odometry with the yaw rate of a gyroscope, whose unit and sign are found.

    `t` (n,) [s] increases strictly; `rate` (n,) is in rad/s, or deg/s if `may_be_deg`, with either
    sign. Both come from a comparison with the odometry's own yaw rate, and remarks report them. The
    odometry keeps its own yaw rate in gaps of the gyroscope. `InputError` where the two contradict
    each other.
    """
    gyro = _mean_rates(odometry.t, t, rate)
    used = np.isfinite(gyro)
    if not used.any():
        advice = "use stamps of one clock"
        raise InputError(f"{source} has no yaw rate during the odometry", advice=advice)
    factor, how = _factor(odometry, t, rate, source, list(UNITS)[: 1 + may_be_deg])
    remarks[REPLACED.format(source, how)] = int(used.sum())
    if not used.all():
        remarks[KEPT.format(source)] = int((~used).sum())
    omega = np.where(used, factor * gyro, odometry.omega)
    omega = np.where(np.isnan(odometry.v), np.nan, omega)
    return Odometry(odometry.t, odometry.v, omega, odometry.vy)


def _mean_rates(edges: np.ndarray, t: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """Return the mean rate from each edge (m,) to the next, the last to itself; NaN in gaps."""
    if t.size < 2:
        return np.full(edges.size, np.nan)
    angle = np.append(0.0, np.cumsum(np.diff(t) * (rate[1:] + rate[:-1]) / 2))
    ends = np.minimum(np.append(edges[1:], edges[-1]), edges + TWIST_VALIDITY_S)
    span = ends - edges
    turned = np.interp(ends, t, angle) - np.interp(edges, t, angle)
    mean = np.where(span > 0, turned / np.where(span > 0, span, 1.0), np.interp(edges, t, rate))
    before = np.clip(np.searchsorted(t, edges, "right") - 1, 0, t.size - 1)
    after = np.clip(np.searchsorted(t, ends), 0, t.size - 1)
    is_covered = np.maximum(np.abs(edges - t[before]), np.abs(t[after] - ends)) < TWIST_VALIDITY_S
    return np.where(is_covered, mean, np.nan)


def _factor(
    odometry: Odometry, t: np.ndarray, rate: np.ndarray, source: str, units: Sequence[float]
) -> tuple[float, str]:
    """Return the factor to rad/s, anti-clockwise, and its reason as shown to the user."""
    begin, end = max(odometry.t[0], t[0]), min(odometry.t[-1], t[-1])
    edges = np.arange(begin, end, WINDOW_S)
    if edges.size <= MIN_WINDOWS:
        return 1.0, NOT_COMPARED
    steps = np.diff(odometry.t) * np.nan_to_num(odometry.omega)[:-1]
    own = np.diff(np.interp(edges, odometry.t, np.append(0.0, np.cumsum(steps))))
    gyro = _mean_rates(edges, t, rate)[:-1] * WINDOW_S
    both = np.isfinite(gyro)
    own, gyro = own[both], gyro[both]
    if own.size < MIN_WINDOWS or own.std() < MIN_TURN_RATE * WINDOW_S:
        return 1.0, NOT_COMPARED
    if gyro.std() == 0:
        problem = "the yaw rate is constant, but the odometry turns"
        raise InputError(problem, part=source, advice="leave it out")
    correlation = float(np.corrcoef(own, gyro)[0, 1])
    ratio = own.std() / gyro.std()
    unit = min(units, key=lambda u: abs(math.log(ratio / u)))
    if abs(correlation) < MIN_CORRELATION:
        raise InputError(
            f"the yaw rate contradicts that of the odometry (correlation {correlation:.2f})",
            part=source,
            advice="check that its z axis is vertical and its stamps are those of the "
            "odometry's clock, or leave it out",
        )
    if not 1 / MAX_RATIO < ratio / unit < MAX_RATIO:
        problem = f"the yaw rate of the odometry is {ratio:.3g} x this one"
        advice = "convert it to rad/s, correct the track width of the odometry, or leave it out"
        raise InputError(problem, part=source, advice=advice)
    inverted = ", with the sign inverted" if correlation < 0 else ""
    fit = f"correlation {abs(correlation):.2f}, {ratio / unit:.3g} x they fit the odometry"
    how = f"{fit}{UNITS[unit]}{inverted}"
    return math.copysign(unit, correlation), how


TAN_ELEVATION = 0.5
"""Tangent of the elevation that is assumed where it is unknown: 27 degrees."""
MAX_TILT = math.radians(5.0)
"""Beyond this tilt, bearings of unknown elevation are unreliable [rad]."""
CORRECTED = "bearings corrected for the roll and pitch of the robot"
NOISIER = "bearings without an elevation: the roll and pitch of the robot are added to their noise"
UNRELIABLE = (
    f"bearings without an elevation while the robot was tilted by more than"
    f" {math.degrees(MAX_TILT):g} degrees: they are unreliable"
)


def levelled(
    seen: Sightings, tilt: Tilt, settings: DriveSettings, remarks: dict[str, int]
) -> Sightings:
    """Return sightings with bearings as seen by a level robot; `remarks` counts the changes.

    `settings` have the yaw of the cameras, and the standard deviation of bearings without their
    own.
    """
    yaw, sigma = np.full(seen.t.size, settings.sensor.yaw), settings.sensor.bearing_sigma
    for name, camera in settings.cameras.items():
        yaw[seen.camera == name] = camera.yaw
    own = seen.sigma if sigma is None else np.where(np.isnan(seen.sigma), sigma, seen.sigma)
    roll, pitch = (np.interp(seen.t, tilt.t, angle) for angle in (tilt.roll, tilt.pitch))
    bearing, sigmas = level(seen.bearing, seen.elevation, own, yaw, (roll, pitch))
    known = np.isfinite(seen.elevation)
    large = ~known & (np.hypot(roll, pitch) > MAX_TILT)
    for words, which in ((CORRECTED, known), (NOISIER, ~known), (UNRELIABLE, large)):
        if which.any():
            remarks[words] = int(which.sum())
    sigmas = np.where(known, seen.sigma, sigmas)
    nothing = np.full(seen.t.size, np.nan)
    return dataclasses.replace(seen, bearing=bearing, sigma=sigmas, elevation=nothing)


def level(
    bearing: np.ndarray,
    elevation: np.ndarray,
    sigma: np.ndarray,
    yaw: np.ndarray | float,
    tilt: tuple[np.ndarray | float, np.ndarray | float],
) -> tuple[np.ndarray, np.ndarray]:
    """Return bearings as seen by a level robot, and their standard deviations [rad], (n,) each.

    `yaw` is that of the camera on the robot, `tilt` its roll and pitch [rad]. Where the elevation
    is NaN, the bearing stays, and sigma grows.
    """
    (roll, pitch), known = tilt, np.isfinite(elevation)
    x, y, z = unit_vectors(bearing + yaw, np.where(known, elevation, 0.0)).T
    y, z = np.cos(roll) * y - np.sin(roll) * z, np.sin(roll) * y + np.cos(roll) * z
    turned = wrap(np.arctan2(y, np.cos(pitch) * x + np.sin(pitch) * z) - yaw)
    noisier = np.hypot(sigma, TAN_ELEVATION * np.hypot(roll, pitch))
    return np.where(known, turned, bearing), np.where(known, sigma, noisier)


def roll_and_pitch(q: Any) -> tuple[float, float]:
    """Return roll and pitch [rad] of a quaternion; NaN for a zero one."""
    norm = q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w
    if not norm > 0:
        return math.nan, math.nan
    roll = math.atan2(2 * (q.w * q.x + q.y * q.z), norm - 2 * (q.x * q.x + q.y * q.y))
    return roll, math.asin(max(-1.0, min(1.0, 2 * (q.w * q.y - q.z * q.x) / norm)))
