"""Ranges as a hint: MRCLAM set 6 with and without the ranges in its measurement files.

`python -m benchmarks.ranges [--robots 1 2 ...] [--sigma 0.1] [--scale-sigma 0.02] [--factor 1]`
prints, for each robot, when five landmarks of home had been sighted, when the first pose came, map
scale against the survey, RMSE of the whole drive and after 300 s, NEES, and the time within 3
sigma. `--factor` multiplies all ranges: a wrong printed size. `--only` prints the rows with ranges
only. Home and data are those of `benchmarks.mrclam`.
"""

import math
from dataclasses import replace

import numpy as np

from benchmarks import monte_carlo
from benchmarks.mrclam import AFTER_S, HOME, data, map_scale, rmse_of
from homeward.drives.drive import Drive
from homeward.drives.importers.mrclam import read_mrclam
from homeward.localizer.localizer import Localizer
from homeward.runs.scoring import errors
from homeward.track import run

NUM_SIGHTED = 5


def with_ranges(drive: Drive, sigma: float, scale_sigma: float | None, factor: float) -> Drive:
    """Return a drive whose ranges are used, multiplied by a factor."""
    of_ranges = {"range_sigma": sigma, "range_scale_sigma": scale_sigma}
    sensor = drive.settings.sensor.model_copy(update=of_ranges)
    seen = replace(drive.sightings, range=factor * drive.sightings.range)
    settings = drive.settings.model_copy(update={"sensor": sensor})
    return replace(drive, sightings=seen, settings=settings)


def time_of_sightings(drive: Drive, number: int) -> float:
    """Return when this number of different landmarks of home had been sighted [s]."""
    sightings = zip(drive.sightings.t.tolist(), drive.sightings.landmark.tolist(), strict=True)
    seen: set[str] = set()
    for t, landmark in sightings:
        seen |= {landmark} & drive.home.keys()
        if len(seen) == number:
            return float(t)
    return math.nan


def row(drive: Drive) -> tuple[list[float], str, tuple[str, ...]]:
    """Return the figures of one drive, the landmarks detected as moved, and the notes."""
    robust = Localizer(drive.home, **drive.settings.robot)
    track = run(drive, robust)
    start, e = drive.span[0], errors(track, drive.truth)
    first = float(track.t[track.has_pose][0]) - start if track.has_pose.any() else math.nan
    figures = [
        time_of_sightings(drive, NUM_SIGHTED) - start,
        first,
        map_scale(robust),
        rmse_of(e, e.t > -math.inf),
        rmse_of(e, e.t > start + AFTER_S),
        float(np.average(e.nees, weights=e.weight)),
        float(np.average(e.nees_position < 9.0, weights=e.weight)),
        float(e.position[:20].max()),
    ]
    moved = ", ".join(m.landmark for m in track.landmarks if m.moved) or "none"
    return figures, moved, track.notes


def main() -> None:
    options = monte_carlo.parsed(
        __doc__,
        robots=[1, 2, 3, 4, 5],
        sigma=0.1,
        scale_sigma=float,
        factor=1.0,
        only=False,
    )
    print(
        "robot ranges  five sighted, first pose [s]  map scale  RMSE, after 300 s [m]  NEES"
        "  within 3 sigma  moved landmarks"
    )
    means: dict[str, list[list[float]]] = {"without": [], "with": []}
    for robot in options.robots:
        bare = read_mrclam(data() / "MRCLAM_Dataset6", robot, HOME, math.radians(0.5))
        ranged = with_ranges(bare, options.sigma, options.scale_sigma, options.factor)
        for name, drive in (("without", bare), ("with", ranged)):
            if name == "without" and options.only:
                continue
            figures, moved, notes = row(drive)
            means[name].append(figures)
            print(robot, f"{name:8}", _words(figures), moved, flush=True)
            print(*[f"    {n}" for n in notes if "anges" in n], sep="\n")
    for name, rows in means.items():
        if rows:
            print("mean", f"{name:8}", _words(np.nanmean(rows, axis=0).tolist()))


def _words(figures: list[float]) -> str:
    digits = (1, 1, 3, 3, 3, 2, 3, 2)
    return "  ".join(f"{x:7.{n}f}" for x, n in zip(figures, digits, strict=True))


if __name__ == "__main__":
    main()
