"""Large places: ten with 500 landmarks, and a year of daily visits.

The maps are synthetic: each landmark has an error of 3 cm, and all a scale error of 1 %. The drives
in these places are simulated.
"""

import math
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from benchmarks.places.warehouse import BEARING_SIGMA
from homeward.drives.drive import Drive, HomeBearing
from homeward.lab.simulation import scenario as sim
from homeward.lab.simulation.simulate import simulate
from homeward.localizer.localizer import Localizer
from homeward.places.files import load_place, save_place
from homeward.places.joint_map import JointMap
from homeward.places.persistence import LandmarkPersistence
from homeward.places.place import Place, StoredHome, Visit
from homeward.places.views import VisitFrames
from homeward.places.visit_data import VisitData
from homeward.places.visiting import merged

HALL = 60.0, 40.0  # [m]
NUMBER, COUNT = 10, 500
SIGMA, SCALE_SIGMA = 0.03, 0.01
REACH = 10.0  # range of the camera [m]
Places = dict[str, tuple[float, float]]
HOME = StoredHome(0.0, {f"P{i}": HomeBearing(0.1) for i in range(6)})  # its bearings are not used


def random_places(rng: np.random.Generator, count: int, size: tuple[float, float]) -> Places:
    """Return the positions of landmarks in a hall; home is in its corner."""
    xy = rng.uniform((0.0, 0.0), size, (count, 2))
    return {f"P{i}": (float(x), float(y)) for i, (x, y) in enumerate(xy)}


def mapped(places: Mapping[str, tuple[float, float]], rng: np.random.Generator) -> JointMap:
    truth = np.array(list(places.values())) * (1.0 + SCALE_SIGMA * rng.normal())
    mean = (truth + SIGMA * rng.normal(size=truth.shape)).ravel()
    covariance = SIGMA**2 * np.eye(mean.size) + SCALE_SIGMA**2 * np.outer(truth, truth)
    return JointMap(tuple(places), (), mean, covariance)


def made(name: str, places: Places, rng: np.random.Generator) -> Place:
    home = np.zeros(3), np.diag([1e-4, 1e-4, 1e-5])
    there = mapped(places, rng).with_home("home", {}, (0.0, 0.0, 0.0), *home).at_home("home")
    visit = Visit(1, 0.0, "first", rng.bytes(8).hex(), "first", new=len(places), of=len(places))
    persistence = {n: LandmarkPersistence(0.0, 0.0) for n in places}
    return Place(name, there, persistence, {"home": HOME}, (visit,))


def kidnapped(places: Places, seed: int) -> Drive:
    """Return the drive of a robot that starts anywhere in a hall."""
    rng = np.random.default_rng([seed, 1])
    x, y = rng.uniform((10.0, 10.0), np.array(HALL) - 10.0)
    ahead = rng.uniform(-math.pi, math.pi)
    there = (x + 8.0 * math.cos(ahead), y + 8.0 * math.sin(ahead))
    scenario = sim.Scenario(
        name="kidnapped",
        seed=seed,
        room=sim.Room(bounds=(-1.0, -1.0, HALL[0] + 1.0, HALL[1] + 1.0)),
        landmarks=sim.Listed(at=places),
        visibility=sim.Visibility(probability=0.9, field_of_view=math.tau, range=(0.3, REACH)),
        noise=sim.Noise(bearing_sigma=BEARING_SIGMA),
        rates=sim.Rates(odometry=10.0, bearings=5.0, truth=10.0),
        odometry=sim.OdometryErrors(speed_sigma=0.005, turn_sigma=0.005),
        start=sim.StartPose(x=x, y=y, heading=ahead, prior=False),
        trajectory=sim.Waypoints(speed=0.4, points=(there,), duration=20.0),
    )
    return simulate(scenario).drive


def relocated(drive: Drive, place: Place) -> tuple[float, float, float]:
    """Return driving and computing time until the first pose in a place [s], and its error [m].

    Infinity and NaN if there is none.
    """
    began, twists = time.perf_counter(), drive.odometry
    there = place.visited_by(drive, 1.0)
    localizer, k = Localizer({}, known=there.known, **there.settings.robot), 0
    for t, seen, _ in drive.sightings.stamps():
        while k < twists.t.size and twists.t[k] <= t:
            localizer.odometry(float(twists.t[k]), float(twists.v[k]), float(twists.omega[k]))
            k += 1
        pose = localizer.bearings(t, seen).pose
        if pose is not None:
            truth = drive.truth.at(np.array([t]))
            off = math.dist(pose[:2], (truth.x[0], truth.y[0]))
            return t - drive.span[0], time.perf_counter() - began, off
    return math.inf, time.perf_counter() - began, math.nan


def large() -> None:
    halls = [random_places(np.random.default_rng(i), COUNT, HALL) for i in range(NUMBER)]
    places = [made(f"hall {i}", h, np.random.default_rng([i, 2])) for i, h in enumerate(halls)]
    with tempfile.TemporaryDirectory() as scratch:
        began = time.perf_counter()
        for i, place in enumerate(places):
            save_place(place, Path(scratch, str(i)))
        saved = time.perf_counter()
        places = [load_place(Path(scratch, str(i))) for i in range(NUMBER)]
        loaded = time.perf_counter()
        size = sum(p.stat().st_size for p in Path(scratch).glob("**/*"))
    print(
        f"{NUMBER} places of {COUNT} landmarks, {size / NUMBER / 1e6:.1f} MB each: "
        f"saved in {saved - began:.1f} s, loaded in {loaded - saved:.1f} s"
    )
    for where, of in (("its place", 0), ("another place", 1)):
        rows = np.array([relocated(kidnapped(halls[i], i), places[i - of]) for i in range(NUMBER)])
        found = np.isfinite(rows[:, 0])
        print(f"a robot with the map of {where}: {found.sum()} of {NUMBER} with a pose", end="")
        if found.any():
            first, _, off = rows[found].T
            print(
                f", after {np.median(first):.1f} s of driving (worst {first.max():.1f}), "
                f"error at most {off.max():.2f} m",
                end="",
            )
        print(f"; runtime {np.median(rows[:, 1]):.1f} s (worst {rows[:, 1].max():.1f})")
    some = {n: p for n, p in halls[0].items() if p[0] < 0.4 * HALL[0]}
    began = time.perf_counter()
    merged(places[0], VisitData("a drive", "0", 1.0, mapped(some, np.random.default_rng(3))))
    print(f"a visit that maps {len(some)} of them is merged in {time.perf_counter() - began:.1f} s")


def year(days: int = 365) -> None:
    """Print the size of a place over a year: 40 landmarks, 3 of which are replaced per day."""
    rng, size = np.random.default_rng(0), (20.0, 12.0)
    standing, number = random_places(rng, 40, size), 40
    place, began = made("hall", standing, rng), time.perf_counter()
    with tempfile.TemporaryDirectory() as scratch:
        for day in range(1, days + 1):
            for name in rng.choice(sorted(standing), 3, replace=False):
                del standing[str(name)]
                standing[f"P{number}"] = tuple(rng.uniform((0.0, 0.0), size).tolist())
                number += 1
            eyes = np.array([(x, y, 0.0) for x in (3.0, 10.0, 17.0) for y in (3.0, 9.0)] * 20)
            near = [[n for n, p in standing.items() if math.dist(p, eye[:2]) < 6.0] for eye in eyes]
            frames = VisitFrames(eyes, near, None)
            digest, there = rng.bytes(8).hex(), mapped(standing, rng)
            place = merged(place, VisitData("a drive", digest, float(day), there, frames))
            if day in (30, days // 2, days):
                folder = Path(scratch, str(day))
                save_place(place, folder)
                held = sum(p.stat().st_size for p in folder.glob("**/*"))
                print(
                    f"day {day}: {len(place.persistence)} landmarks, {len(place.visits)} visits, "
                    f"{held / 1e3:.0f} kB on disk, sigma of home "
                    f"{place.home_sigma('home', float(day)):.3f} m"
                )
    seconds = (time.perf_counter() - began) / days
    print(f"{number} landmarks in total; {seconds:.2f} s per visit")
