"""Plausibility of odometry and of stamps that were recorded together.

Motion beyond the limits of ground robots counts as unknown: the restart of an encoder, a pose
reset, or a spike of a driver appears as a motion of metres within one sample. Bearings cannot
correct such a motion within seconds.
"""

from __future__ import annotations

import dataclasses
import math
import warnings
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from homeward.drives.drive import Drive, Odometry, is_slow
from homeward.drives.settings import OdometryDefaults
from homeward.errors import InputError
from homeward.geometry.angles import wrap
from homeward.odometry.validity import (
    MAX_ACCELERATION,
    MAX_SPEED,
    MAX_TURN_ACCELERATION,
    MAX_TURN_RATE,
    MAX_TWIST_VALIDITY_S,
    TWIST_VALIDITY_S,
    twist_validity,
)

MAX_CLOCK_OFFSET_S = 5.0
"""Maximum gap between two recordings of one drive [s]."""
OUTSIDE = "sightings at times without odometry; check the clock and unit of their stamps"
MAX_INTERVAL_S, MIN_TWISTS = 2.0 * TWIST_VALIDITY_S, 10
"""Maximum median interval of usable odometry [s]: a twist is valid for about half of it. With fewer
than this number of twists the interval is not tested."""
DAY_S = 86400.0
MAX_JUMP_S = 7 * DAY_S
"""Maximum gap of odometry [s]; at a longer one, the clock was set."""
UNITS = {1e3: "milliseconds", 1e6: "microseconds", 1e9: "nanoseconds"}
"""Units of stamps by their number in a second."""
TOO_RARE = (
    "odometry rows with a median interval of {:,.1f} s, of which each is valid for at most {:g} s; "
    "convert the stamps to seconds if they are in {}"
)
ODOMETRY_ROWS = "odometry rows"
SLOW_ODOMETRY = (
    ODOMETRY_ROWS + " with a median interval of {:.1f} s: each is used until the next, for at most "
    "{:g} s, and poses are less certain; record odometry at 2 Hz or more"
)
SLOW_TRUTH = (
    "rows of ground truth with a median interval of {:.1f} s, too long to interpolate: errors are "
    "computed at these times only"
)
ROUNDED = (
    "odometry rows with speeds in steps of {:.3g} m/s, coarse for this robot: distances may have "
    "an error of {:.0%}; record more digits, or poses"
)
IMPLAUSIBLE = (
    "Odometry reported impossible motion {} times, first at {:.2f} s (speed or acceleration no "
    "wheeled robot has, or not a number). The motion up to the next twist was treated as unknown, "
    "so the pose is less certain there. Look for encoder resets, counter overflow, damaged "
    "messages, or speeds in another unit."
)
BEYOND_A_TURN = (
    "{} bearings beyond a full turn were wrapped: convert them to rad if they are in degrees."
)
RARE = (
    f"Odometry comes at intervals of more than {MAX_TWIST_VALIDITY_S:g} s, for which its motion is "
    "unknown: convert its stamps to seconds if they are in another unit."
)
FAST_TURNS = (
    "{:,} of {:,} twists have a yaw rate above 6.3 rad/s (360 degrees per second): convert omega"
    " to rad/s if it is in deg/s."
)
"""Notes on samples that come one by one, as to a localiser; the remarks are on whole files."""
OTHER_CLOCK = "use stamps of one clock in seconds, and files that were recorded together"


def require_overlap(
    spans: Mapping[str, tuple[float, float]], advice: str, path: Path | None = None
) -> None:
    """Raise InputError when a span begins over `MAX_CLOCK_OFFSET_S` after another one ends.

    `spans` are the first and last times [s] by name; the message ends with `advice`.
    """
    if not spans:
        return
    late, early = max(spans, key=lambda n: spans[n][0]), min(spans, key=lambda n: spans[n][1])
    apart = spans[late][0] - spans[early][1]
    if apart > MAX_CLOCK_OFFSET_S:
        problem = f"the first of {late} is {apart:,.1f} s after the last of {early}"
        raise InputError(problem, path, advice=advice)


def _require_steady(t: np.ndarray, path: Path) -> None:
    """Raise InputError where the clock of odometry stamps `t`, (n,), was set meanwhile."""
    steps = np.diff(t)
    if steps.size < MIN_TWISTS:
        return
    k, usual = int(steps.argmax()), float(np.median(steps))
    jump = float(steps[k])
    if jump <= max(MAX_JUMP_S, 1e3 * usual):  # all stamps may be in another unit
        return
    raise InputError(
        "the clock was set during the recording: stamps jump from "
        f"{float(t[k])!r} to {float(t[k + 1])!r} s, by {jump / DAY_S:,.0f} days",
        path,
        advice=f"leave out the {k + 1:,} odometry rows before the jump, and the sightings",
    )


def remark_other_units(t: np.ndarray, remarks: dict[str, int]) -> None:
    """Add a remark where odometry stamps `t`, (n,), seem to be in a smaller unit than seconds."""
    if t.size < MIN_TWISTS or (step := float(np.median(np.diff(t)))) <= MAX_INTERVAL_S:
        return
    unit = next((name for a_second, name in UNITS.items() if step <= a_second), "other units")
    remarks[TOO_RARE.format(step, twist_validity(np.diff(t).tolist()), unit)] = t.size


def _slow_remarks(drive: Drive) -> dict[str, int]:
    """Return remarks on slow odometry and ground truth."""
    remarks, t = {}, drive.odometry.t
    step = float(np.median(np.diff(t))) if t.size >= MIN_TWISTS else 0.0
    if step > TWIST_VALIDITY_S and not any(
        words.startswith(ODOMETRY_ROWS) for words in drive.remarks
    ):
        remarks[SLOW_ODOMETRY.format(step, twist_validity(np.diff(t).tolist()))] = t.size
    if drive.truth is not None and is_slow(drive.truth.t):
        step = float(np.median(np.diff(drive.truth.t)))
        remarks[SLOW_TRUTH.format(step)] = drive.truth.t.size
    return remarks


def rounding_error(odometry: Odometry) -> tuple[float, float]:
    """Return the step of rounded speeds [m/s], and the relative error of distances from it [1].

    Both are 0 where speeds are on no grid. Rounding is an error of variance step^2/12, which
    depends on the true speed: so it may be the same whenever the rounded speed is.
    """
    speed = np.abs(odometry.bridged.v)
    levels, level = np.unique(speed, return_inverse=True)
    levels = levels[levels > 0]
    if not 1 < levels.size <= MAX_LEVELS:
        return 0.0, 0.0
    step = float(np.diff(levels, prepend=0.0).min())
    changes = np.abs(np.diff(speed))[np.minimum(speed[1:], speed[:-1]) > 0] / step
    if np.abs(levels / step - np.round(levels / step)).max() > ON_GRID:
        return 0.0, 0.0
    if (np.abs(changes - 1.0) < ON_GRID).sum() < MIN_TWISTS:  # speeds that were commanded
        return 0.0, 0.0
    path = speed[:-1] * np.minimum(np.diff(odometry.t), TWIST_VALIDITY_S)
    of_level = np.bincount(level[:-1], path)[-levels.size :] / levels
    return step, step / math.sqrt(12.0) * float(np.linalg.norm(of_level) / path.sum())


def _with_rounding(drive: Drive) -> Drive:
    """Return a drive with a remark on coarse speeds, and the error of its scale from them."""
    step, error = rounding_error(drive.odometry)
    usual, known = OdometryDefaults(), drive.settings.odometry
    if error <= usual.speed_scale:
        return drive
    remarks = {**drive.remarks, ROUNDED.format(step, error): drive.odometry.t.size}
    if known.speed_scale_sigma is None:
        slip, scale = known.slip_sigma(usual.turn_slip), math.hypot(usual.speed_scale, error)
        sigmas = {"speed_scale_sigma": round(scale, 3), "turn_slip_sigma": slip}
        settings = {"odometry": known.model_copy(update=sigmas)}
        drive = dataclasses.replace(drive, settings=drive.settings.model_copy(update=settings))
    return dataclasses.replace(drive, remarks=remarks)


def with_clock_remarks(drive: Drive, path: Path) -> Drive:
    """Return a drive with remarks on its odometry and on sightings outside its time.

    `InputError` where bearings and odometry do not overlap.
    """
    odometry, seen = drive.odometry.t, drive.sightings.t
    if not (odometry.size and seen.size):
        return drive
    first, last = float(odometry[0]), float(odometry[-1])
    _require_steady(odometry, path)
    require_overlap(
        {"the odometry": (first, last), "the bearings": (float(seen[0]), float(seen[-1]))},
        OTHER_CLOCK,
        path,
    )
    drive = dataclasses.replace(drive, remarks={**drive.remarks, **_slow_remarks(drive)})
    drive = _with_rounding(drive)
    outside = int(((seen < first - MAX_CLOCK_OFFSET_S) | (seen > last + MAX_CLOCK_OFFSET_S)).sum())
    if 2 * outside <= seen.size:
        return drive
    return dataclasses.replace(drive, remarks={**drive.remarks, OUTSIDE: outside})


MAX_LEVELS = 100
"""Maximum number of rounded speeds that are examined: with more, rounding is below 1 %."""
ON_GRID = 0.1
"""Maximum deviation of a rounded speed from its grid, over the step [1]."""
MIN_JUMP, MIN_TURN_JUMP = 0.05, 0.1
"""Minimum jump [m, rad]; the noise model of filters covers smaller ones."""
SPEED_FACTOR = 3.0
"""Minimum speed limit, as a multiple of the speed that 95 % of the motion does not exceed."""
NOISE_FACTOR = 12.0
"""Minimum jump, as a multiple of the samples' median deviation from their neighbours; fewer than 1
sample of a million with Gaussian noise exceeds it."""
WINDOW_S, MAX_NEIGHBOURS = 0.5, 9
"""Neighbours of a sample on either side: those within this time [s], up to this number."""
USUAL_SPEED, USUAL_TURN_RATE, USUAL_EXCEEDED = 40.0, 6.3, 0.05
"""Maximum plausible rates [m/s, rad/s] (a car; one rotation a second). A robot that exceeds one in
this share of its moving time [1] probably reports other units."""
SPEED_UNIT = "odometry samples faster than 40 m/s; convert the speeds to m/s if they are in mm/s"
TURN_UNIT = (
    "odometry samples with a yaw rate above 6.3 rad/s; convert them to rad/s if they are in deg/s"
)
NO_SPEED = (
    "odometry samples, all with a speed of exactly 0; if the robot did not only turn on the spot, "
    "its speed is missing: add it"
)
SIDEWAYS = "poses of a robot that moves sideways; the sideways speed is computed, too"
UNKNOWN = (
    "odometry intervals with implausible motion (encoder reset, pose jump or spike; the first at "
    "{:.2f} s, at {:.3g} m/s and {:.3g} rad/s); their motion counts as unknown"
)


def without_implausible(odometry: Odometry, remarks: dict[str, int]) -> Odometry:
    """Return odometry with implausible motion set to unknown, and count it in `remarks`.

    Twists may be NaN already where the motion is unknown. Remarks also report rates that are
    probably in another unit, and a speed that is always zero while the robot turns.
    """
    t, v, omega, vy = odometry.t, odometry.v, odometry.omega, odometry.vy
    bad = _jumps(t, v, MAX_SPEED, MAX_ACCELERATION, MIN_JUMP)
    bad |= _jumps(t, omega, MAX_TURN_RATE, MAX_TURN_ACCELERATION, MIN_TURN_JUMP)
    if odometry.moves_sideways:
        bad |= _jumps(t, vy, MAX_SPEED, MAX_ACCELERATION, MIN_JUMP)
    speed = np.hypot(v, vy)
    for rate, limit, unit in (
        (speed, USUAL_SPEED, SPEED_UNIT),
        (omega, USUAL_TURN_RATE, TURN_UNIT),
    ):
        if _usual_rate(t[~bad], rate[~bad]) > limit:
            remarks[unit] = int((np.abs(rate) > limit).sum())
    if not np.any(speed > 0) and np.any(np.abs(omega) > 0):
        remarks[NO_SPEED] = t.size
    if not bad.any():
        return odometry
    i = int(np.argmax(bad))
    fast = speed[i] if vy[i] else v[i]
    remarks[UNKNOWN.format(t[i], fast, omega[i])] = int(bad.sum())
    return Odometry(t, *(np.where(bad, np.nan, rate) for rate in (v, omega, vy)))


def _usual_rate(t: np.ndarray, rate: np.ndarray) -> float:
    """Return the rate that is exceeded in 5 % of the moving time; 0 without motion."""
    duration = np.minimum(np.diff(t), TWIST_VALIDITY_S)
    rates = np.abs(rate[:-1])
    order = np.argsort(np.where(rates > 0, rates, -1.0))
    time = np.where(rates > 0, duration, 0.0)[order].cumsum()
    if not time.size or time[-1] <= 0:
        return 0.0
    return float(rates[order][time.searchsorted((1.0 - USUAL_EXCEEDED) * time[-1])])


def _jumps(
    t: np.ndarray, rate: np.ndarray, max_rate: float, max_acceleration: float, min_jump: float
) -> np.ndarray:
    """Return which samples of a rate are implausible, (n,): too fast, or a jump.

    A jump deviates from the median of the neighbours both before and after by more than
    acceleration and noise allow.
    """
    if t.size < 2:
        return np.asarray(np.abs(rate) > max_rate)
    steps = np.diff(t)
    moves = np.abs(rate) > 0
    # Positions may be published more often than they change; then a change covers several steps.
    changes = np.diff(t[moves]) if moves.sum() > 1 else steps
    typical = float(np.median(changes))
    # The median is too short for bursts of messages; the mean without standstill is correct.
    period = max(typical, float(np.minimum(changes, max(TWIST_VALIDITY_S, typical)).mean()))
    dt = np.append(steps, period)
    duration = np.maximum(dt, period)
    moved = rate * dt
    # Messages in a burst have stamps that are too close for their displacement.
    rate = moved / duration
    usual = float(np.quantile(np.abs(rate[moves]), 0.95)) if moves.any() else 0.0
    fast = np.abs(rate) > max(max_rate, SPEED_FACTOR * usual)
    count = int(np.clip(round(WINDOW_S / period), 1, MAX_NEIGHBOURS))
    before, after = _neighbours(rate, count)
    expected = np.stack([before * duration, after * duration])
    deviation = np.fmin(*np.abs(moved - expected))
    noise = float(np.nanmedian(deviation[moves])) if np.isfinite(deviation[moves]).any() else 0.0
    # A motion slower than expected is no jump: a gap precedes a burst of messages.
    usable = np.clip(moved, np.minimum(expected, 0.0), np.maximum(expected, 0.0))
    jump = np.fmin(*np.abs(moved - usable))
    with np.errstate(over="ignore"):  # absurd stamps
        allowed = max_acceleration * duration * np.maximum(duration, count * period) / 2
    return np.asarray(fast | (jump > np.maximum(allowed, max(min_jump, NOISE_FACTOR * noise))))


def _neighbours(rate: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the median of the `count` samples before and after each; NaN without any."""
    blank = np.full(count, np.nan)
    views = np.lib.stride_tricks.sliding_window_view(np.concatenate([blank, rate, blank]), count)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # windows without any number
        middle = np.nanmedian(views, axis=1)
    return middle[: rate.size], middle[count + 1 :]


def odometry_from_poses(t: np.ndarray, rows: np.ndarray, remarks: dict[str, int]) -> Odometry:
    """Return the twists from each pose to the next along an arc; the last is 0.

    `t` (n,) [s] increases strictly; `rows` (n, 3) are x [m], y [m], heading [rad]. Sideways motion
    counts where the robot strafes; less is noise of the poses. The motion of a jump is unknown.
    `remarks` counts jumps.
    """
    forward, sideways, turn = steps_between(rows)
    # An arc is longer than its chord by (turn / 2) / sin(turn / 2).
    chord = np.sinc(turn / math.tau)
    steps = forward / chord, turn, sideways / chord
    rates = (np.append(step / np.diff(t), 0.0) for step in steps)
    odometry = without_implausible(Odometry(t, *rates), remarks)
    if odometry.strafes:
        remarks[SIDEWAYS] = t.size
        return odometry
    return Odometry(t, odometry.v, odometry.omega)


def steps_between(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return forward and sideways (left) steps [m] and rotations [rad], (n - 1,), of poses (n, 3).

    The directions are those of the heading half-way.
    """
    dx, dy = np.diff(rows[:, 0]), np.diff(rows[:, 1])
    turn = np.asarray(wrap(np.diff(rows[:, 2])))
    middle = rows[:-1, 2] + turn / 2
    cos, sin = np.cos(middle), np.sin(middle)
    return dx * cos + dy * sin, dy * cos - dx * sin, turn
