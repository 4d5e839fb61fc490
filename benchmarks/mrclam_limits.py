"""What anyone could reach on MRCLAM set 6, by its truth: scale, and time to the first pose.

`python -m benchmarks.mrclam_limits [--robots 1 2 ...]`. Bearings cannot tell the scale, so a map is
as much too small as the odometry by which it is made. By truth: how many times as far as its wheels
say a robot drives on the straight, what it loses in bends, how late it turns (least squares over
windows of 5 s). Beside it the scale of the localiser's map, its RMSE, and what of that is left
once its map has the right scale. Then when the posterior Cramer-Rao bound, told the noise, first
falls below 1 and 0.5 m, and when the localiser gives its first pose.
"""

from __future__ import annotations

import argparse
import dataclasses
import math

import numpy as np

from benchmarks.mrclam import AFTER_S, HOME, data, map_scale, rmse_of, surveyed_places
from homeward.angles import wrap
from homeward.bounds import RunningBound
from homeward.drives.drive import Drive
from homeward.drives.mrclam import read_mrclam
from homeward.frames import Pose, between
from homeward.localizer.localizer import Localizer
from homeward.scoring import errors
from homeward.track import run

WINDOW_S = 5.0
LAGS_S = np.arange(0.0, 0.5, 0.02)
"""Those that are tried."""
BEARING, HOME_BEARING = math.radians(0.8), math.radians(0.5)
"""Of the bound: residuals by truth are 0.4 to 0.9 deg [rad]."""
SPEED, TURN = 0.007, 0.025
"""Of the bound: by truth, 0.03 m per root of a metre and 0.1 rad, at 0.06 m/s [per root of a s]."""
LEVELS_M = (1.0, 0.5)


def odometry_by_truth(drive: Drive) -> tuple[float, float, float]:
    """Return an odometry's scale on the straight [1], slip in bends [m], and lag [s]."""
    odometry, truth = drive.odometry, drive.truth
    assert truth is not None
    fine = np.arange(truth.t[0], truth.t[-1], 0.1)
    x, y, heading = truth.at(fine)
    middle = heading[:-1] + 0.5 * wrap(np.diff(heading))
    along = np.diff(x) * np.cos(middle) + np.diff(y) * np.sin(middle)
    edges = np.arange(truth.t[0] + 1.0, truth.t[-1] - WINDOW_S, WINDOW_S)

    def summed(t: np.ndarray, steps: np.ndarray) -> np.ndarray:
        whole = np.concatenate([[0.0], np.cumsum(steps)])
        return np.diff(np.interp(edges, t, whole))

    true, dt = summed(fine, along), np.diff(odometry.t)
    turning = np.abs(odometry.omega) * (odometry.v != 0.0)
    best = (math.inf, 0.0, 0.0, 0.0)
    for lag in LAGS_S:
        said = summed(odometry.t + lag, odometry.v[:-1] * dt)
        columns = np.stack([said, -summed(odometry.t + lag, turning[:-1] * dt)], axis=1)
        right = np.abs(true - said) < 0.5 * np.abs(said)  # elsewhere motion capture is wrong
        found, *_ = np.linalg.lstsq(columns[right], true[right])
        rms = float(np.std(true[right] - columns[right] @ found))
        best = min(best, (rms, float(found[0]), float(found[1]), float(lag)))
    return best[1:]


def bound_of(drive: Drive) -> tuple[np.ndarray, np.ndarray]:
    """Return stamps [s] and the bound on the error of position there [m], both (n,)."""
    ids, truth, places = sorted(drive.home), drive.truth, surveyed_places()
    assert truth is not None
    landmarks = np.array([between(HOME, Pose(*places[name], 0.0))[:2] for name in ids])
    bound = RunningBound(
        landmarks,
        bearing_sigma=BEARING,
        home_sigma=HOME_BEARING,
        speed_sigma=SPEED,
        turn_sigma=TURN,
    )
    stamps = [s for s in drive.sightings.stamps() if truth.t[0] <= s[0] <= truth.t[-1]]
    t = np.array([stamp for stamp, _, _ in stamps])
    poses = np.stack(truth.at(t), axis=1)
    sigma = np.full(len(t), np.inf)
    for k, (_, seen, _) in enumerate(stamps):
        if k:
            dt, off = t[k] - t[k - 1], poses[k] - poses[k - 1]
            twist = np.array([math.hypot(*off[:2]), wrap(off[2])]) / dt
            bound.drive(poses[k - 1], poses[k], twist, dt)
        bound.see(poses[k], landmarks, np.array([name in seen for name in ids]))
        sigma[k] = math.sqrt(np.trace(bound.covariance()[:2, :2]))
    return t, sigma


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", type=int, nargs="*", default=[1, 2, 3, 4, 5])
    options = parser.parse_args()
    print(
        "robot  odometry: scale slip[m] lag[s]  map: scale  rmse, at the right scale, bound[m]  ",
        end="",
    )
    print("bound below 1, 0.5 m, first pose [s]")
    for robot in options.robots:
        drive = read_mrclam(data() / "MRCLAM_Dataset6", robot, HOME, HOME_BEARING, 0)
        scale, slip, lag = odometry_by_truth(drive)
        robust = Localizer(drive.home, **drive.settings.robot)
        track = run(drive, robust)
        size = 1.0 / map_scale(robust)
        larger = dataclasses.replace(track, x=size * track.x, y=size * track.y)
        rmse = [
            rmse_of(e, e.t > track.t[0] + AFTER_S)
            for e in (errors(one, drive.truth) for one in (track, larger))
        ]
        t, sigma = bound_of(drive)
        t -= drive.span[0]
        limit = math.sqrt(np.mean(sigma[t > AFTER_S] ** 2))
        found = [t[np.argmax(sigma < level)] for level in LEVELS_M]
        found.append(track.t[track.has_pose][0] - drive.span[0])
        print(
            f"{robot}  {scale:.3f} {slip:.3f} {lag:.2f}  {size:.3f}  "
            f"{rmse[0]:.3f} {rmse[1]:.3f} {limit:.3f}  " + " ".join(f"{s:.0f}" for s in found),
            flush=True,
        )


if __name__ == "__main__":
    main()
