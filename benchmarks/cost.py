"""Runtime per keyframe: 20 landmarks at 2 keyframes/s, also over hours; 500 landmarks; a hall.

`python -m benchmarks.cost [--hours 8] [--part steady|long|many|hall|ekf|mcap ...]` prints
milliseconds of processor time of one call of `bearings` (OPENBLAS_NUM_THREADS=1 keeps it on one
core). `hall` drives for `--seconds` on the lanes of a hall with `--landmarks` posts, of which a
camera of 60 degrees sees four at a time; `--landmarks 2000 --seconds 7500` maps nearly all of them.
`ekf` is 20 landmarks at 20 Hz next to an EKF that is given the map and the start.
`mcap` is the processor time of the estimation of whole drives, one in circles and those after
`--drive` (by default the sample), and of writing run.mcap; the first includes the types of ROS.
"""

import resource
import time
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks import monte_carlo
from benchmarks.peers import surveyed
from homeward.drives.drive import Drive, HomeBearing
from homeward.drives.landmarks import KnownLandmarks
from homeward.drives.opening import SAMPLE, open_drive
from homeward.drives.settings import Start
from homeward.estimator import Estimator
from homeward.geometry.frames import to_polar
from homeward.lab.simulation import scenario as sim
from homeward.lab.simulation.simulate import Simulation, simulate
from homeward.localizer.localizer import Localizer
from homeward.registry import DEFAULT, estimator_settings, make_estimator
from homeward.runs.report.mcap import write_recording
from homeward.track import run

RATE = 2.0  # bearing stamps, and so keyframes, per second [Hz]


def make_drive(landmarks: int, seconds: float, far: float = 6.0, rate: float = RATE) -> Drive:
    return simulated(landmarks, seconds, far, rate).drive


def simulated(landmarks: int, seconds: float, far: float = 6.0, rate: float = RATE) -> Simulation:
    """Return a drive in circles, each landmark visible with probability one half."""
    scenario = sim.Scenario(
        name=f"{landmarks} landmarks",
        landmarks=sim.Ring(count=landmarks, distance=(3.0, far)),
        moved=sim.Moved(count=min(3, landmarks // 5)),
        visibility={"probability": 0.5},
        noise=sim.Noise(bearing_sigma=0.01, home_sigma=0.01),
        rates=sim.Rates(odometry=10.0, bearings=rate, truth=1.0),
        odometry=sim.OdometryErrors(speed_sigma=0.01, turn_sigma=0.01),
        start=sim.StartPose(R=1.0, theta=0.3, alpha=1.8, prior=False),
        trajectory=sim.Circle(speed=0.3, omega=0.25, duration=seconds),
    )
    return simulate(scenario)


def milliseconds(drive: Drive, localizer: Estimator | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return the runtime of each call of `bearings` [ms], and whether home was found by then."""
    localizer = localizer or Localizer(drive.home, **drive.settings.robot)
    o = drive.odometry
    twists = zip(o.t.tolist(), o.v.tolist(), o.omega.tolist(), strict=True)
    twist = next(twists, None)
    cost, found = [], []
    for t, seen, sigmas in drive.sightings.stamps():
        while twist is not None and twist[0] <= t:
            localizer.odometry(*twist)
            twist = next(twists, None)
        began = time.process_time()
        estimate = localizer.bearings(t, seen, sigmas)
        cost.append(1e3 * (time.process_time() - began))
        found.append(estimate.pose is not None)
    return np.array(cost), np.array(found)


def steady() -> None:
    cost, found = milliseconds(make_drive(20, 1200))
    first = int(np.argmax(found))
    print(
        f"20 landmarks, {cost.size} keyframes: median {np.median(cost):.2f} ms (goal 1), "
        f"99 % {np.quantile(cost, 0.99):.2f} ms (goal 5), worst {cost.max():.1f} ms; "
        f"until home was found ({first} keyframes): worst {cost[: first + 1].max():.1f} ms "
        "(goal 20)"
    )


def long(hours: float) -> None:
    drive = make_drive(20, 3600 * hours)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    cost, _ = milliseconds(drive)
    after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    parts = np.array([np.median(part) for part in np.array_split(cost, 8)])
    slope = np.polyfit(np.arange(8) * hours / 8, parts, 1)[0]
    print(
        f"{hours:g} h, {cost.size} keyframes: medians of eighths "
        f"{' '.join(f'{p:.2f}' for p in parts)} ms, slope {slope:+.4f} ms/h, "
        f"memory {(after - before) / 1024:+.1f} MB"
    )


def many() -> None:
    cost, _ = milliseconds(make_drive(500, 120, far=20.0))
    print(
        f"500 landmarks, {cost.size} keyframes: median {np.median(cost):.0f} ms, worst "
        f"{cost.max():.0f} ms, runtime {cost.sum() / 1e3:.0f} s for 120 s of driving "
        "(goal: less than 120)"
    )
    cost, _ = milliseconds(make_drive(500, 100, far=20.0, rate=20.0))
    medians = ", ".join(f"{np.median(part):.1f}" for part in np.array_split(cost, 5))
    print(
        f"500 landmarks at 20 Hz: median {medians} ms in each fifth of 100 s, "
        f"mean {cost.mean():.1f}"
    )


def hall_drive(seconds: float, rows: int = 24, seed: int = 0, turn_noise: float = 0.02) -> Drive:
    """Return a drive on lanes of a hall with `rows` by `rows` posts, 3.4 m apart.

    `turn_noise` is that of the odometry [rad/s/sqrt(Hz)].
    """
    rng, spacing, reach, lane = np.random.default_rng(seed), 3.4, 9.0, 8.0
    edge = 0.5 * rows * spacing - 6.0
    grid = (
        np.stack(np.meshgrid(np.arange(rows), np.arange(rows)), -1) - 0.5 * (rows - 1)
    ) * spacing
    posts = (grid + rng.uniform(-1.0, 1.0, (rows, rows, 2))).reshape(-1, 2)
    ends = [(-edge, edge), (edge, -edge)]
    points = [
        (x, float(y)) for k, y in enumerate(np.arange(-edge, edge, lane)) for x in ends[k % 2]
    ]
    scene = simulate(
        sim.Scenario(
            name=f"hall with {len(posts)} posts",
            seed=seed,
            home=sim.RoomPose(x=-edge, y=-edge),
            landmarks=sim.Listed(
                at={f"P{i}": (post[0], post[1]) for i, post in enumerate(posts.tolist())}
            ),
            visibility=sim.Visibility(field_of_view=np.deg2rad(60.0), range=(0.3, reach)),
            noise=sim.Noise(bearing_sigma=0.01, home_sigma=0.01),
            rates=sim.Rates(odometry=10.0, bearings=RATE, truth=1.0),
            odometry=sim.OdometryErrors(
                speed_sigma=0.02,
                turn_sigma=turn_noise,
                speed_scale_sigma=0.02,
                turn_bias_sigma=0.002,
            ),
            start=sim.StartPose(R=1.0, theta=0.3, alpha=0.2, prior=False),
            trajectory=sim.Waypoints(
                kind="waypoints", points=points, speed=0.35, max_turn_rate=0.8, duration=seconds
            ),
        )
    )
    home = {  # seen while the robot turned round there
        name: HomeBearing(float(np.arctan2(y, x) + 0.01 * rng.normal()), 0.01)
        for name, (x, y) in zip(scene.world.ids, scene.world.in_home_frame.tolist(), strict=True)
        if np.hypot(x, y) < reach
    }
    return replace(scene.drive, home=home)


def hall(seconds: float, landmarks: int) -> None:
    rows = round(landmarks**0.5)
    drive, goals = hall_drive(seconds, rows), (3, 20) if rows < 30 else (5, 40)
    localizer = Localizer(drive.home, **drive.settings.robot)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    cost, found = milliseconds(drive, localizer)
    after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    print(
        f"hall, {seconds:g} s, {len(localizer.landmarks())} of {rows**2} landmarks: median "
        f"{np.median(cost):.1f} ms (goal {goals[0]}), 99 % {np.quantile(cost, 0.99):.1f} ms (goal "
        f"{goals[1]}), {cost.sum() / 1e3:.0f} s in all, memory {(after - before) / 1024:+.0f} MB "
        f"to {after / 1024:.0f} MB (goal 300); with a pose {found.mean():.2f}"
    )


def ekf() -> None:
    scene = simulated(20, 120, rate=20.0)
    drive, world = scene.drive, scene.world
    there = zip(world.ids, world.in_home_frame.tolist(), strict=True)
    places = {name: {"x": x, "y": y} for name, (x, y) in there}
    known = KnownLandmarks(frame="home", landmarks=places)
    start = Start.about(to_polar(drive.truth.at(drive.odometry.t[0])), 0.05, 0.1, 0.1)
    settings = drive.settings.model_copy(update={"start": start})
    given = surveyed.ekf(replace(drive, known=known, settings=settings))
    for name, estimator in (("homeward", None), ("EKF with map and start", given)):
        cost, _ = milliseconds(drive, estimator)
        print(
            f"{name}, 20 landmarks at 20 Hz: median {np.median(cost):.2f} ms, 99 % "
            f"{np.quantile(cost, 0.99):.1f} ms, {cost.sum() / 10 / 120:.1f} % of a core"
        )


def mcap(paths: list[str]) -> None:
    drives = {"20 landmarks, 300 s": make_drive(20, 300.0)}
    drives |= {Path(path).name: open_drive(path) for path in paths}
    for name, drive in drives.items():
        estimator = make_estimator(DEFAULT, drive, estimator_settings(DEFAULT, {}))
        began = time.process_time()
        track = run(drive, estimator)
        estimated = time.process_time()
        with TemporaryDirectory() as folder:
            write_recording(file := Path(folder, "run.mcap"), drive, track)
            written = time.process_time()
            size = file.stat().st_size / 1e6
        cost, whole = written - estimated, estimated - began
        print(
            f"{name}: estimation {whole:.2f} s, run.mcap ({size:.1f} MB) {cost:.2f} s, ratio "
            f"{cost / whole:.3f} (goal: less than 0.2)"
        )


def main() -> None:
    parts = {"steady": steady, "long": lambda: long(options.hours), "many": many}
    parts |= {"hall": lambda: hall(options.seconds, options.landmarks)}
    parts |= {"ekf": ekf, "mcap": lambda: mcap(options.drive)}
    numbers = {"hours": 8.0, "seconds": 1500.0, "landmarks": 576}
    options = monte_carlo.parsed(__doc__, **numbers, part=parts, drive=[SAMPLE])
    for part in options.part:
        parts[part]()


if __name__ == "__main__":
    main()
