"""Real drives: MRCLAM set 6 without a map or a prior, home at (2.0, 0.0, 0.3), noise 0.5 deg.

`python -m benchmarks.mrclam [--falsify 3] [--seeds 5] [--robots 1 2 ...] [--lag 5] [--smooth]`
prints time-weighted figures after 300 s, causal ones unless smoothed: with `--lag`, that many
seconds late. `--falsify` is the number of home bearings that are made wrong. The data are read from
HOMEWARD_DATA, else from ../shared/data.
"""

import math
import os
from pathlib import Path

import numpy as np

from benchmarks import monte_carlo
from homeward.drives.drive import Drive
from homeward.drives.importers.mrclam import read_mrclam
from homeward.geometry.frames import Pose
from homeward.lab.studies.study.trial import falsified
from homeward.localizer.fixed_lag import smooth_with_lag
from homeward.localizer.localizer import Localizer
from homeward.localizer.smoothing import smooth
from homeward.runs.scoring import Errors, errors, statistics
from homeward.track import Track, run

AFTER_S, POSE_AFTER_S = 300.0, 240.0
HOME = Pose(2.0, 0.0, 0.3)


def data() -> Path:
    default = Path(__file__).resolve().parents[2] / "shared" / "data"
    return Path(os.environ.get("HOMEWARD_DATA", default))


def surveyed_places(folder: str = "MRCLAM_Dataset6") -> dict[str, np.ndarray]:
    """Return the surveyed positions of the landmarks of an MRCLAM set [m]."""
    table = np.loadtxt(data() / folder / "Landmark_Groundtruth.dat")
    return {str(int(row[0])): row[1:3] for row in table}


def map_scale(robust: Localizer) -> float:
    known, places = robust.chart.map.landmarks, surveyed_places()
    names = [n for n in known.mapped if n in places and n not in known.former]
    p = known.places([known.mapped[n] for n in names])[0] @ [1.0, 1.0j]
    return procrustes_scale(p, np.array([places[n] for n in names]) @ [1.0, 1.0j])


def procrustes_scale(p: np.ndarray, q: np.ndarray) -> float:
    """Return the scale of the similarity transform from points q to p, complex (n,)."""
    p, q = p - p.mean(), q - q.mean()
    return float(abs(np.vdot(q, p)) / np.vdot(q, q).real)


def rmse_of(e: Errors, use: np.ndarray) -> float:
    """Return the time-weighted RMSE of position over some rows [m]."""
    return statistics(e.position[use], e.weight[use]).rmse if use.any() else math.nan


def last_bearing_age(track: Track, e: Errors, drive: Drive) -> np.ndarray:
    """Return the age of the last bearing at each row of `e` [s]."""
    stamps = np.unique(drive.sightings.t)
    return np.asarray(e.t - stamps[np.maximum(np.searchsorted(stamps, e.t, side="right") - 1, 0)])


def row(drive: Drive, wrong: set[str], final: bool, lag: float) -> tuple[float, str]:
    """Run one drive, smoothed if `final` or late by a lag [s]; return its RMSE and the figures."""
    if final or lag:
        track = smooth(drive) if final else smooth_with_lag(drive, lag)
    else:
        track = run(drive, Localizer(drive.home, **drive.settings.robot))
    start = track.t[0]
    e = errors(track, drive.truth)
    late = e.t > start + AFTER_S
    age = last_bearing_age(track, e, drive)
    seconds = np.diff(track.t, append=track.t[-1])
    span = track.t > start + POSE_AFTER_S
    share = seconds[span & track.has_pose].sum() / seconds[span].sum()
    first = track.t[track.has_pose][0] - start if track.has_pose.any() else math.nan
    named = {m.landmark for m in track.landmarks if m.moved}
    heading = statistics(e.heading[late], e.weight[late]).rmse
    inside = [np.average(e.nees_position[late] < k * k, weights=e.weight[late]) for k in (1, 2, 3)]
    rmse = rmse_of(e, late)
    nees = np.average(e.nees_position[late], weights=e.weight[late])
    return rmse, (
        f"{rmse:.3f} {rmse_of(e, late & (age < 2)):.3f} {rmse_of(e, late & (age > 5)):.3f} "
        f"{heading:.3f}  {share:.3f} {first:5.0f}  "
        + " ".join(f"{i:.2f}" for i in inside)
        + f"  {nees:.2f}  {1e3 * np.median(track.update_seconds):.2f} "
        f"{1e3 * np.quantile(track.update_seconds, 0.99):.1f} {track.run_seconds:.0f}s  "
        f"{'exact' if named == wrong else f'detected {sorted(named)}, moved {sorted(wrong)}'}"
    )


def main() -> None:
    robots = [1, 2, 3, 4, 5]
    options = monte_carlo.parsed(__doc__, falsify=0, seeds=1, robots=robots, lag=0.0, smooth=False)
    print(
        "robot seed  RMSE, bearings <2 s, >5 s old [m]  heading [rad]  availability  first pose [s]"
        "  within 1 2 3 sigma  NEES  ms 50 % 99 %  run time  moved landmarks"
    )
    total = []
    for robot in options.robots:
        for seed in range(options.seeds):
            drive = read_mrclam(data() / "MRCLAM_Dataset6", robot, HOME, math.radians(0.5), seed)
            right = drive.home
            drive = falsified(drive, options.falsify, np.random.default_rng(seed))
            wrong = {n for n, b in drive.home.items() if b != right[n]}
            rmse, line = row(drive, wrong, options.smooth, options.lag)
            total.append(rmse)
            print(robot, seed, line, flush=True)
    print(f"mean {np.mean(total):.3f} m")


if __name__ == "__main__":
    main()
