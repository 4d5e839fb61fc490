"""Landmarks that are reported as gone, on visits to a warehouse in which nothing was taken away.

`python -m benchmarks.places.gone [--seeds 40] [--first 9000] [--taken 0] [--localizer]`: each seed
is a warehouse of `benchmarks.places`, of which a place is made on a drive of 150 s, and visited on
the next day for 40, 80 and 150 s. `--taken` landmarks were taken away before each visit. By default
poses and maps are simulated, from the true ones and the information of the sightings; with
`--localizer` they are those of the localiser, which takes 100 times as long.
"""

import math
from collections.abc import Mapping

import numpy as np

from benchmarks import monte_carlo
from benchmarks.places.days import visit
from benchmarks.places.warehouse import BEARING_SIGMA, HOME, Warehouse
from homeward.drives.drive import Drive, HomeBearing
from homeward.geometry.frames import Pose, between
from homeward.places.joint_map import JointMap
from homeward.places.persistence import LandmarkPersistence
from homeward.places.place import Place, StoredHome, Visit
from homeward.places.views import VisitFrames
from homeward.places.visit_data import VisitData, fingerprint
from homeward.places.visiting import merged

DURATIONS = 40.0, 80.0, 150.0  # of the visits [s]
POSE_SIGMA = 0.03, 0.03, 0.005  # errors of the poses of a drive [m, m, rad]
MIN_SIGMA, MAX_SIGMA = 0.02, 1.0  # of a landmark in the map of a drive [m]
FRAME_S = 0.5
Places = Mapping[str, tuple[float, float]]


def simulated(drive: Drive, places: Places, rng: np.random.Generator) -> VisitData:
    """Return a visit with simulated errors; `places` are in the frame of home."""
    information, cameras, seen = dict[str, np.ndarray](), [], []
    last = -math.inf
    for t, now, _ in drive.sightings.stamps():
        truth = drive.truth.at(np.array([t]))
        pose = np.array([truth.x[0], truth.y[0], truth.heading[0]])
        for name in now:
            dx, dy = np.subtract(places[name], pose[:2])
            across = np.array([-dy, dx]) / math.hypot(dx, dy)
            sigma = math.hypot(BEARING_SIGMA * math.hypot(dx, dy), POSE_SIGMA[0])
            before = information.get(name, np.zeros((2, 2)))
            information[name] = before + np.outer(across, across) / sigma**2
        if t - last > FRAME_S - 1e-6:
            last = t
            cameras.append(pose)
            seen.append([*now])
    names = [n for n, i in information.items() if np.linalg.eigvalsh(i)[0] > MAX_SIGMA**-2]
    covariance = np.zeros((2 * len(names), 2 * len(names)))
    for k, name in enumerate(names):
        own = np.linalg.inv(information[name]) + MIN_SIGMA**2 * np.eye(2)
        covariance[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = own
    truth = np.array([places[n] for n in names]).ravel()
    mean = rng.multivariate_normal(truth, covariance)
    own = JointMap(tuple(names), (), mean, covariance)
    poses = np.array(cameras) + POSE_SIGMA * rng.normal(size=3)
    sigmas = np.full(len(poses), POSE_SIGMA[0])
    frames = VisitFrames(poses, seen, drive.settings.sensor.field_of_view, sigmas)
    return VisitData("a drive", fingerprint(drive), 0.0, own, frames)


def simulated_place(data: VisitData) -> Place:
    """Return a place from a first visit."""
    home = np.zeros(3), np.diag([1e-4, 1e-4, 1e-5])
    there = data.map.with_home("home", {}, np.empty((0, 3)), *home).at_home("home")
    seen = data.frames.views(there, Pose(0.0, 0.0, 0.0)).seen
    persistence = {
        n: LandmarkPersistence(0.0, 0.0, seen_from=tuple(map(float, seen.get(n, ()))))
        for n in there.names
    }
    first = Visit(1, 0.0, "first", data.evidence, "first", of=len(there.names))
    bearings = {n: HomeBearing(0.0) for n in there.names[:3]}  # are not used
    return Place("hall", there, persistence, {"home": StoredHome(0.0, bearings)}, (first,))


def main() -> None:
    options = monte_carlo.parsed(__doc__, seeds=40, first=9000, taken=0, localizer=False)
    visits = wrong_visits = wrong = found = taken = apart = 0
    for seed in range(options.first, options.first + options.seeds):
        hall, rng = Warehouse(seed), np.random.default_rng([seed, 2])
        home = Pose(HOME.x, HOME.y, HOME.heading)
        places = {n: between(home, Pose(*p, 0.0))[:2] for n, p in hall.places.items()}
        first, everything = hall.drive(), dict(hall.places)
        if options.localizer:
            _, place = visit(first, None, 0.0)
        else:
            place = simulated_place(simulated(first, places, rng))
        for day, seconds in enumerate(DURATIONS, 1):
            gone = {*rng.choice(sorted(place.persistence), options.taken, replace=False).tolist()}
            hall.day, hall.places = day, {n: p for n, p in everything.items() if n not in gone}
            drive = hall.drive(seconds)
            if options.localizer:
                _, after = visit(drive, place, 1.0)
            else:
                data = simulated(drive, places, rng)
                after = merged(place, VisitData(**vars(data) | {"when": 1.0}))
            events = [e for e in after.events if e.visit == after.visits[-1].number]
            named = {e.landmark for e in events if e.what in ("gone", "forgotten")}
            visits, apart = visits + 1, apart + (after.visits[-1].verdict == "apart")
            wrong_visits, wrong = wrong_visits + bool(named - gone), wrong + len(named - gone)
            found, taken = found + len(named & gone), taken + len(gone)
    print(
        f"{visits} visits, {apart} not merged: {wrong_visits} with a landmark wrongly gone"
        f" ({wrong} landmarks)"
        + (f"; of {taken} taken away, one visit reports {found}" if taken else "")
    )


if __name__ == "__main__":
    main()
