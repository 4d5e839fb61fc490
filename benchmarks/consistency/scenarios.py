"""The scenarios: each makes a drive and its bound from a seed.

Layout, path and noise depend only on the seed, not on an estimator. All drives have the same size;
larger and smaller worlds are the same drives scaled, so that any difference in the figures reveals
a length that the estimator assumes.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.consistency import hardships as faults
from benchmarks.consistency.trial import (
    Leg,
    Trial,
    lagging,
    scaled,
    slipping,
    trial,
    wandering,
    without,
)
from homeward.drives.settings import Mount
from homeward.geometry.frames import Pose
from homeward.lab.simulation import scenario as sim
from homeward.lab.simulation.simulate import Simulation, load_scenario, simulate

DRIVE_S, LEG_S = 80.0, 50.0  # duration of a drive, and of each leg of a drive with two [s]
CARRIED_S = 2.0  # gap in the log while the robot is carried [s]
MOUNT = Mount(x=0.3, y=-0.1, yaw=0.2)
"""Extrinsics of a camera away from the robot's centre [m, m, rad]."""
SWAPPED_S = 30.0, 40.0  # start and end of swapped ids [s]
LATE_S = 0.1, 0.4  # minimum and maximum delay of a camera's stamps [s]
SOON_S = 15.0  # duration of a drive of which only the beginning matters [s]
NARROW = {90: 32, 60: 48}
"""Number of landmarks by the camera's field of view [deg]: home sees about eight of them."""


@dataclass(frozen=True)
class Family:
    """Drives of one kind, each with a number; those of this module are scenarios of the gate."""

    about: str
    make: Callable[[int], Any]  # makes a drive, mostly a `Trial`, from a seed
    first: int = 0  # seed of drive 0: scenarios with the same one are compared drive by drive
    exact: bool = True
    """Whether the estimator has all parameters, so that NEES and NIS have their expected values."""
    moves: bool = False  # whether landmarks move
    real: bool = False  # whether the drives are recorded
    copies: int = 1  # number of drives per seed of a benchmark; 0: one drive in all

    def drive(self, number: int) -> Any:
        return self.make(self.first + number)


def _course(seed: int, seconds: float = DRIVE_S, **changes: Any) -> sim.Scenario:
    changes = {"name": "consistency"} | changes
    return wandering(seed, 0, 40, (0.5, 2.0), speed=0.3, seconds=seconds, turned=0.5, **changes)


def _room(seed: int, **changes: Any) -> Trial:
    return trial(Leg(simulate(_course(seed, **changes))))


def _legged(seed: int) -> Trial:
    """The same path on legs: they sway, slip more, and turn the body meanwhile."""
    robot = sim.Robot(drive="omni", yaw_rate=0.1, sway=0.1)
    errors = {"speed_sigma": 0.02, "sideways_sigma": 0.03, "turn_sigma": 0.02}
    return _room(seed, robot=robot, odometry=sim.OdometryErrors(**errors))


def _camera(seed: int, degrees: int) -> Trial:
    landmarks = sim.Ring(count=NARROW[degrees], distance=(2.5, 5.0))
    view = sim.Visibility(probability=0.8, field_of_view=math.radians(degrees))
    return _room(seed, landmarks=landmarks, visibility=view)


def _noisy(seed: int) -> Trial:
    noise = sim.Noise(bearing_sigma=0.05, home_sigma=0.05)
    return _room(seed, noise=noise, odometry=sim.OdometryErrors(speed_sigma=0.03, turn_sigma=0.05))


def _outliers(seed: int) -> Trial:
    return _room(seed, noise=sim.Noise(bearing_sigma=0.01, home_sigma=0.01, wrong_ids=0.1))


def _then(before: Simulation, places: np.ndarray, start: Pose, **changes: Any) -> Simulation:
    """Return a second leg: other positions of the landmarks, other noise, from `start`."""
    case = before.scenario
    at = {n: (float(x), float(y)) for n, (x, y) in zip(before.world.ids, places, strict=True)}
    other = _course(case.seed + 1_000_000, LEG_S, landmarks=sim.Listed(at=at), **changes)
    begun = sim.StartPose(x=start.x, y=start.y, heading=start.heading, prior=False)
    return simulate(other.model_copy(update={"start": begun}))


def _moved_on_the_way(seed: int, count: int = 2, all_in: int = 12, **changes: Any) -> Trial:
    """Some landmarks are moved in mid-drive to another direction from home."""
    landmarks = sim.Ring(count=all_in, distance=(2.5, 5.0))
    first = simulate(_course(seed, LEG_S, landmarks=landmarks, **changes))
    rng, places = np.random.default_rng([seed, 2]), first.world.in_home_frame
    for i in rng.choice(len(places), count, replace=False):
        turn = rng.choice([-1.0, 1.0]) * rng.uniform(0.2, 0.5)
        c, s = math.cos(turn), math.sin(turn)
        places[i] = places[i] @ np.array([[c, s], [-s, c]])
    begins = float(first.drive.odometry.t[-1]) + 0.2
    return trial(Leg(first), Leg(_then(first, places, first.final_pose, **changes), begins))


def _few(seed: int) -> Trial:
    """Three of ten landmarks move in mid-drive; three or four are in view at a time."""
    view = sim.Visibility(probability=0.7, field_of_view=math.pi)
    quick = sim.Rates(odometry=20.0, bearings=20.0, truth=10.0)
    noise = sim.Noise(bearing_sigma=0.01, home_sigma=0.01, wrong_ids=0.05)
    return _moved_on_the_way(seed, 3, 10, visibility=view, rates=quick, noise=noise)


def _kidnapped(seed: int) -> Trial:
    """The robot is lifted in mid-drive and set down elsewhere in the room."""
    first = simulate(_course(seed, LEG_S))
    rng, begins = np.random.default_rng([seed, 3]), float(first.drive.odometry.t[-1]) + CARRIED_S
    x, y = first.final_pose[:2]
    there = Pose(-0.7 * x + 0.5, -0.7 * y, float(rng.uniform(-math.pi, math.pi)))
    second = _then(first, first.world.in_home_frame, there)
    return trial(Leg(first), Leg(second, begins, carried=True))


def _corridor(seed: int) -> Trial:
    """Along a corridor with landmarks on its walls, and back."""
    return _room(
        seed,
        home=sim.RoomPose(x=10.0, y=1.2),
        room=sim.Room(bounds=(0.0, 0.0, 24.0, 2.4)),
        landmarks=sim.OnSurfaces(count=24, spacing=1.0),
        visibility=sim.Visibility(probability=0.8, range=(0.0, 7.0)),
        start=sim.StartPose(x=8.0, y=1.0, heading=0.2, prior=False),
        trajectory=sim.Waypoints(
            speed=0.4,
            duration=DRIVE_S,
            points=((11, 1.6), (14, 0.8), (17, 1.4), (20, 1.0), (20.6, 1.5), (17, 1), (8, 1.2)),
        ),
    )


def _teach_and_return(seed: int) -> Trial:
    """From home out into a hall until none of its landmarks is seen, and back home."""
    return _room(
        seed,
        home=sim.RoomPose(x=4.0, y=4.0),
        room=sim.Room(bounds=(0.0, 0.0, 24.0, 10.0), shelves=((9.0, 3.0, 10.0, 7.0),)),
        landmarks=sim.OnSurfaces(count=40, spacing=1.0),
        visibility=sim.Visibility(probability=0.8, range=(0.0, 6.0)),
        start=sim.StartPose(x=4.0, y=4.0, heading=0.0, prior=False),
        trajectory=sim.Waypoints(
            speed=0.5,
            duration=120.0,
            points=((6, 2.5), (12, 2), (19, 3), (21, 6), (18, 8), (12, 8), (6, 7.5), (3, 5)),
            end_at_home=True,
        ),
    )


def _walkers(seed: int, count: int = 8, **changes: Any) -> Trial:
    """Some landmarks are people who walk."""
    landmarks = sim.Ring(count=16, distance=(2.5, 5.0))
    walks, who = faults.with_walkers(
        simulate(_course(seed, landmarks=landmarks, **changes)), count, 0.3
    )
    whole = trial(Leg(walks))
    return replace(whole, moved=whole.moved | who)


def _swapped_ids(seed: int, **changes: Any) -> Trial:
    return trial(Leg(faults.with_swapped_ids(simulate(_course(seed, **changes)), 3, *SWAPPED_S)))


def _cart(seed: int) -> Trial:
    """A cart with four neighbouring landmarks is moved in mid-drive."""
    first = simulate(_course(seed, LEG_S))
    rng, begins = np.random.default_rng([seed, 7]), float(first.drive.odometry.t[-1]) + 0.2
    places = faults.on_a_cart(first.world.in_home_frame, rng, 4)
    return trial(Leg(first), Leg(_then(first, places, first.final_pose), begins))


def _home_noisy(seed: int) -> Trial:
    return faults.without_home_sigma(
        _room(seed, noise=sim.Noise(bearing_sigma=0.01, home_sigma=0.1))
    )


def _soon(seed: int) -> Trial:
    """The beginning of a drive with a fast robot and a fast camera."""
    points = _course(seed).trajectory.model_copy(update={"speed": 0.4, "duration": SOON_S})
    rates = sim.Rates(odometry=20.0, bearings=10.0, truth=10.0)
    return _room(seed, trajectory=points, rates=rates, visibility=sim.Visibility())


def _late(seed: int) -> Trial:
    """The warehouse, with long straights, and a camera whose stamps are late."""
    delay = float(np.random.default_rng([seed, 9]).uniform(*LATE_S))
    warehouse = load_scenario("warehouse").model_copy(update={"seed": seed})
    return faults.bearings_late(trial(Leg(simulate(warehouse))), delay)


HARDSHIPS: dict[str, tuple[dict[str, Any], Callable[[Trial, int], Trial]]] = {
    "outliers": ({"wrong_ids": 0.1}, lambda whole, seed: whole),
    "home-noisy": ({"home_sigma": 0.03}, lambda whole, seed: faults.without_home_sigma(whole)),
    "bearings-unknown": (
        {"bearing_sigma": 0.03},
        lambda whole, seed: faults.without_bearing_sigma(whole),
    ),
    "moved": ({"moved": sim.Moved(count=5)}, lambda whole, seed: whole),
    "camera-120": (
        {"visibility": sim.Visibility(probability=0.8, field_of_view=math.radians(120))},
        lambda whole, seed: whole,
    ),
    "odometry-unknown": ({}, lambda whole, seed: without(whole, odometry=True)),
    "slipping": ({}, lambda whole, seed: slipping(whole, seed, 0.4, 15.0, 1.0)),
    "stalling": ({}, lambda whole, seed: faults.stalling(whole, seed, 30.0, 1.0)),
    "lagging": ({}, lambda whole, seed: lagging(whole, 0.2)),
    "walkers": ({}, lambda whole, seed: whole),
    "swapped-ids": ({}, lambda whole, seed: whole),
}
"""Changes of the scenario (those of noise by their names), and of the log."""


def _three_hardships(seed: int) -> Trial:
    """Three random faults at once."""
    rng = np.random.default_rng([seed, 8])
    names = sorted(rng.choice(sorted(HARDSHIPS), 3, replace=False).tolist())
    course = {k: v for name in names for k, v in HARDSHIPS[name][0].items()}
    noise = {"bearing_sigma": 0.01, "home_sigma": 0.01}
    noise |= {key: course.pop(key) for key in list(course) if key in sim.Noise.model_fields}
    course |= {"noise": sim.Noise(**noise), "landmarks": sim.Ring(count=16, distance=(2.5, 5.0))}
    drive, who = simulate(_course(seed, **course)), frozenset[str]()
    if "walkers" in names:
        drive, who = faults.with_walkers(drive, 4, 0.3)
    if "swapped-ids" in names:
        drive = faults.with_swapped_ids(drive, 3, *SWAPPED_S)
    whole = trial(Leg(drive))
    for name in names:
        whole = HARDSHIPS[name][1](whole, seed)
    return replace(whole, moved=whole.moved | who)


SCENARIOS = {
    "room": Family("10 m across, all round, all parameters given", _room),
    "strafing": Family(
        "the same paths with a constant heading, as with mecanum wheels",
        lambda s: _room(s, robot=sim.Robot(drive="mecanum")),
    ),
    "swerve": Family(
        "the same paths, the robot turns as it drives",
        lambda s: _room(s, robot=sim.Robot(drive="omni")),
    ),
    "legged": Family("as swerve, on legs that sway, with two to three times the noise", _legged),
    "table": Family("the same drives, 1 m across", lambda s: scaled(_room(s), 0.1)),
    "site": Family("the same drives, 100 m across", lambda s: scaled(_room(s), 10.0)),
    "camera-90": Family("camera of 90 deg", lambda s: _camera(s, 90), 100),
    "camera-60": Family("camera of 60 deg", lambda s: _camera(s, 60), 200),
    "mount-given": Family("camera extrinsics given", lambda s: _room(s, sensor=MOUNT)),
    "mount-unknown": Family(
        "the same drives, extrinsics not given",
        lambda s: without(_room(s, sensor=MOUNT), mount=True),
        exact=False,
    ),
    "noisy": Family("bearings of 3 deg, three to five times the odometry noise", _noisy, 300),
    "odometry-unknown": Family(
        "as room, odometry noise not given", lambda s: without(_room(s), odometry=True), exact=False
    ),
    "slipping": Family(
        "the same, and wheels slip by 40 % for 1.5 s every 10 s",
        lambda s: slipping(without(_room(s), odometry=True), s, 0.4, 10.0, 1.5),
        exact=False,
    ),
    "lagging": Family(
        "as odometry-unknown, and odometry stamped 0.2 s late",
        lambda s: lagging(without(_room(s), odometry=True), 0.2),
        exact=False,
    ),
    "outliers": Family("10 % of the ids wrong", _outliers, 400),
    "moved": Family(
        "4 of 12 moved since home", lambda s: _room(s, moved=sim.Moved(count=4)), 500, moves=True
    ),
    "moved-on-the-way": Family("2 of 12 move in mid-drive", _moved_on_the_way, 600, moves=True),
    "kidnapped": Family("lifted and set down elsewhere", _kidnapped, 700),
    "corridor": Family("a corridor of 24 m, sight of 7 m", _corridor, 800),
    "teach-and-return": Family("out of sight of home and back", _teach_and_return, 900),
    "moved-most": Family(
        "8 of 12 moved since home, by 6 to 57 deg",
        lambda s: _room(s, moved=sim.Moved(count=8, fault=(0.1, 1.0))),
        1000,
        moves=True,
    ),
    "walkers": Family("half of 16 are people who walk", _walkers, 1100, moves=True),
    "home-noisy": Family(
        "ten times the noise of home bearings, not given", _home_noisy, 1200, exact=False
    ),
    "outliers-30": Family(
        "30 % of the ids wrong",
        lambda s: _room(s, noise=sim.Noise(bearing_sigma=0.01, home_sigma=0.01, wrong_ids=0.3)),
        1300,
    ),
    "few": Family(
        "3 of 10 move in mid-drive, seen at 20 Hz by a camera of 180 deg with wrong ids",
        _few,
        1900,
        moves=True,
    ),
    "soon": Family("the first 15 s, faster", _soon, 1400),
    "soon-lagging": Family(
        "the same, and odometry stamped 0.3 s late, not given",
        lambda s: lagging(without(_soon(s), odometry=True), 0.3),
        1400,
        exact=False,
    ),
    "swapped-ids": Family("three pairs swap ids for 10 s", _swapped_ids, 1500),
    "stalling": Family(
        "odometry sometimes reports 0 for 1.5 s, noise not given",
        lambda s: faults.stalling(without(_room(s), odometry=True), s, 15.0, 1.5),
        1600,
        exact=False,
    ),
    "cart": Family("4 of 12 moved as one body in mid-drive", _cart, 1700, moves=True),
    "late": Family(
        "a warehouse, bearings stamped 0.1 to 0.4 s late, not specified",
        _late,
        2000,
        exact=False,
        moves=True,
    ),
    "three-hardships": Family("three faults at once", _three_hardships, 1800, exact=False),
}
