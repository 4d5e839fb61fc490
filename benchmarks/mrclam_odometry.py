"""Systematic errors of the odometry of MRCLAM robots, by ground truth alone.

`python -m benchmarks.mrclam_odometry [--set 6] [--robots 1 2 ...] [--delay 0.1] [--lag 0.18]` fits
the true motion in seconds of nearly constant twist by the odometry, which is the commanded twist:
distance = straight * v - slip * |turn|, turn = turn_scale * turn + bias. It prints the fit, the
share of the commanded distance that was driven in all, and the scale of a map in the odometry's
metres: bearings observe slip (a motion shorter than its neighbours), not the speed of a straight
motion, so a correct map without a measured distance has the scale 1 / straight.
"""

import math

import numpy as np
from scipy.signal import lfilter

from benchmarks import monte_carlo
from benchmarks.mrclam import HOME, data
from homeward.drives.drive import Drive
from homeward.drives.importers.mrclam import read_mrclam

STEP_S, WINDOW_S = 0.02, 1.0
MIN_M = 0.02
"""Shorter motions in a window are left out."""
OUTLIER = 3.0 / 0.6745
"""Median deviations beyond which a window (a collision, a jump of the ground truth) is left out."""


def followed(drive: Drive, delay: float, lag: float) -> tuple[np.ndarray, np.ndarray]:
    """Return times [s] and path [m] and turn [rad] (2, n) of odometry behind a first-order lag."""
    odometry = drive.odometry
    t = np.arange(odometry.t[0], odometry.t[-1], STEP_S)
    newest = np.maximum(np.searchsorted(odometry.t, t - delay, side="right") - 1, 0)
    rates = np.nan_to_num(np.stack([odometry.v, odometry.omega])[:, newest])
    keep = math.exp(-STEP_S / lag) if lag else 0.0
    begin = keep * rates[:, :1]
    rates, _ = lfilter([1.0 - keep], [1.0, -keep], rates, axis=1, zi=begin)
    return t, np.cumsum(rates, axis=1) * STEP_S


def windows(drive: Drive, delay: float, lag: float) -> np.ndarray:
    """Return commanded path and turn, and true path and turn, of windows of time, (n, 4)."""
    t, driven = followed(drive, delay, lag)
    edges = np.arange(t[0] + 2.0, t[-1] - 2.0, WINDOW_S)
    at = drive.truth.at(edges)
    commanded = np.diff([np.interp(edges, t, total) for total in driven], axis=1)
    turn = np.diff(np.unwrap(at.heading))
    middle = at.heading[:-1] + 0.5 * turn
    ahead = np.cos(middle) * np.diff(at.x) + np.sin(middle) * np.diff(at.y)
    chord = np.sinc(0.5 * turn / np.pi)
    rows = np.stack([*commanded, ahead / chord, turn], axis=1)
    counts = np.diff(np.searchsorted(drive.truth.t, edges))
    seen = counts > 0.5 * np.median(counts)  # else ground truth has a gap
    return rows[seen & (np.abs(rows[:, 0]) > MIN_M)]


def fit(columns: np.ndarray, measured: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return coefficients (k,) and standard deviations of a linear fit without outliers."""
    use = np.ones(len(measured), bool)
    for _ in range(5):
        a = columns[use]
        found = np.linalg.lstsq(a, measured[use], rcond=None)[0]
        off = np.abs(measured - columns @ found)
        use = off < OUTLIER * np.median(off)
    variance = np.mean((measured[use] - columns[use] @ found) ** 2)
    return found, np.sqrt(variance * np.linalg.inv(a.T @ a).diagonal())


def main() -> None:
    options = monte_carlo.parsed(__doc__, set=6, robots=[1, 2, 3, 4, 5], delay=0.1, lag=0.18)
    print("robot  straight         slip [m]         turn scale       driven/commanded  map scale")
    for robot in options.robots:
        folder = data() / f"MRCLAM_Dataset{options.set}"
        drive = read_mrclam(folder, robot, HOME, math.radians(0.5), 0)
        path, turn, driven, turned = windows(drive, options.delay, options.lag).T
        (straight, slip), sigmas = fit(np.stack([path, -np.abs(turn)], axis=1), driven)
        (scale, _), by_turn = fit(np.stack([turn, np.ones(len(turn))], axis=1), turned)
        print(
            f"{robot:5d}  {straight:.3f} +- {sigmas[0]:.3f}  {slip:.3f} +- {sigmas[1]:.3f}  "
            f"{scale:.3f} +- {by_turn[0]:.3f}  {driven.sum() / path.sum():16.3f}  "
            f"{1.0 / straight:9.3f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
