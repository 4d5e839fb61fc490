"""Calibration of a robot: estimates from a map or from ground truth, and their combination.

A value that is constant in each drive, but differs between drives, has a random-effects mean
(DerSimonian and Laird 1986). Its standard deviation is that of the next drive's value.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from homeward.drives.drive import Drive, Odometry, Truth
from homeward.drives.settings import OdometryDefaults, RobotSettings, Wheels
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, between
from homeward.geometry.statistics import MAD_TO_SIGMA, ROUNDING, robust_weight
from homeward.localizer.localizer import Localizer
from homeward.localizer.motions import (
    CAMERA_X,
    CAMERA_Y,
    CAMERA_YAW,
    DELAY,
    NC,
    SIDEWAYS_SCALE,
    SPEED_SCALE,
    TIME_CONSTANT,
    TURN_BIAS,
    TURN_SCALE,
    TURN_SLIP,
)
from homeward.localizer.settings import LocalizerSettings
from homeward.localizer.tunables import MIN_CALIBRATION_SIGMA
from homeward.odometry.history import dead_reckoning, dead_reckoning_unwrapped

WINDOW_S = 4.0
"""Length of the motions that are compared with ground truth [s]: far longer than a lag."""
LAGS_S = sorted((0.05 * k for k in range(-10, 11)), key=abs)
"""Lags of the odometry behind the ground truth that are compared [s]."""
MAX_TURN = 2.5
"""Largest rotation in such a window, below half a turn [rad]."""
MIN_DELAY = 2.0
"""Smallest delay or time constant that is corrected [standard deviations]."""
PARTS = 8
"""Parts of such a window for its path and rotation: in each, the motion is nearly an arc."""
NUM_GROUPS = 20
"""Groups of windows of the jackknife."""
ROBUST_STEPS, ROBUST_SCALE = 10, 3.0
"""Steps of the robust fit of paths, whose weights converge; and its scale, as residuals of normal
errors hardly exceed it [standard deviations]."""
MIN_EXPLAINED = 0.9
"""Smallest share of the variance of rotations that the odometry's explain, for a scale of them: of
a robot that hardly turns, or turns at one rate, they are noise, which makes the scale too small."""
MIN_VARIATION = 4.0
"""Smallest standard deviation of rotations about their mean rate for a scale from the map, over
that by noise [1]: noise makes the scale too small by the inverse of its square."""
MIN_SLIP = 2.0
"""Smallest slip in bends that is corrected [standard deviations]."""
LAG, LATE = "odometry.time_constant", "bearings_late"
"""Keys of the time constant and of the delay."""
DEFAULT = OdometryDefaults()
ASSUMED = {
    "odometry.speed_scale": DEFAULT.speed_scale,
    "odometry.turn_scale": DEFAULT.turn_scale,
    "odometry.turn_bias": DEFAULT.turn_bias,
    "odometry.turn_slip": DEFAULT.turn_slip,
    "odometry.sideways_scale": DEFAULT.sideways_scale,
    LATE: LocalizerSettings().delay_sigma,
    LAG: LocalizerSettings().time_constant_sigma,
    "sensor.x": math.inf,
    "sensor.y": math.inf,
    "sensor.yaw": math.inf,
}
"""Keys of the calibration, and the standard deviations that are assumed without an estimate."""
STATES = (
    *(SPEED_SCALE, TURN_SCALE, TURN_BIAS, TURN_SLIP, SIDEWAYS_SCALE, DELAY, TIME_CONSTANT),
    *(CAMERA_X, CAMERA_Y, CAMERA_YAW),
)
"""The state of the localiser for each of them."""
SIGMA_KEYS = {LATE: "odometry.delay_sigma"}
"""Keys of standard deviations that are not the key of the value with _sigma at its end."""


class Value(NamedTuple):
    """An estimate."""

    mean: float
    sigma: float


Estimates = dict[str, Value]
"""Estimates by key of `ASSUMED`, those no better than the assumption are missing."""


def estimates(drive: Drive, localizer: Localizer) -> Estimates:
    """Return the estimates of a drive that an uncalibrated localiser has processed.

    Those from ground truth replace those from the map. The scale of the speed needs ground truth, a
    survey, measured distances, or ranges of a known scale; that of the sideways speed, relative to
    it, is from the map of a robot that strafes; camera extrinsics are estimated where
    they are not given and the bearings contradict zero.
    """
    found = _from_map(localizer)
    if not _varies(drive.odometry, localizer.calibration().process_rates):
        found.pop("odometry.turn_scale", None)
    by_truth = {} if drive.truth is None else _from_truth(drive.odometry, drive.truth)
    if by_truth:  # its scale is that next to its own slip
        found.pop("odometry.turn_slip", None)
    return found | by_truth


def _from_map(localizer: Localizer) -> Estimates:
    """Return the estimates of a map; the information of the prior is removed from them.

    The delay is that of odometry with its time constant: of all twists in the mean, which is known
    better than either.
    """
    known, both = localizer.calibration(), np.eye(NC)
    both[DELAY, TIME_CONSTANT] = 1.0
    means = both @ known.mean
    variances = (both @ known.covariance @ both.T).diagonal()
    priors = np.maximum(both @ known.priors, MIN_CALIBRATION_SIGMA**2)  # as in the map
    found = {}
    for key, at in zip(ASSUMED, STATES, strict=True):
        precision = 1.0 / float(variances[at])
        own = precision - 1.0 / float(priors[at])
        if own > ROUNDING * precision and known.is_open[at]:
            mean = float(means[at] / variances[at]) / own
            found[key] = Value(float(key.endswith("_scale")) + mean, own**-0.5)
    return _informative(found)


def _from_truth(odometry: Odometry, truth: Truth) -> Estimates:
    """Return the corrections of the odometry by the motions of the ground truth.

    Odometry may act late: the lag with which rotations fit best counts, or, if these are not known
    well enough, paths. Slip in bends is estimated together with the speed scale, and left out where
    it may be zero.
    """
    t = truth.t[(truth.t >= odometry.t[0]) & (truth.t <= odometry.t[-1])]
    t = t[np.unique(np.searchsorted(t, np.arange(t[0], t[-1], WINDOW_S)))] if t.size else t
    steps, true, reckoned = np.diff(t), _steps(truth.at(t)), _steps(dead_reckoning(odometry, t))
    moved = np.hypot(reckoned.x, reckoned.y) + np.abs(reckoned.heading) > 0.0
    used = moved & (np.abs(reckoned.heading) < MAX_TURN) & (steps < 2.0 * WINDOW_S)
    used &= np.isfinite(true.x + true.heading)
    if used.sum() < NUM_GROUPS:
        return {}
    by = true.heading[used]

    def turned(lag: float) -> np.ndarray:
        heading = _steps(dead_reckoning(odometry, t - lag)).heading
        return np.asarray(np.stack([heading, steps], axis=1)[used])

    def misfit(lag: float) -> float:
        return float(np.linalg.lstsq(turned(lag), by, rcond=None)[1].sum())

    def driven(lag: float) -> np.ndarray:
        return _driven(dead_reckoning(odometry, _fine(t) - lag))[:, used]

    lag, true_path = min(LAGS_S, key=misfit), _driven(truth.at(_fine(t)))[0, used]
    is_turning = _explained(by, *turned(lag).T) > MIN_EXPLAINED
    if not is_turning:
        lag = max(LAGS_S, key=lambda lag: _explained(true_path, *driven(lag)))
    turns, (path, rotation) = turned(lag), driven(lag)

    def fitted(rows: np.ndarray, with_slip: bool) -> np.ndarray:
        turn, *_ = np.linalg.lstsq(turns[rows], by[rows], rcond=None)
        lost = -np.sign(path) * abs(turn[0]) * rotation if with_slip else np.zeros(by.size)
        scale, slip = _robust(np.stack([path, lost], axis=1)[rows], true_path[rows])
        return np.array([scale, *turn, slip])

    def estimated(with_slip: bool) -> Estimates:
        every = np.arange(by.size)
        groups = np.array_split(every, NUM_GROUPS)
        without = [fitted(np.delete(every, group), with_slip) for group in groups]
        sigmas = math.sqrt(NUM_GROUPS - 1) * np.std(without, axis=0)
        values = map(Value, fitted(every, with_slip).tolist(), sigmas.tolist())
        return dict(zip(ASSUMED, values, strict=False))

    if not is_turning:
        key = "odometry.speed_scale"
        return _informative({key: estimated(with_slip=False)[key]})
    found = estimated(with_slip=True)
    slip = found["odometry.turn_slip"]
    if slip.mean < MIN_SLIP * slip.sigma:
        slip = Value(0.0, math.hypot(*slip))
        found = estimated(with_slip=False)
    return _informative(found | {"odometry.turn_slip": slip})


def _varies(odometry: Odometry, process_rates: np.ndarray) -> bool:
    """Whether the yaw rate varies beyond its noise; rates as those of the localiser (3, 3)."""
    known = odometry.bridged
    t = np.arange(known.t[0], known.t[-1], WINDOW_S)
    turned = np.diff(dead_reckoning_unwrapped(known, t).heading)
    speed, rate = np.hypot(known.v, known.vy).mean(), np.abs(known.omega).mean()
    variance = WINDOW_S * float(process_rates[2] @ [1.0, speed, rate])
    return turned.size > 1 and float(np.var(turned)) > MIN_VARIATION**2 * variance


def _explained(true: np.ndarray, found: np.ndarray, other: np.ndarray) -> float:
    """Return the share of the variance of `true` that `found` explains next to `other`, (n,)."""
    across = np.eye(true.size) - np.outer(other, other) / max(other @ other, 1e-12)
    true, found = across @ true, across @ found
    return float((true @ found) ** 2 / max((true @ true) * (found @ found), 1e-300))


def _robust(columns: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """Return the coefficients (k,) of a robust linear fit of columns (n, k).

    A robot that collides or is carried contradicts any calibration.
    """
    weights = np.ones(measured.size)
    for _ in range(ROBUST_STEPS):
        root = np.sqrt(weights)
        found = np.linalg.lstsq(root[:, None] * columns, root * measured, rcond=None)[0]
        off = np.abs(measured - columns @ found)
        scale = ROBUST_SCALE * MAD_TO_SIGMA * max(float(np.median(off)), 1e-6)
        weights = robust_weight((off / scale) ** 2)
    return np.asarray(found)


def _fine(t: np.ndarray) -> np.ndarray:
    """Return each interval of times (n,) divided into `PARTS`, (PARTS (n - 1) + 1,)."""
    return np.asarray(np.interp(np.arange(PARTS * (t.size - 1) + 1) / PARTS, np.arange(t.size), t))


def _driven(poses: Pose) -> np.ndarray:
    """Return path [m] and rotation [rad] in each interval of times, by poses at `_fine` ones."""
    step = _steps(poses)
    parts = np.stack([_arc(step), np.abs(step.heading)]).reshape(2, -1, PARTS)
    return np.asarray(parts.sum(axis=2))


def _steps(pose: Pose) -> Pose:
    """Return the motions (n - 1,) between successive poses (n,)."""
    step = between(Pose(*(a[:-1] for a in pose)), Pose(*(a[1:] for a in pose)))
    return step._replace(heading=wrap(step.heading))


def _arc(motion: Pose) -> np.ndarray:
    """Return the signed lengths of arcs (n,) from their start to poses `motion` [m]."""
    half = 0.5 * motion.heading
    chord = motion.x * np.cos(half) + motion.y * np.sin(half)
    return np.asarray(chord / np.sinc(half / math.pi))


def _informative(found: Estimates) -> Estimates:
    """Return the estimates that are better than the assumption without them."""
    return {key: value for key, value in found.items() if value.sigma < ASSUMED[key]}


def combined(found: Sequence[Estimates], parts: Sequence[Estimates]) -> Estimates:
    """Return the mean of each value over drives, with its standard deviation in the next one.

    `parts` are the estimates of parts of the drives, whose differences give the variance between
    drives: a single drive has parts, too.
    """
    result = {}
    for key in dict.fromkeys(key for one in found for key in one):
        mean, weight = _weighed(found, key)
        between_drives = 0.0
        part, of_part = _weighed(parts, key)
        if part.size > 1:
            surplus = of_part @ (part - of_part @ part / of_part.sum()) ** 2 - part.size + 1
            freedom = of_part.sum() - of_part @ of_part / of_part.sum()
            if freedom > ROUNDING * of_part.sum():  # else one part alone has all the weight
                between_drives = max(0.0, float(surplus / freedom))
        weight = 1.0 / (1.0 / weight + between_drives)
        sigma = math.sqrt(between_drives + 1.0 / weight.sum())
        result[key] = Value(float(weight @ mean / weight.sum()), sigma)
    return result


def _weighed(found: Sequence[Estimates], key: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the estimates of a key, and their weights, (n,) each."""
    values = np.array([e[key] for e in found if key in e]).reshape(-1, 2)
    return values[:, 0], 1.0 / np.maximum(values[:, 1], 1e-9) ** 2


def as_keys(found: Estimates) -> dict[str, float | None]:
    """Return the keys of robot.yaml, each value to two digits of its standard deviation.

    A delay that may be zero is None, and not corrected: stamps stay as recorded. A time constant
    that may be zero is left out; the delay is that without it. Slip is at least zero.
    """
    keys: dict[str, float | None] = {}
    lag = found.get(LAG)
    if lag is not None and lag.mean < MIN_DELAY * lag.sigma:
        found = {key: value for key, value in found.items() if key != LAG}
    elif lag is not None and LATE in found:
        both = found[LATE]
        sigma = math.hypot(both.sigma, lag.sigma)
        found = found | {LATE: Value(both.mean - lag.mean, sigma)}
    for key, (mean, sigma) in found.items():
        if key == LATE and abs(mean) < MIN_DELAY * sigma:
            keys |= {key: None, SIGMA_KEYS[key]: float(f"{math.hypot(mean, sigma):.2g}")}
            continue
        digits = 1 - math.floor(math.log10(max(sigma, 1e-9)))
        keys[key] = round(mean, digits) + 0.0  # no -0
        keys[SIGMA_KEYS.get(key, f"{key}_sigma")] = round(sigma, digits)
    return keys


def for_other_tools(robot: RobotSettings) -> dict[str, str]:
    """Return the calibration in the terms of diff_drive_controller, URDF and `import --wheels`."""
    odometry, camera, wheels = robot.odometry, robot.sensor, robot.wheels or Wheels()
    found = {}
    speed, turn = odometry.speed_scale, odometry.turn_scale
    of_gyro = wheels != Wheels() and wheels.without_turns == wheels
    if speed is not None and turn is not None and not of_gyro:
        found["diff_drive_controller"] = (
            f"wheel_separation_multiplier: {speed / turn:.4f}, "
            f"left_wheel_radius_multiplier: {speed:.4f}, right_wheel_radius_multiplier: {speed:.4f}"
        )
    relative = (odometry.speed_scale_sigma or 0.0) / (speed or 1.0)
    if speed is not None and wheels.wheel_radius is not None:
        found["wheel_radius"] = _metres(wheels.wheel_radius * speed, relative)
    relative = math.hypot(relative, (odometry.turn_scale_sigma or 0.0) / (turn or 1.0))
    for name in ("track_width", "wheelbase"):
        width = getattr(wheels, name)
        if width is not None and speed is not None and turn is not None:
            found[name] = _metres(width * speed / turn, relative)
    if camera.model_fields_set & {"x", "y", "yaw"}:
        origin = f'<origin xyz="{camera.x:.4g} {camera.y:.4g} 0" rpy="0 0 {camera.yaw:.4g}"/>'
        found["URDF, joint of the camera, in the plane"] = origin
    return found


def _metres(value: float, relative: float) -> str:
    """Return a length with its standard deviation as text."""
    return f"{value:.4g} +- {relative * value:.2g} m"
