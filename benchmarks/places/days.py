"""Places: thirty days in a warehouse.

`python -m benchmarks.places [--days 30] [--seeds 3] [--memory NAME ...] [--keep FOLDER]`: each day
a robot drives through a warehouse of 20 by 12 m with 40 landmarks, of which each night 10 % are
moved, 5 % are removed and as many are added. The place is compared with no memory (home bearings
stored again each morning) and with the home bearings of the first day. Nothing is tuned to it.
Columns, over days and warehouses, without the first day: time of the first pose, RMSE of the
position; days with a pose; landmarks that moved since they were last seen, reported, reported
falsely and missed; and of home at the end: its error, its standard deviation, and the bound of the
RMS error.
"""

import math
from collections import defaultdict

import numpy as np

from benchmarks.monte_carlo import Column, Figures, Run, benchmark
from benchmarks.places.warehouse import BEARING_SIGMA, HOME, Warehouse
from homeward.drives.drive import Drive
from homeward.geometry.frames import Pose, between
from homeward.localizer.localizer import Localizer
from homeward.places.joint_map import JointMap, datum
from homeward.places.place import Place
from homeward.places.visit_data import collect_visit
from homeward.places.visiting import first_place, merged
from homeward.runs.scoring import errors, statistics
from homeward.track import Track, run

DAYS = 30
PLACE, NO_MEMORY, FIRST_HOME = MEMORIES = ("place", "no memory", "first day's home")
COLUMNS = (
    Column("first pose [s]", "first_s", np.median, 1),
    Column("worst", "first_s", np.max, 1),
    Column("RMSE [m]", "rmse"),
    Column("worst day", "rmse", np.nanmax),
    Column("days with a pose", "first_s", lambda s: float(np.isfinite(s).sum()), 0),
    *(Column(head, by=np.nansum, digits=0) for head in ("moved", "falsely", "missed")),
    *(Column(f"home {what} [m]", f"home_{what}") for what in ("error", "sigma", "bound")),
)


def visit(drive: Drive, place: Place | None, when: float) -> tuple[Track, Place]:
    """Run a drive in a place, or without one; return its track, and the place after it."""
    there = drive if place is None else place.visited_by(drive, when)
    localizer = Localizer(there.home, known=there.known, **there.settings.robot)
    track = run(there, localizer)
    data = collect_visit(localizer, there, track, when)
    after = first_place("place", localizer, data) if place is None else merged(place, data)
    return track, after


def measured(one: Run, days: int) -> Figures:
    """Return the figures of a memory in one warehouse, by day."""
    hall, place, found = Warehouse(one.seed), None, defaultdict(list)
    first_home, bound, last_known = {}, math.nan, dict[str, tuple[float, float]]()
    for day in range(days):
        if day:
            hall.night()
        drive = hall.drive()
        if one.scenario == PLACE:
            before = place
            track, place = visit(drive, before, float(day))
            if before is None:
                bound = home_bound(drive, hall)
            else:
                seen = set(drive.sightings.landmark.tolist()) & before.persistence.keys()
                moved = {n for n in seen & last_known.keys() if hall.places[n] != last_known[n]}
                for name, number in zip(
                    ("moved", "falsely", "missed"), reported(place, moved), strict=True
                ):
                    found[name].append(number)
            last_known |= {n: hall.places[n] for n in drive.sightings.landmark.tolist()}
        elif day:
            home = drive.home if one.scenario == NO_MEMORY else first_home
            track = run(drive, Localizer(home, **drive.settings.robot))
        else:
            first_home = drive.home
            continue
        if day:
            e, has_pose = errors(track, drive.truth), track.has_pose
            found["first_s"].append(track.t[has_pose][0] - track.t[0] if any(has_pose) else np.inf)
            off = statistics(e.position, e.weight).rmse if e.t.size else np.nan
            found["rmse"].append(off)
    figures: Figures = {name: np.array(values, float) for name, values in found.items()}
    if place is not None:
        sigma = place.home_sigma("home", float(days - 1))
        figures |= {"home_error": home_error(place, hall), "home_sigma": sigma, "home_bound": bound}
    return figures


def reported(place: Place, moved: set[str]) -> tuple[int, int, int]:
    """Return how many moves the last visit reports rightly, falsely, and how many it misses."""
    number = place.visits[-1].number
    named = {e.landmark for e in place.events if e.visit == number and e.what == "moved"}
    return len(named & moved), len(named - moved), len(moved - named)


def home_bound(drive: Drive, hall: Warehouse) -> float:
    """Return the Cramer-Rao bound of home's RMS error, from its one frame and an exact map [m]."""
    there = np.array([between(HOME.pose, Pose(*hall.places[n], 0.0))[:2] for n in drive.home])
    square = (there**2).sum(axis=1)
    ones = np.ones(len(there))
    jacobian = np.column_stack([there[:, 1] / square, -there[:, 0] / square, -ones])
    covariance = BEARING_SIGMA**2 * np.linalg.inv(jacobian.T @ jacobian)
    return math.sqrt(float(covariance[0, 0] + covariance[1, 1]))


def home_error(place: Place, hall: Warehouse) -> float:
    """Return the error of home after alignment of the static landmarks with ground truth [m]."""
    now = place.visits[-1].when
    fresh = [n for n in place.map.names if place.persistence[n].last == now and n in hall.places]
    fresh = [n for n in fresh if place.persistence[n].stands > 0.5]
    if len(fresh) < 2:
        return math.nan
    there = [between(HOME.pose, Pose(*hall.places[n], 0.0))[:2] for n in fresh]
    exact = np.zeros((2 * len(fresh), 2 * len(fresh)))
    truth = JointMap(tuple(fresh), (), np.ravel(there), exact)
    return float(np.hypot(*datum(place.map, truth, fresh)[:2]))


def main() -> None:
    options = {"seeds": 3, "names": "memory", "is_pooled": False, "days": DAYS}
    found = benchmark(__doc__, measured, MEMORIES, COLUMNS, **options)
    for (memory, _, seed), figures in found.items():
        if memory == PLACE and (alone := found.get(Run(NO_MEMORY, "robust", seed))):
            days = 1 + np.flatnonzero(figures["rmse"] > alone["rmse"])
            print(f"seed {seed}: days on which the place is worse than no memory: {days}")


if __name__ == "__main__":
    main()
