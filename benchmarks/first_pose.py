"""Time of the first pose of real drives, compared with the posterior Cramer-Rao bound.

`python -m benchmarks.first_pose [--robots 1 2 ...] [--home X Y HEADING] [--bearing-sigma 0.01]`
prints for each MRCLAM drive of set 6 when the posterior Cramer-Rao bound of the position falls
below 1 m and 0.3 m, when five home landmarks have been sighted, when 2 m have been driven, too, and
when the localiser gives its first pose, with its error and standard deviation. The bound takes
the default odometry noise, home bearings of 0.5 deg and no error of scale, lag or camera: no
estimator without more knowledge can be earlier. Bearings of these robots have errors of 0.01 to
0.02 rad.
"""

import math

import numpy as np

from benchmarks.measures import Figures
from benchmarks.monte_carlo import Column, Run, benchmark
from benchmarks.mrclam import HOME, drive_of, surveyed_places
from homeward.drives.drive import Drive
from homeward.drives.settings import OdometryDefaults
from homeward.geometry.frames import Pose, between
from homeward.lab.bounds import posterior_bound
from homeward.localizer.localizer import Localizer
from homeward.runs.scoring import errors
from homeward.track import run as follow

COLUMNS = (
    *(Column(f"bound <{m} m [s]", digits=0) for m in ("1", "0.3")),
    *(Column(head, digits=0) for head in ("five seen", "and 2 m driven", "first pose [s]")),
    Column("driven [m]", digits=1),
    *(Column(head, digits=2) for head in ("error [m]", "sigma [m]")),
)
HOME_SIGMA = math.radians(0.5)
LONGEST_S = 400.0


def driven(drive: Drive, stamps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the path [m] and the sum of all turns [rad] up to times (n,), by odometry."""
    odometry = drive.odometry
    intervals = np.diff(odometry.t, append=odometry.t[-1])
    sums = (np.cumsum(np.abs(rate) * intervals) for rate in (odometry.v, odometry.omega))
    path, turns = (np.interp(stamps, odometry.t[1:], total[:-1]) for total in sums)
    return path, turns


def bound(
    drive: Drive, home: Pose, bearing_sigma: float, stamps: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the smallest standard deviation of position at stamps [m], and whether each landmark
    is in view, (n, q).

    The noise of odometry grows with the path and with turns, so the path takes the place of time.
    """
    places = surveyed_places()
    names = [n for n in drive.home if n in places]
    landmarks = np.array([between(home, Pose(*places[n], 0.0))[:2] for n in names])
    truth, noise = drive.truth, OdometryDefaults()
    at = truth.at(stamps)
    poses = np.stack([at.x, at.y, np.unwrap(at.heading)], axis=1)
    seen = drive.sightings
    visible = np.array([np.isin(names, seen.landmark[seen.t == t]) for t in stamps])
    path, turns = driven(drive, stamps)
    steps = np.maximum(np.diff(path), 1e-6)
    turn_variance = (
        noise.turn_by_driving**2 + noise.turn_by_turning**2 * (turns[-1] - turns[0]) / steps.sum()
    )
    covariances = posterior_bound(
        poses,
        np.stack([np.ones(len(steps)), np.diff(poses[:, 2]) / steps], axis=1),
        steps,
        landmarks,
        visible,
        bearing_sigma=bearing_sigma,
        home_sigma=HOME_SIGMA,
        speed_sigma=noise.distance,
        turn_sigma=math.sqrt(turn_variance),
    )
    return np.sqrt(np.trace(covariances[:, :2, :2], axis1=1, axis2=2)), visible


def measured(run: Run, home: list[float], bearing_sigma: float) -> Figures:
    """Return the times of one robot's drive [s], and error and sigma of its first pose [m]."""
    drive = drive_of(int(run.scenario), run.seed, Pose(*home))
    start = drive.odometry.t[0]
    stamps = np.unique(drive.sightings.t)
    stamps = stamps[(stamps > drive.truth.t[0]) & (stamps < start + LONGEST_S)]
    smallest, visible = bound(drive, Pose(*home), bearing_sigma, stamps)
    path = driven(drive, stamps)[0]
    five = np.logical_or.accumulate(visible).sum(axis=1) >= 5
    reached = smallest < 1.0, smallest < 0.3, five, five & (path >= 2.0)
    times = [np.append(stamps[true], np.nan)[0] - start for true in reached]
    track = follow(drive, Localizer(drive.home, **drive.settings.robot))
    e = errors(track, drive.truth)
    k = int(np.flatnonzero(np.isfinite(e.position))[0])
    first = track.t[track.has_pose][0]
    sigma = e.position[k] / math.sqrt(e.nees_position[k])
    of_pose = first - start, np.interp(first, stamps, path), e.position[k], sigma
    return dict(zip((c.head for c in COLUMNS), (*times, *of_pose), strict=True))


def main() -> None:
    robots = ["1", "2", "3", "4", "5"]
    given = {"home": list(HOME), "bearing_sigma": 0.01}
    benchmark(__doc__, measured, robots, COLUMNS, seeds=1, names="robots", **given)


if __name__ == "__main__":
    main()
