"""Real drives: MRCLAM set 6 without a map or a prior, home at (2.0, 0.0, 0.3), noise 0.5 deg.

`python -m benchmarks.mrclam [--robots 1 2 ...] [--seeds 1] [--falsify 3] [--lag 5] [--smooth]
[--known survey] [--wrong 3] [--ranges]` prints time-weighted figures after 300 s, causal ones
unless smoothed: with `--lag`, that many seconds late. `--falsify` is the number of home bearings
that are made wrong. `--known` gives the surveyed positions of all landmarks, of which `--wrong` are
wrong, or the two longest distances that share no landmark (`distances`). `--ranges`
uses the ranges of the data set, too. The last rows are those of all drives.
The data are read from HOMEWARD_DATA, else from ../shared/data.
"""

import itertools
import math
import os
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.measures import Figures, figures, scale_of
from benchmarks.monte_carlo import Column, Run, benchmark
from homeward.drives.drive import Drive
from homeward.drives.importers.mrclam import read_mrclam
from homeward.drives.landmarks import KnownLandmarks
from homeward.geometry.frames import Pose
from homeward.lab.studies.study.trial import falsified
from homeward.localizer.fixed_lag import smooth_with_lag
from homeward.localizer.localizer import Localizer
from homeward.localizer.smoothing import smooth
from homeward.runs.scoring import errors
from homeward.track import run as follow

SET_6 = "MRCLAM_Dataset6"
AFTER_S = 300.0
HOME = Pose(2.0, 0.0, 0.3)
NUM_SIGHTED = 5
COLUMNS = (
    Column("RMSE [m]", "rmse", np.nanmean),
    Column("bearings <2 s old", "fresh", np.nanmean),
    Column(">5 s old", "old", np.nanmean),
    Column("heading [rad]", "heading", np.nanmean),
    Column("map scale", "scale", np.nanmean),
    Column("availability", "pose", np.nanmean),
    Column("five sighted [s]", "sighted", np.nanmean, 0),
    Column("first pose [s]", "first", np.nanmean, 0),
    *(Column(f"within {k} sigma", f"inside{k}", np.nanmean, 2) for k in (1, 2, 3)),
    Column("NEES (x, y)", "nees_position", np.nanmean, 2),
    Column("exactly named", "exact", np.nanmean, 2),
    Column("ms", "ms", np.nanmedian, 2),
)


def data() -> Path:
    default = Path(__file__).resolve().parents[2] / "shared" / "data"
    return Path(os.environ.get("HOMEWARD_DATA", default))


def surveyed_places(folder: str = SET_6) -> dict[str, np.ndarray]:
    """Return the surveyed positions of the landmarks of an MRCLAM set [m]."""
    table = np.loadtxt(data() / folder / "Landmark_Groundtruth.dat")
    return {str(int(row[0])): row[1:3] for row in table}


def drive_of(robot: int, seed: int = 0, home: Pose = HOME) -> Drive:
    """Return the drive of a robot of set 6, with noise of 0.5 deg in home's bearings, no ranges."""
    return without_ranges(read_mrclam(data() / SET_6, robot, home, math.radians(0.5), seed))


def without_ranges(drive: Drive) -> Drive:
    """Return a drive with bearings alone."""
    return with_range_sigma(drive, math.inf)


def with_range_sigma(drive: Drive, sigma: float | None) -> Drive:
    """Return a drive with a relative standard deviation of ranges; infinite: they are not used."""
    sensor = drive.settings.sensor.model_copy(update={"range_sigma": sigma})
    return replace(drive, settings=drive.settings.model_copy(update={"sensor": sensor}))


def known(what: str, wrong: int, seed: int) -> tuple[KnownLandmarks, set[str]]:
    """Return facts on the landmarks of set 6, and the landmarks whose position is wrong."""
    places, rng = surveyed_places(), np.random.default_rng(seed)
    if what == "distances":
        pairs = itertools.combinations(places, 2)
        apart = {pair: float(np.hypot(*(places[pair[0]] - places[pair[1]]))) for pair in pairs}
        far = sorted(apart, key=lambda pair: -apart[pair])
        two = [far[0], next(pair for pair in far if not {*pair} & {*far[0]})]
        found = [{"between": pair, "distance": apart[pair]} for pair in two]
        return KnownLandmarks.model_validate({"distances": found}), set()
    if what != "survey":
        return KnownLandmarks(), set()
    false, given = set(rng.choice(list(places), wrong, replace=False).tolist()), {}
    for name, place in places.items():
        way = rng.uniform(0.0, math.tau)
        shift = rng.uniform(0.3, 2.0) * np.array([math.cos(way), math.sin(way)])
        x, y = place + shift * (name in false)
        given[name] = {"x": float(x), "y": float(y)}
    return KnownLandmarks.model_validate({"sigma": 0.01, "landmarks": given}), false


def time_of_sightings(drive: Drive, names: Collection[str]) -> float:
    """Return after which time `NUM_SIGHTED` of some landmarks had been sighted [s]."""
    seen: set[str] = set()
    for t, landmark in zip(drive.sightings.t, drive.sightings.landmark, strict=True):
        seen |= {str(landmark)} & set(names)
        if len(seen) == NUM_SIGHTED:
            return float(t) - drive.span[0]
    return math.nan


def measured(run: Run, falsify: int, lag: float, **given: Any) -> Figures:
    """Return the figures of one drive; the scenario is the robot."""
    right = drive_of(int(run.scenario), run.seed)
    drive = falsified(right, falsify, np.random.default_rng(run.seed))
    facts, false = known(given["known"], given["wrong"], run.seed)
    drive = replace(drive, known=facts)
    if given["ranges"]:
        drive = with_range_sigma(drive, None)
    localizer = Localizer(drive.home, known=drive.known, **drive.settings.robot)
    if given["smooth"]:
        track = smooth(drive)
    else:
        track = smooth_with_lag(drive, lag) if lag else follow(drive, localizer)
    moved = false | {n for n, b in drive.home.items() if b != right.home[n]}
    found = figures(track, drive.truth, moved, AFTER_S)
    if false:  # a wrong position in a survey is no landmark that moved
        survey = localizer.chart.map.registration.survey
        found["exact"] = float({n for n, p in survey.wrong.items() if p > 0.5} == false)
    e, stamps = errors(track, drive.truth), np.unique(drive.sightings.t)
    age = e.t - stamps[np.maximum(np.searchsorted(stamps, e.t, side="right") - 1, 0)]
    for name, use in (("fresh", age < 2.0), ("old", age > 5.0)):
        use &= e.t >= track.t[0] + AFTER_S
        square = np.average(e.position[use] ** 2, weights=e.weight[use]) if use.any() else math.nan
        found[name] = math.sqrt(square)
    scale = scale_of(track, surveyed_places())
    return found | {"scale": scale, "sighted": time_of_sightings(drive, drive.home)}


def main() -> None:
    benchmark(
        __doc__,
        measured,
        ["1", "2", "3", "4", "5"],
        COLUMNS,
        seeds=1,
        names="robots",
        falsify=0,
        lag=0.0,
        smooth=False,
        known="nothing",
        wrong=0,
        ranges=False,
    )


if __name__ == "__main__":
    main()
